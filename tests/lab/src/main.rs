//! `lab`: makes scenes and measures the programs. Every figure in our documents comes from one of its subcommands.

use std::{path::PathBuf, process::ExitCode};

use anyhow::Result;
use clap::{Parser, Subcommand};
use gnomon_lab::{
    cloister,
    report::{
        accuracy::{self, AccuracyOptions},
        chaos::{self, ChaosOptions},
        codec::{self, CodecOptions},
        hostile::{self, HostileOptions},
        lag::{self, LagOptions},
        link::{self, LinkOptions},
        load::{self, LoadOptions},
        loss::{self, LossOptions},
        network::{self, NetworkOptions},
        pareto::{self, ParetoOptions},
        pipeline::{self, PipelineOptions},
        predict_cost::{self, PredictCostOptions},
        replay::{self, ReplayOptions},
        trace_error::{self, TraceErrorOptions},
        video::{self, VideoOptions},
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
    /// Judges the back ends by the f64 referee on the real scenes and on hard cases: writes accuracy.csv, hard_cases.csv
    /// and pictures, prints Markdown.
    Accuracy(AccuracyOptions),
    /// Puts a server under load and through faults: prints what was promised and what was measured, and writes it as CSV.
    Chaos(ChaosOptions),
    /// Measures what each codec makes of a path's masks, in bytes and in time: writes codec.csv.
    Codec(CodecOptions),
    /// Throws bad traffic at a server of its own, and says what that costs: prints Markdown, and fails where a goal is missed.
    Hostile(HostileOptions),
    /// Writes Gnomon's own scene: cloister.glb and its camera paths, cloister.json.
    MakeScene {
        /// Folder to write into.
        #[arg(long, default_value = "tests/assets")]
        out: PathBuf,
    },
    /// Rebuilds the dissertation's Table 1 with the real programs on loopback: writes pipeline.csv, prints Markdown.
    Pipeline(PipelineOptions),
    /// Measures how wrong predicted visibility is, against how late it is: writes lag.csv, plots and a grid of pictures.
    Lag(LagOptions),
    /// Measures what carrying visibility over costs of a client's frame: writes predict_cost.csv.
    PredictCost(PredictCostOptions),
    /// Stands between a client and a server on this machine as another network would.
    Link(LinkOptions),
    /// Puts many clients that draw nothing on a running server, and says what each of them gets.
    Load(LoadOptions),
    /// Measures what lost packets do to the masks that a client shows, in a model of a session: writes loss.csv.
    Loss(LossOptions),
    /// Measures the client behind networks of several kinds, against itself without a server: writes network.csv and plots.
    Network(NetworkOptions),
    /// Turns every knob that trades speed for error, over the real scenes: writes pareto.csv and a plot of each scene.
    Pareto(ParetoOptions),
    /// Draws a client's recording again: the same pictures to the last bit on the same adapter.
    Replay(ReplayOptions),
    /// Compares the back ends' masks with the f64 referee's, directly.
    TraceError(TraceErrorOptions),
    /// Compares sending visibility with sending the picture as video: writes video.csv and plots.
    Video(VideoOptions),
}

fn run(arguments: Arguments) -> Result<()> {
    match arguments.command {
        Command::Accuracy(options) => {
            let judged = accuracy::measure(&options, |line| eprintln!("{line}"))?;
            print!("{}\n{}", judged.scenes.markdown(), judged.cases.markdown());
        }
        Command::Chaos(options) => print!("{}", chaos::run(&options, |line| eprintln!("{line}"))?.markdown()),
        Command::Codec(options) => print!("{}", codec::measure(&options, |line| eprintln!("{line}"))?.markdown()),
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
        Command::Pipeline(options) => {
            print!("{}", pipeline::measure(&options, |line| eprintln!("{line}"))?.markdown());
        }
        Command::Lag(options) => print!("{}", lag::measure(&options, |line| eprintln!("{line}"))?.markdown()),
        Command::PredictCost(options) => {
            print!("{}", predict_cost::measure(&options, |line| eprintln!("{line}"))?.markdown());
        }
        Command::Link(options) => link::run(&options, |line| println!("{line}")).map(drop)?,
        Command::Hostile(options) => {
            let report = hostile::run(&options)?;
            print!("{}", report.table.markdown());
            anyhow::ensure!(report.holds, "a goal is missed");
        }
        Command::Load(options) => println!("{}", serde_json::to_string_pretty(&load::run(&options)?)?),
        Command::Loss(options) => print!("{}", loss::measure(&options, |line| eprintln!("{line}"))?.markdown()),
        Command::Network(options) => {
            print!("{}", network::measure(&options, |line| eprintln!("{line}"))?.markdown());
        }
        Command::Pareto(options) => pareto::measure(&options, |line| eprintln!("{line}"))?,
        Command::Replay(options) => {
            let done = replay::run(&options, |line| println!("{line}"))?;
            println!("{} pictures, {} masks, {} network events", done.frames, done.masks, done.events);
        }
        Command::TraceError(options) => trace_error::compare(&options, |line| println!("{line}"))?,
        Command::Video(options) => print!("{}", video::measure(&options, |line| eprintln!("{line}"))?.markdown()),
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
