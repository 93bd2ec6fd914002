//! `lab`: makes scenes and measures the programs. Every figure in our documents comes from one of its subcommands.

use std::{ffi::OsString, path::PathBuf, process::ExitCode};

use anyhow::Result;
use clap::{Parser, Subcommand};
use gnomon_client::{camera_path::PathSpec, net::url::ServerUrl};
use gnomon_tests::{
    cloister,
    report::{
        load::{self, LoadOptions},
        pipeline::{self, PipelineOptions},
        trace_error::{self, TraceErrorOptions},
    },
};

#[derive(Debug, Parser)]
#[command(version, about = "Makes Gnomon's own scene and measures its programs.")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Writes Gnomon's own scene: cloister.glb and its camera paths, cloister.json.
    MakeScene {
        /// Folder to write into.
        #[arg(long, default_value = "tests/assets")]
        out: PathBuf,
    },
    /// Rebuilds the dissertation's Table 1 with the real programs on loopback: writes pipeline.csv, prints Markdown.
    Pipeline {
        /// The scene, `.gltf` or `.glb`.
        #[arg(long)]
        scene: PathBuf,
        /// JSON file with lights, for a scene that has none.
        #[arg(long)]
        lights_from: Option<PathBuf>,
        /// Keeps the first lights only.
        #[arg(long)]
        lights: Option<u32>,
        /// Camera path, FILE or FILE#NAME; without it, the only one in lights_camera.json beside the scene.
        #[arg(long)]
        path: Option<OsString>,
        /// Size of the picture, WIDTHxHEIGHT.
        #[arg(long, value_parser = size, default_value = "640x360")]
        size: (u32, u32),
        /// Frames a run.
        #[arg(long, default_value_t = 200)]
        frames: u32,
        /// Runs a row; figures are their medians.
        #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
        runs: u32,
        /// The server's back end: auto, compute or cpu.
        #[arg(long, default_value = "auto")]
        backend: String,
        /// Lets both programs use a software adapter.
        #[arg(long)]
        allow_software: bool,
        /// Folder for pipeline.csv.
        #[arg(long, default_value = "target/lab")]
        out: PathBuf,
    },
    /// Puts many clients that draw nothing on a running server, and says what each of them gets.
    Load {
        /// The line that the server printed.
        url: ServerUrl,
        /// Token, for a server that wants one.
        #[arg(long, env = "GNOMON_TOKEN", hide_env_values = true)]
        token: Option<String>,
        /// Clients at once.
        #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=1024))]
        clients: u32,
        /// Camera path, FILE or FILE#NAME; each client starts at another place of it.
        #[arg(long)]
        path: PathSpec,
        /// Size of the masks, WIDTHxHEIGHT.
        #[arg(long, value_parser = size, default_value = "640x360")]
        size: (u32, u32),
        /// Poses of each client.
        #[arg(long, default_value_t = 600)]
        frames: u32,
        /// Poses a second of each client; without it, each sends a pose when the mask of the one before has come.
        #[arg(long)]
        fps: Option<f64>,
        /// File for the figures, as JSON; they are printed as well.
        #[arg(long)]
        out: Option<PathBuf>,
    },
    /// Compares the back ends' masks with the f64 referee's, directly.
    TraceError {
        /// The scene, `.gltf` or `.glb`.
        #[arg(long)]
        scene: PathBuf,
        /// JSON file with lights, for a scene that has none.
        #[arg(long)]
        lights_from: Option<PathBuf>,
        /// Keeps the first lights only.
        #[arg(long)]
        lights: Option<u32>,
        /// JSON file with camera paths; without it, lights_camera.json beside the scene.
        #[arg(long)]
        path: Option<PathBuf>,
        /// Name of the path, where the file has several.
        #[arg(long)]
        path_name: Option<String>,
        /// Times on the path, in seconds.
        #[arg(long, value_delimiter = ',', default_value = "0")]
        times: Vec<f64>,
        /// Size of the picture, WIDTHxHEIGHT.
        #[arg(long, value_parser = size, default_value = "640x360")]
        size: (u32, u32),
        /// Back ends: cpu, compute.
        #[arg(long, value_delimiter = ',', default_value = "cpu,compute")]
        backends: Vec<String>,
        /// Lets compute run on a software adapter.
        #[arg(long)]
        allow_software: bool,
        /// Folder for a picture of each comparison.
        #[arg(long)]
        pictures: Option<PathBuf>,
    },
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let parsed = text.split_once('x').and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    parsed.ok_or_else(|| format!("{text:?} is no size: write it as 640x360"))
}

fn run(arguments: Arguments) -> Result<()> {
    match arguments.command {
        Command::MakeScene { out } => {
            let made = cloister::generate(&out)?;
            println!(
                "{}: {} bytes ({} of pictures), {} meshes, {} instances, {} triangles ({} stored)",
                out.join(cloister::SCENE_FILE).display(),
                made.bytes,
                made.picture_bytes,
                made.meshes,
                made.instances,
                made.triangles,
                made.stored_triangles
            );
        }
        Command::Pipeline { scene, lights_from, lights, path, size, frames, runs, backend, allow_software, out } => {
            let path = path.unwrap_or_else(|| scene.with_file_name("lights_camera.json").into());
            let options =
                PipelineOptions { scene, lights_from, lights, path, size, frames, runs, backend, allow_software, out };
            print!("{}", pipeline::measure(&options, |line| eprintln!("{line}"))?.markdown());
        }
        Command::Load { url, token, clients, path, size, frames, fps, out } => {
            let report = load::run(&LoadOptions { url, token, clients, path, size, frames, fps, out })?;
            println!("{}", serde_json::to_string_pretty(&report)?);
        }
        Command::TraceError {
            scene,
            lights_from,
            lights,
            path,
            path_name,
            times,
            size,
            backends,
            allow_software,
            pictures,
        } => {
            let path = path.unwrap_or_else(|| scene.with_file_name("lights_camera.json"));
            let options = TraceErrorOptions {
                scene,
                lights_from,
                lights,
                path,
                path_name,
                times_s: times,
                size,
                backends,
                allow_software,
                pictures,
            };
            trace_error::compare(&options, |line| println!("{line}"))?;
        }
    }
    Ok(())
}

fn main() -> ExitCode {
    match run(Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("lab: {error:#}");
            ExitCode::FAILURE
        }
    }
}
