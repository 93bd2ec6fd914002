//! `lab chaos`: promises about a server under load and faults, and what was measured.

pub mod devices;
pub mod drain;
pub mod fairness;
pub mod faults;
mod finding;
pub mod load;
mod rebind;
mod rig;
pub mod soak;

use anyhow::Result;

use self::finding::Finding;
use super::table::Table;

#[derive(Debug, Clone, clap::Args)]
pub struct ChaosOptions {
    #[command(subcommand)]
    part: Part,
}

#[derive(Debug, Clone, clap::Subcommand)]
enum Part {
    /// Many light sessions beside a few heavy ones, and one too many.
    Load(load::LoadPart),
    /// Cost of idle sessions.
    Idle(load::IdlePart),
    /// One greedy client beside modest ones.
    Fairness(fairness::FairnessPart),
    /// Lossy, corrupting and silent networks, port changes, and a killed server.
    Faults(faults::FaultsPart),
    /// Panics and lost devices.
    Devices(devices::DevicesPart),
    /// A server that stops while it serves.
    Drain(drain::DrainPart),
    /// Clients that come and go for a long time.
    Soak(soak::SoakPart),
}

/// Runs a part and writes its table into the folder for results.
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
    let mut table = Table::new("goal | measured | met | command");
    for Finding { goal, measured, met } in findings {
        let met = if met { "yes" } else { "no" };
        table.rows.push(vec![goal, measured, met.to_owned(), format!("`lab chaos {name}`")]);
    }
    server.scene.write(&format!("chaos-{name}.csv"), &table.csv())?;
    Ok(table)
}
