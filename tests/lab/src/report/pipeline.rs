//! `lab pipeline`: the dissertation's Table 1 (§4.1), rebuilt with our programs on loopback.
//!
//! Each row runs the real server and the real headless client as processes, along the same camera path and at the same
//! size. Figures are medians over the runs.

use std::ffi::OsString;

use anyhow::{Context, Result};
use gnomon_protocol::codec::CodecId;
use serde_json::Value;

use super::{scene_args::SceneArgs, statistics::median, table::Table};
use crate::rig::{PATIENCE, ServerProcess};

#[derive(Debug, Clone, clap::Args)]
pub struct PipelineOptions {
    /// Scene, path, size, frames a run, and the folder for `pipeline.csv`.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Runs per row; figures are their medians.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub runs: u32,
    /// The server's back end: auto, compute or cpu.
    #[arg(long, default_value = "auto")]
    pub backend: String,
    /// Allow software adapters.
    #[arg(long)]
    pub allow_software: bool,
}

#[derive(Debug, Clone, Copy)]
struct Row {
    label: &'static str,
    transport: Option<&'static str>,
    codec: CodecId,
    wait: bool,
    /// The dissertation's frames a second for this configuration.
    dissertation_fps: Option<f64>,
}

/// The dissertation's rows: Original TCP, UDP, UDP and LZ4, Parallel; its fifth adds prediction.
const ROWS: [Row; 7] = [
    Row { label: "a", transport: Some("lab-tcp"), codec: CodecId::Words, wait: true, dissertation_fps: Some(7.7) },
    Row { label: "b", transport: Some("lab-udp"), codec: CodecId::Words, wait: true, dissertation_fps: Some(6.9) },
    Row { label: "c", transport: Some("lab-udp"), codec: CodecId::WordsLz4, wait: true, dissertation_fps: Some(35.5) },
    Row { label: "d", transport: Some("lab-udp"), codec: CodecId::WordsLz4, wait: false, dissertation_fps: Some(87.1) },
    Row { label: "e", transport: Some("quic"), codec: CodecId::PlanesLz4, wait: true, dissertation_fps: None },
    Row { label: "e", transport: Some("quic"), codec: CodecId::PlanesLz4, wait: false, dissertation_fps: None },
    Row { label: "f", transport: None, codec: CodecId::PlanesLz4, wait: false, dissertation_fps: None },
];

#[derive(Debug, Clone, Copy, PartialEq)]
struct Run {
    client_fps: f64,
    visibility_fps: f64,
    lag_frames: f64,
    payload_bytes: f64,
    packets: f64,
    incomplete: f64,
}

impl Run {
    /// Reads a summary. Without a server there is no lag and no payload: `null` becomes NaN, which prints as –.
    fn read(summary: &Value) -> Result<Self> {
        let figure = |name: &str| {
            let value = summary.get(name).with_context(|| format!("the client's summary lacks {name:?}"))?;
            Ok::<_, anyhow::Error>(value.as_f64().unwrap_or(f64::NAN))
        };
        Ok(Self {
            client_fps: figure("client_fps")?,
            visibility_fps: figure("visibility_fps")?,
            lag_frames: figure("lag_frames_mean")?,
            payload_bytes: figure("payload_bytes_mean")?,
            packets: figure("packets_mean")?,
            incomplete: figure("frames_incomplete")?,
        })
    }
}

/// Measures all rows, writes `pipeline.csv`, and reports each row to `progress`.
pub fn measure(options: &PipelineOptions, mut progress: impl FnMut(&str)) -> Result<Table> {
    let mut table = Table::new(
        "row | configuration | client frames/s | visibility frames/s | lag, frames | bytes/frame \
         | packets/frame | saving over words | incomplete frames | dissertation, frames/s",
    );
    for row in &ROWS {
        let runs = runs_of(row, options)?;
        let cells = cells(row, &runs, options.scene.size);
        progress(&cells.join("  "));
        table.rows.push(cells);
    }
    options.scene.write("pipeline.csv", &table.csv())?;
    Ok(table)
}

