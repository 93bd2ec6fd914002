//! `lab loss`: effect of packet loss on the masks that a client shows, for each countermeasure.
//!
//! `model` models one session on a simulated clock: 60 poses a second go up, each mask comes down in packets of 1161
//! bytes through an [`Impairment`](crate::link::impairment::Impairment), and the client shows the newest. Without
//! tracing time, pacing and prediction, rows differ by loss alone. Client feedback is lost as often. Losses are seeded:
//! a second run gives the same figures. `quic` is the real server and the real client ([`transport`]).

mod model;
mod options;
mod transport;

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use gnomon_client::link::receive_options::Packets;
use gnomon_protocol::mask::{Mask, MaskShape};

pub use self::options::LossOptions;
use self::{model::run, options::FPS};
use super::table::Table;
use crate::{
    backends::BackendName,
    link::settings::{Burst, Settings},
};

const MODEL: &str = "model";

/// Measures and writes `loss.csv`.
pub fn measure(options: &LossOptions, mut progress: impl FnMut(&str)) -> Result<Table> {
    let args = &options.scene;
    ensure!(options.loss.iter().all(|loss| (0.0..100.0).contains(loss)), "a loss is 0 to below 100 per cent");
    ensure!(options.burst.iter().all(|length| *length >= 1.0), "a burst is at least 1 packet long");
    ensure!(options.warm_up < args.frames, "--warm-up must be less than the {} frames", args.frames);
    let (scene, path) = (args.load_scene()?, args.load_path()?);
    let lights = u32::try_from(scene.lights.len()).context("more lights than a mask has")?;
    let (width, height) = args.size;
    let mut trace = BackendName::Cpu.open(&scene)?;
    let mut masks = Vec::new();
    let modelled = if options.transport.iter().any(|name| name == MODEL) { args.frames } else { 0 };
    for frame in 0..modelled {
        let mut mask = Mask::new(MaskShape::new(width, height, lights)?);
        trace(&path.camera(f64::from(frame) / FPS, width, height), &mut mask)?;
        masks.push(mask);
        progress(&format!("frame {} of {}", frame + 1, args.frames));
    }

    let rtt = Duration::from_secs_f64(options.rtt_ms / 1e3);
    let mut table = Table::new(
        "transport | codec | policy | fec | loss | burst | rtt_ms | frames_whole | tiles_in_time \
         | bit_error | mean_bytes | lag_p99 | queue_dropped",
    );
    for transport in &options.transport {
        let mut real = if transport == MODEL { None } else { Some(transport::Stage::new(options, transport)?) };
        for &codec in &options.codecs {
            for (&loss, &burst) in
                options.loss.iter().flat_map(|loss| options.burst.iter().map(move |burst| (loss, burst)))
            {
                if loss == 0.0 && burst > 1.0 {
                    continue;
                }
                let share = loss / 100.0;
                let mut settings = Settings {
                    delay: rtt / 2,
                    loss: if burst > 1.0 { 0.0 } else { share },
                    burst: (burst > 1.0).then_some(Burst { share, length: burst, loss: 1.0 }),
                    ..Settings::default()
                };
                settings.set(&options.link).context("--link")?;
                for &packets in &options.packets {
                    if packets != Packets::WholeFrame && !codec.is_sliced() {
                        continue;
                    }
                    let outcome = match &mut real {
                        None => run(&masks, (codec, packets, options.warm_up), (&settings, options.seed), rtt)?,
                        Some(stage) => stage.run(codec, packets, &settings)?,
                    };
                    let [policy, fec] = match packets {
                        Packets::WholeFrame => ["whole-frame", "none"],
                        Packets::Slices => ["slices", "none"],
                        Packets::Parity => ["slices", "parity"],
                    };
                    let row = vec![
                        transport.clone(),
                        codec.to_string(),
                        policy.into(),
                        fec.into(),
                        format!("{loss}"),
                        format!("{burst}"),
                        format!("{}", options.rtt_ms),
                        share_of(outcome.frames_whole.into(), outcome.frames.into()),
                        share_of(outcome.packets_used, outcome.packets),
                        share_of(outcome.wrong_bits, outcome.bits),
                        (outcome.bytes / u64::from(outcome.frames.max(1))).to_string(),
                        outcome.lag_p99.map(|lag| lag.to_string()).unwrap_or_default(),
                        share_of(outcome.dropped[0], outcome.dropped[1]),
                    ];
                    progress(&row.join(","));
                    table.rows.push(row);
                }
            }
        }
    }
    args.write("loss.csv", &table.csv())?;
    Ok(table)
}

fn share_of(part: u64, all: u64) -> String {
    format!("{:.4}", 100.0 * part as f64 / all.max(1) as f64)
}
