//! `lab`: generates scenes and measures the programs. Every figure in the documents comes from one of its subcommands.

use std::{path::PathBuf, process::ExitCode};

use anyhow::Result;
use clap::{Parser, Subcommand};
use gnomon_lab::{
    cloister, movers,
    report::{
        accuracy, chaos, codec, edges, hostile, lag, link, living, load, loss, moving_times, network, pareto, pipeline,
        predict_cost, replay, trace_error, video,
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
    /// Judge the back ends with the f64 referee on real scenes and hard cases: accuracy.csv, hard_cases.csv, pictures.
    Accuracy(accuracy::AccuracyOptions),
    /// Put a server under load and through faults, and compare promises with measurements.
    Chaos(chaos::ChaosOptions),
    /// Measure each codec on a path's masks, in bytes and time: codec.csv.
    Codec(codec::CodecOptions),
    /// Judge the client's shadow edges with the referee's samples: edges.csv.
    Edges(edges::EdgesOptions),
    /// Send bad traffic to a server and measure its cost. Fails if a goal is missed.
    Hostile(hostile::HostileOptions),
    /// Write Gnomon's own scene: cloister.glb, and its camera paths, cloister.json. Or put movers into another one.
    MakeScene {
        /// Output folder.
        #[arg(long, default_value = "tests/assets")]
        out: PathBuf,
        /// A `.gltf` file: write it with things that move (animations `things`, `fan`, `light`) instead.
        #[arg(long)]
        from: Option<PathBuf>,
        /// How many things, of 1,000 triangles each.
        #[arg(long, default_value_t = 30, requires = "from")]
        movers: u32,
    },
    /// Rebuild the dissertation's Table 1 with the real programs on loopback: pipeline.csv.
    Pipeline(pipeline::PipelineOptions),
    /// Measure the error of predicted visibility against its lag: lag.csv, plots and a grid of pictures.
    Lag(lag::LagOptions),
    /// Measure the cost of prediction in a client's frame: predict_cost.csv.
    PredictCost(predict_cost::PredictCostOptions),
    /// Emulate a network between a client and a server on this machine.
    Link(link::LinkOptions),
    /// Judge masks of scenes that move, at several times, with the f64 referee.
    Living(living::LivingOptions),
    /// Measure what moving things cost a back end on a device, and compare its masks with those of `cpu`.
    MovingTimes(moving_times::MovingTimesOptions),
    /// Run many clients without graphics against a running server.
    Load(load::LoadOptions),
    /// Measure the effect of packet loss on shown masks: loss.csv.
    Loss(loss::LossOptions),
    /// Measure the client behind networks, against itself without a server: network.csv and plots.
    Network(network::NetworkOptions),
    /// Measure every setting that trades speed for error on the real scenes: pareto.csv and a plot per scene.
    Pareto(pareto::ParetoOptions),
    /// Redraw a client's recording: the same pictures to the last bit on the same adapter.
    Replay(replay::ReplayOptions),
    /// Compare the back ends' masks with the referee's, directly.
    TraceError(trace_error::TraceErrorOptions),
    /// Compare sending visibility with sending video: video.csv and plots.
    Video(video::VideoOptions),
}

fn run(arguments: Arguments) -> Result<()> {
    let progress = |line: &str| eprintln!("{line}");
    let say = |line: &str| println!("{line}");
    let table = match arguments.command {
        Command::Accuracy(options) => {
            let judged = accuracy::measure(&options, progress)?;
            print!("{}\n{}", judged.scenes.markdown(), judged.cases.markdown());
            return Ok(());
        }
        Command::Chaos(options) => chaos::run(&options, progress)?,
        Command::Codec(options) => codec::measure(&options, progress)?,
        Command::Edges(options) => edges::measure(&options, progress)?.1,
        Command::MakeScene { out, from: Some(from), movers } => {
            println!("{}", movers::write(&from, movers, &out)?.display());
            return Ok(());
        }
        Command::MakeScene { out, .. } => {
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
            return Ok(());
        }
        Command::Pipeline(options) => pipeline::measure(&options, progress)?,
        Command::Lag(options) => lag::measure(&options, progress)?,
        Command::PredictCost(options) => predict_cost::measure(&options, progress)?,
        Command::Link(options) => return link::run(&options, say).map(drop),
        Command::Hostile(options) => {
            let report = hostile::run(&options)?;
            print!("{}", report.table.markdown());
            anyhow::ensure!(report.holds, "a goal is missed");
            return Ok(());
        }
        Command::Living(options) => living::measure(&options, progress)?,
        Command::MovingTimes(options) => moving_times::measure(&options, progress)?,
        Command::Load(options) => {
            println!("{}", serde_json::to_string_pretty(&load::run(&options)?)?);
            return Ok(());
        }
        Command::Loss(options) => loss::measure(&options, progress)?,
        Command::Network(options) => network::measure(&options, progress)?,
        Command::Pareto(options) => return pareto::measure(&options, progress),
        Command::Replay(options) => {
            let done = replay::run(&options, say)?;
            println!("{} pictures, {} masks, {} network events", done.frames, done.masks, done.events);
            return Ok(());
        }
        Command::TraceError(options) => return trace_error::compare(&options, say),
        Command::Video(options) => video::measure(&options, progress)?,
    };
    print!("{}", table.markdown());
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