fn runs_of(row: &Row, options: &PipelineOptions) -> Result<Vec<Run>> {
    let server = match row.transport {
        None => None,
        Some(transport) => {
            let arguments = options.scene.server_arguments(transport, &options.backend, options.allow_software);
            Some(ServerProcess::start(&options.scene.file.scene, &arguments)?)
        }
    };
    let mut runs = Vec::new();
    for _ in 0..options.runs {
        let folder = tempfile::tempdir().context("making a temporary folder")?;
        let mut arguments: Vec<OsString> = row.wait.then(|| "--wait".into()).into_iter().collect();
        if server.is_some() {
            arguments.extend(["--codec".into(), row.codec.to_string().into()]);
        } else {
            arguments.extend(["--offline".into(), (&options.scene.file.scene).into()]);
            arguments.extend(options.scene.light_arguments());
        }
        let job = options.scene.client_job(
            server.as_ref().map(ServerProcess::url),
            folder.path(),
            arguments,
            options.allow_software,
        );
        job.start()?.finish(PATIENCE)?.success()?;
        runs.push(Run::read(&job.summary()?)?);
    }
    if let Some(server) = server {
        server.stop()?;
    }
    Ok(runs)
}

fn cells(row: &Row, runs: &[Run], (width, height): (u32, u32)) -> Vec<String> {
    let figure = |of: fn(&Run) -> f64, decimals: usize| {
        let values: Vec<_> = runs.iter().map(of).filter(|value| value.is_finite()).collect();
        median(&values).map_or("–".to_owned(), |value| format!("{value:.decimals$}"))
    };
    let words_bytes = 4.0 * f64::from(width) * f64::from(height);
    let payloads: Vec<_> = runs.iter().map(|run| run.payload_bytes).filter(|bytes| bytes.is_finite()).collect();
    // Uncompressed words save nothing: the frame header adds a few bytes.
    let compressed = row.transport.filter(|_| row.codec != CodecId::Words);
    let saving = compressed.and(median(&payloads)).map(|bytes| (1.0 - bytes / words_bytes) * 100.0);
    let configuration = match row.transport {
        Some(transport) => {
            format!("{} over {transport}, {}", row.codec, if row.wait { "waiting" } else { "not waiting" })
        }
        None => "no server".to_owned(),
    };
    vec![
        row.label.to_owned(),
        configuration,
        figure(|run| run.client_fps, 1),
        row.transport.map_or("–".to_owned(), |_| figure(|run| run.visibility_fps, 1)),
        row.transport.map_or("–".to_owned(), |_| figure(|run| run.lag_frames, 2)),
        row.transport.map_or("–".to_owned(), |_| figure(|run| run.payload_bytes, 0)),
        row.transport.map_or("–".to_owned(), |_| figure(|run| run.packets, 1)),
        saving.map_or("–".to_owned(), |percent| format!("{percent:.1} %")),
        row.transport.map_or("–".to_owned(), |_| figure(|run| run.incomplete, 0)),
        row.dissertation_fps.map_or("–".to_owned(), |fps| format!("{fps:.1}")),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rows_cells_are_medians_and_savings_over_uncompressed_words() {
        let summary = |fps: f64| {
            serde_json::json!({
                "client_fps": fps, "visibility_fps": fps, "lag_frames_mean": 0.0, "payload_bytes_mean": 27_648.0,
                "packets_mean": 1.0, "frames_incomplete": 0,
            })
        };
        let runs: Vec<_> = [30.0, 10.0, 20.0].iter().map(|&fps| Run::read(&summary(fps)).unwrap()).collect();
        let cells = cells(&ROWS[2], &runs, (640, 360));
        let expected =
            ["c", "words-lz4 over lab-udp, waiting", "20.0", "20.0", "0.00", "27648", "1.0", "97.0 %", "0", "35.5"];
        assert_eq!(cells, expected);
        assert_eq!(super::cells(&ROWS[0], &runs, (640, 360))[7], "–");
        let lacking = Run::read(&serde_json::json!({ "client_fps": 1.0 })).unwrap_err();
        assert!(lacking.to_string().contains("visibility_fps"));
    }

    #[test]
    fn without_a_server_there_is_nothing_to_transfer() {
        let run = Run {
            client_fps: 60.0,
            visibility_fps: 0.0,
            lag_frames: f64::NAN,
            payload_bytes: 0.0,
            packets: 0.0,
            incomplete: 0.0,
        };
        let expected = ["f", "no server", "60.0", "–", "–", "–", "–", "–", "–", "–"];
        assert_eq!(cells(&ROWS[6], &[run], (640, 360)), expected);
    }
}
