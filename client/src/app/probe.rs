//! A client without a renderer, for measuring servers: sends poses, receives masks, records response times.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use gnomon_protocol::{
    codec::CodecId,
    ids::{BearerToken, FrameNumber},
    mask::MaskShape,
    pose::Pose,
};
use tokio::runtime::Handle;

use crate::{
    camera_path::CameraPath,
    error::ClientError,
    headless::stats::millis,
    link::{
        mask_buffer::{MaskReader, Waited},
        pending_session::PendingSession,
        receive_options::Reception,
        session::Session,
        session_spec::{SessionOptions, rate_hz},
        url::ServerUrl,
    },
    stop::Stop,
};

/// Time after which the probe requests the next frame instead.
const MASK_TIMEOUT: Duration = Duration::from_secs(5);

#[derive(Debug, Clone)]
pub struct ProbeOptions {
    pub url: ServerUrl,
    pub token: Option<String>,
    /// In pixels.
    pub width: u32,
    /// In pixels.
    pub height: u32,
    pub codec: CodecId,
    pub frames: u32,
    /// Poses a second; `None` sends each pose after the last one's mask arrived.
    pub fps: Option<f64>,
    /// Time of the first pose on the path.
    pub start_time_s: f64,
    pub connect_timeout: Duration,
}

impl ProbeOptions {
    /// Default of `connect_timeout`.
    pub const CONNECT_TIMEOUT: Duration = MASK_TIMEOUT;
}

#[derive(Debug, Clone)]
pub struct ProbeReport {
    pub backend: String,
    pub poses: u32,
    /// Complete masks.
    pub masks: u64,
    /// Frames that arrived only in part.
    pub incomplete: u64,
    /// From the first pose to the last mask.
    pub duration: Duration,
    /// From sending a pose to decoding its mask, in milliseconds, for each mask.
    pub responses_ms: Vec<f64>,
    /// Size of all masks, without packet headers.
    pub payload_bytes: u64,
    pub packets: u64,
}

/// Runs one probe to its end. Blocks the calling thread; the network runs on `runtime`.
///
/// # Errors
/// Errors if the server cannot be reached, refuses, or ends the session.
pub fn run_probe(runtime: &Handle, options: &ProbeOptions, path: &CameraPath) -> Result<ProbeReport, ClientError> {
    let session = SessionOptions {
        token: options.token.clone().map(BearerToken::from),
        width: options.width,
        height: options.height,
        codec: options.codec,
        rate_hz: rate_hz(options.fps),
        wrong_ppm: 0,
        resume: None,
        connect_timeout: options.connect_timeout,
        stop: Stop::default(),
    };
    let pending = runtime.block_on(PendingSession::open(&options.url, &session))?;
    let backend = pending.welcome.backend.to_string();
    let shape = MaskShape::new(options.width, options.height, pending.welcome.lights)?;
    let (session, masks) = runtime.block_on(pending.start(shape, Reception::default()))?;
    let mut probe = Probe { session, masks, awaited: VecDeque::new(), responses_ms: Vec::new() };
    let begun = Instant::now();
    let ran = probe.run(options, path, begun);
    let duration = begun.elapsed();
    let received = probe.session.received();
    runtime.block_on(probe.session.leave());
    ran?;
    Ok(ProbeReport {
        backend,
        poses: options.frames,
        masks: received.frames,
        incomplete: received.incomplete,
        duration,
        responses_ms: probe.responses_ms,
        payload_bytes: received.payload_bytes,
        packets: received.packets,
    })
}

struct Probe {
    session: Session,
    masks: MaskReader,
    /// Frames whose masks are missing, and when their poses were sent.
    awaited: VecDeque<(FrameNumber, Instant)>,
    responses_ms: Vec<f64>,
}

impl Probe {
    fn run(&mut self, options: &ProbeOptions, path: &CameraPath, begun: Instant) -> Result<(), ClientError> {
        let step_s = options.fps.map_or(1.0 / 60.0, f64::recip);
        for frame in 0..options.frames {
            let now = Instant::now();
            let time_s = options.start_time_s + f64::from(frame) * step_s;
            let pose = pose(path, time_s, now - begun, [options.width, options.height]);
            self.session.send_pose(FrameNumber(frame), pose);
            self.awaited.push_back((FrameNumber(frame), now));
            if options.fps.is_some() {
                let next = begun + Duration::from_secs_f64(f64::from(frame + 1) * step_s);
                while self.wait_for_mask(next)? {}
            } else if !self.wait_for_mask(now + MASK_TIMEOUT)? {
                self.awaited.clear();
            }
        }
        // Masks in flight count while they arrive without a pause.
        while !self.awaited.is_empty() && self.wait_for_mask(Instant::now() + Duration::from_millis(500))? {}
        Ok(())
    }

    /// Waits until `deadline` for a mask. Returns whether one arrived. Earlier frames are given up.
    fn wait_for_mask(&mut self, deadline: Instant) -> Result<bool, ClientError> {
        match self.masks.wait_for_any(deadline) {
            Waited::Arrived => {}
            Waited::TimedOut | Waited::Lost => return Ok(false),
            Waited::Ended(reason) => {
                let rendered = u32::try_from(self.responses_ms.len()).unwrap_or(u32::MAX);
                return Err(ClientError::Ended { rendered, wanted: rendered.saturating_add(1), reason });
            }
        }
        if let Some(mask) = self.masks.front() {
            while let Some((frame, sent)) = self.awaited.pop_front_if(|(frame, _)| *frame <= mask.frame) {
                if frame == mask.frame {
                    self.responses_ms.push(millis(mask.received_at.saturating_duration_since(sent)));
                }
            }
        }
        Ok(true)
    }
}

/// Returns the pose at a time on the repeating path.
fn pose(path: &CameraPath, time_s: f64, since_first: Duration, size: [u32; 2]) -> Pose {
    let duration_s = path.duration_s();
    let on_path_s = if duration_s > 0.0 { time_s % duration_s } else { 0.0 };
    let camera = path.camera(on_path_s, 1, 1);
    #[expect(clippy::cast_possible_truncation, reason = "milliseconds modulo 2³²")]
    let client_time_ms = since_first.as_millis() as u32;
    Pose {
        position_m: camera.position_m.to_array(),
        orientation: camera.orientation.to_array(),
        yfov_rad: camera.yfov_rad,
        scene_time_s: time_s,
        client_time_ms,
        // Sides are at most 4096.
        mask_px: size.map(|side| u16::try_from(side).unwrap_or(u16::MAX)),
        look_ahead_ms: 0,
        revision: 0,
    }
}
