//! Output of a headless run: a line for each frame, and a summary at the end.

use std::{
    fs::File,
    io::{LineWriter, Write as _},
    path::{Path, PathBuf},
};

pub use gnomon_client_core::frame::stats::{FrameStats, mean, millis, percentile};
use serde::Serialize;

use crate::{error::ClientError, mode::Mode, pose_history::Rejections};

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    pub frames_rendered: u32,
    /// Pictures shaded with a mask.
    pub frames_with_mask: u32,
    /// Masks received whole.
    pub frames_received: u64,
    /// Masks from which the server omitted parts because the network lacked capacity.
    pub frames_cut: u64,
    /// Masks shown although some tiles were missing.
    pub frames_partial: u64,
    /// Masks received in part and not shown.
    pub frames_incomplete: u64,
    /// Complete frames that are not masks of the agreed shape.
    pub frames_bad: u64,
    /// Poses sent again because their mask did not arrive (`--wait`).
    pub poses_repeated: u32,
    /// Complete masks that were not used, by cause.
    pub masks_rejected: Rejections,
    /// Share of pictures drawn while masks were too late or absent.
    pub degraded_share: Option<f64>,
    /// Mean share of pixels whose visibility came from a mask.
    pub known_share_mean: Option<f64>,
    /// Mean age of the masks in frames.
    pub lag_frames_mean: Option<f64>,
    pub lag_frames_p50: Option<f64>,
    pub lag_frames_p99: Option<f64>,
    /// Mean time from sending a pose to its mask, for frames shaded with their own mask.
    pub response_ms_mean: Option<f64>,
    pub response_ms_p99: Option<f64>,
    /// Pictures a second, from the first pose until the last picture was complete.
    pub client_fps: f64,
    /// Masks a second over the same time.
    pub visibility_fps: Option<f64>,
    /// Mean size of a mask on the wire, without headers.
    pub payload_bytes_mean: Option<f64>,
    pub packets_mean: Option<f64>,
    /// Smoothed round trip of pings.
    pub rtt_ms: Option<f64>,
    /// Duration of the run from the first pose.
    pub duration_s: f64,
    /// `WIDTHxHEIGHT` in pixels.
    pub size: String,
    pub lights: u32,
    /// BLAKE3 digest of the packed scene; `None` offline.
    pub scene_digest: Option<String>,
    pub adapter: String,
    /// The server's tracing device.
    pub backend: Option<String>,
    pub codec: Option<String>,
    /// Share of mask bits that may be wrong.
    pub lossy_percent: f64,
    /// `quic`, `lab-udp`, `lab-tcp`, or `offline`.
    pub transport: String,
    /// True if each frame waited for its own mask.
    pub wait: bool,
    pub predictor: String,
    pub mode: Mode,
    /// The requested guard band.
    pub guard: String,
    /// True if the server traced for predicted poses.
    pub predict_pose: bool,
    /// Why the server was first lost, if it was.
    pub connection_lost: Option<String>,
    /// How often a lost or draining server was replaced by a new connection.
    pub reconnects: u32,
    /// Edits that the server refused.
    pub edits_refused: u64,
    /// Why there was no server when the run ended, if there was none.
    pub lost_at_end: Option<String>,
    /// What ended the run early: `SIGINT`, `SIGTERM` or `SIGHUP`.
    pub stopped_by: Option<&'static str>,
    /// As `--exposure` takes it.
    pub exposure_ev: f32,
    pub path: String,
}

/// Writes [`FrameStats`], one line each. Whatever ends the program, the file ends with a whole line.
#[derive(Debug)]
pub struct StatsFile {
    path: PathBuf,
    file: LineWriter<File>,
    /// Length of the lines written so far.
    whole_bytes: u64,
}

impl StatsFile {
    /// Creates or truncates the file.
    ///
    /// # Errors
    /// If it cannot be created.
    pub fn create(path: &Path) -> Result<Self, ClientError> {
        let file = File::create(path).map_err(|source| ClientError::Write { path: path.into(), source })?;
        Ok(Self { path: path.into(), file: LineWriter::new(file), whole_bytes: 0 })
    }

    /// Appends a line.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&mut self, stats: &FrameStats) -> Result<(), ClientError> {
        let line = serde_json::to_vec(stats).map_err(std::io::Error::from);
        let written = line.and_then(|mut line| {
            line.push(b'\n');
            self.file.write_all(&line)?;
            self.whole_bytes += line.len() as u64;
            Ok(())
        });
        written.map_err(|source| {
            // A full disk may have taken a part of the line. Pipes and devices have no length.
            let _ = self.file.get_ref().set_len(self.whole_bytes);
            ClientError::Write { path: self.path.clone(), source }
        })
    }

    /// Flushes the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish(mut self) -> Result<(), ClientError> {
        self.file.flush().map_err(|source| ClientError::Write { path: self.path, source })
    }
}

