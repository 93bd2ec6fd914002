//! `lab chaos`: a server under load and through faults, and what was promised of it beside what was measured.

pub mod devices;
pub mod drain;
pub mod fairness;
pub mod faults;
pub mod load;
mod rebind;
mod rig;
pub mod soak;

use anyhow::Result;

use super::{scene_args::SceneArgs, table::Table};

/// What to do to the server.
#[derive(Debug, Clone, clap::Args)]
pub struct ChaosOptions {
    #[command(subcommand)]
    part: Part,
}

#[derive(Debug, Clone, clap::Subcommand)]
enum Part {
    /// Many light sessions beside a few heavy ones, and one too many.
    Load(load::LoadPart),
    /// Sessions that stand still: what each costs.
    Idle(load::IdlePart),
    /// One greedy client beside modest ones.
    Fairness(fairness::FairnessPart),
    /// Networks that lose, corrupt and fall silent, ports that change, and a server that is killed.
    Faults(faults::FaultsPart),
    /// Panics, and devices that are lost.
    Devices(devices::DevicesPart),
    /// A server that stops while it serves.
    Drain(drain::DrainPart),
    /// Clients that come and go for a long time.
    Soak(soak::SoakPart),
}

/// What every part needs: a scene, a path, and how the server traces.
#[derive(Debug, Clone, clap::Args)]
pub struct ServerArgs {
    /// The scene and the path; size and frames are each part's own.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// What traces.
    #[arg(long, default_value = "auto")]
    pub backend: String,
    /// Whether a software adapter will do.
    #[arg(long)]
    pub allow_software: bool,
    /// Devices to trace on; all without a number.
    #[arg(long)]
    pub devices: Option<u32>,
    /// Time of each device that sessions may need in a second, in milliseconds.
    #[arg(long, default_value_t = 900)]
    pub device_budget_ms: u32,
}

/// One promise, and what was measured of it.
#[derive(Debug, Clone)]
pub struct Finding {
    /// What was promised.
    pub goal: String,
    /// What was measured.
    pub measured: String,
    /// Whether that is what was promised.
    pub met: bool,
}

impl Finding {
    /// A finding.
    #[must_use]
    pub fn new(goal: &str, measured: String, met: bool) -> Self {
        Self { goal: goal.to_owned(), measured, met }
    }
}

/// Runs a part and says what came of it; the table is written into the folder for results as well.
///
/// # Errors
/// When something that the measurement needs cannot be had; a promise that is not kept is a row of the table.
pub fn run(options: &ChaosOptions, progress: impl Fn(&str)) -> Result<Table> {
    let progress = &progress as &dyn Fn(&str);
    let (name, server, findings) = match &options.part {
        Part::Load(part) => ("load", &part.server, load::measure(part, progress)?),
        Part::Idle(part) => ("idle", &part.server, load::measure_idle(part, progress)?),
        Part::Fairness(part) => ("fairness", &part.server, fairness::measure(part, progress)?),
        Part::Faults(part) => ("faults", &part.server, faults::measure(part, progress)?),
        Part::Devices(part) => ("devices", &part.server, devices::measure(part, progress)?),
        Part::Drain(part) => ("drain", &part.server, drain::measure(part, progress)?),
        Part::Soak(part) => ("soak", &part.server, soak::measure(part, progress)?),
    };
    let mut table = Table::new(&["goal", "measured", "met", "command"]);
    for Finding { goal, measured, met } in findings {
        let met = if met { "yes" } else { "no" };
        table.rows.push(vec![goal, measured, met.to_owned(), format!("`lab chaos {name}`")]);
    }
    server.scene.write(&format!("chaos-{name}.csv"), &table.csv())?;
    Ok(table)
}