impl Summary {
    #[must_use]
    pub fn to_json(&self) -> String {
        // Never fails: there are no maps or bytes.
        serde_json::to_string_pretty(self).unwrap_or_default()
    }

    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), ClientError> {
        std::fs::write(path, self.to_json() + "\n").map_err(|source| {
            // A truncated summary is worse than none. A device or a pipe stays.
            if std::fs::symlink_metadata(path).is_ok_and(|file| file.is_file()) {
                let _ = std::fs::remove_file(path);
            }
            ClientError::Write { path: path.into(), source }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mode::State;

    fn summary() -> Summary {
        Summary {
            frames_rendered: 3,
            frames_with_mask: 2,
            frames_received: 2,
            frames_cut: 0,
            frames_partial: 0,
            frames_incomplete: 1,
            frames_bad: 0,
            poses_repeated: 0,
            masks_rejected: Rejections::default(),
            degraded_share: Some(0.25),
            known_share_mean: Some(0.97),
            lag_frames_mean: Some(0.5),
            lag_frames_p50: Some(0.0),
            lag_frames_p99: Some(1.0),
            response_ms_mean: None,
            response_ms_p99: None,
            client_fps: 30.0,
            visibility_fps: Some(20.0),
            payload_bytes_mean: Some(1000.0),
            packets_mean: Some(1.0),
            rtt_ms: None,
            duration_s: 0.1,
            size: "640x360".into(),
            lights: 8,
            scene_digest: None,
            adapter: "test".into(),
            backend: None,
            codec: None,
            lossy_percent: 0.0,
            transport: "offline".into(),
            wait: false,
            predictor: "surface".into(),
            mode: Mode::Auto,
            guard: "0x0".into(),
            predict_pose: false,
            connection_lost: None,
            reconnects: 0,
            edits_refused: 0,
            lost_at_end: None,
            stopped_by: None,
            exposure_ev: 3.5,
            path: "default".into(),
        }
    }

    #[test]
    fn the_summary_has_the_keys_that_scripts_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("summary.json");
        summary().write(&file).unwrap();
        let value: serde_json::Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
        for name in [
            "frames_rendered",
            "frames_received",
            "frames_cut",
            "frames_partial",
            "frames_incomplete",
            "lag_frames_mean",
            "lag_frames_p50",
            "lag_frames_p99",
            "degraded_share",
            "known_share_mean",
            "masks_rejected",
            "mode",
            "connection_lost",
            "reconnects",
            "lost_at_end",
            "stopped_by",
            "client_fps",
            "visibility_fps",
            "payload_bytes_mean",
            "packets_mean",
            "rtt_ms",
            "size",
            "lights",
            "scene_digest",
            "adapter",
            "codec",
            "lossy_percent",
            "transport",
        ] {
            assert!(value.get(name).is_some(), "{name}");
        }
        assert_eq!((&value["size"], &value["client_fps"]), (&"640x360".into(), &30.0.into()));
        let nowhere = summary().write(&folder.path().join("no/such/folder.json")).unwrap_err();
        assert!(nowhere.to_string().starts_with("cannot write"), "{nowhere}");
    }

    #[test]
    fn a_frame_is_a_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("stats.jsonl");
        let mut file = StatsFile::create(&path).unwrap();
        for frame in 0..3 {
            let stats = FrameStats {
                frame,
                t_ms: 1.5,
                state: State::Degraded,
                link: "live",
                visibility_share: 0.5,
                known_share: None,
                mask_frame: None,
                lag: None,
                age_ms: None,
                mask_width: 64,
                mask_height: 36,
                look_ahead_ms: 0,
                response_ms: None,
                surfaces_ms: 0.0,
                wait_ms: 0.0,
                upload_ms: 0.0,
                shade_ms: 0.0,
                readback_ms: 0.0,
                bytes: Some(12),
                packets: Some(1),
            };
            file.write(&stats).unwrap();
        }
        file.finish().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<serde_json::Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(lines.iter().map(|line| line["frame"].as_u64().unwrap()).collect::<Vec<_>>(), [0, 1, 2]);
        assert_eq!((&lines[0]["mask_frame"], &lines[0]["bytes"]), (&serde_json::Value::Null, &12.into()));
        assert_eq!((&lines[0]["state"], &lines[0]["visibility_share"]), (&"degraded".into(), &0.5.into()));
    }
}
