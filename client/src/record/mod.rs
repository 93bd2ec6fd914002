//! Recordings: everything that the renderer was told in a run, with when it was told and what the network did meanwhile.
//!
//! A recording is a line that names the format and its version, then records: each its length (u32, little-endian) and its postcard
//! bytes. Masks stand in it as they were used, so that [`replay`] needs no network to draw the same pictures. A recording ends by
//! itself when it is large; one that breaks off in the middle of a record is whole up to there.

pub mod replay;

use std::{
    fs::File,
    io::{BufWriter, Write as _},
    path::{Path, PathBuf},
};

use gnomon_protocol::{
    codec::{CodecId, Encoder},
    coverage::Coverage,
    mask::Mask,
    message::Welcome,
};
use gnomon_scene::camera::Camera;
use gnomon_shaders::gpu::Gpu;
use serde::{Deserialize, Serialize};

use crate::{
    error::ClientError,
    headless::stats::FrameStats,
    options::HeadlessOptions,
    predictor::Predictor,
    render::{debug_view::DebugView, exposure::Exposure},
};

/// First line of a recording.
pub const FIRST_LINE: &str = "gnomon recording 2\n";

/// Longest record, in bytes: a mask of noise as large as masks get.
pub const MAX_RECORD_BYTES: u32 = 128 << 20;

/// Where a recording ends by itself, in bytes.
pub const MAX_BYTES: u64 = 2 << 30;

/// A camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RecordedCamera {
    position_m: [f64; 3],
    orientation: [f64; 4],
    yfov_rad: f64,
    size_px: [u32; 2],
}

/// How a run begins.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Start {
    /// BLAKE3 digest of the packed scene; none offline.
    pub scene_digest: Option<String>,
    /// Width and height of the pictures, in pixels.
    pub size_px: [u32; 2],
    /// Exposure: from lux to exposed irradiance, and irradiance at the reference in lux.
    pub exposure: [f32; 2],
    /// How visibility is carried over at first.
    pub predictor: Predictor,
    /// The graphics adapter: on another one pictures may differ in their last bits.
    pub adapter: String,
}

/// When a frame was drawn, and what took how long.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// Since the first frame, in milliseconds.
    pub t_ms: f64,
    /// Handing over the G-buffer pass, in milliseconds.
    pub surfaces_ms: f64,
    /// Sending a mask to the adapter, in milliseconds.
    pub upload_ms: f64,
    /// Handing over the other passes, in milliseconds.
    pub shade_ms: f64,
    /// Waiting for the adapter or the screen, in milliseconds.
    pub readback_ms: f64,
    /// Frames that the mask is older.
    pub lag: Option<u32>,
    /// From a pose's departure until its mask was whole, in milliseconds, where a mask was taken.
    pub response_ms: Option<f64>,
}

/// One thing after another.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Record {
    /// The beginning; once, and first.
    Start(Start),
    /// Pictures have another size.
    Size([u32; 2]),
    /// Visibility is carried over in another way.
    Predictor(Predictor),
    /// Other lights shine, a bit each.
    LightsOn(u32),
    /// From this column on every light reaches everything.
    Split(Option<u32>),
    /// Something else is shown.
    View(DebugView),
    /// A mask has come.
    Mask {
        /// The frame that asked for it.
        frame: u32,
        /// What it was traced for.
        traced_for: RecordedCamera,
        /// The mask, as `planes-lz4` codes it.
        body: Vec<u8>,
        /// What of it had come, as [`Coverage::words`] has it; nothing is all.
        came: Option<Vec<u32>>,
    },
    /// A frame was drawn.
    Frame {
        /// Its number.
        frame: u32,
        /// The pose that it asked the server for.
        asked: RecordedCamera,
        /// The pose that it was drawn from.
        shown: RecordedCamera,
        /// How much received visibility counted.
        visibility_share: f32,
        /// How long it took.
        timing: Timing,
    },
    /// Something about the network.
    Event {
        /// The frame that noticed it.
        frame: u32,
        /// What it was.
        text: String,
    },
}

impl From<&Camera> for RecordedCamera {
    fn from(camera: &Camera) -> Self {
        Self {
            position_m: camera.position_m.to_array(),
            orientation: camera.orientation.to_array(),
            yfov_rad: camera.yfov_rad,
            size_px: [camera.width, camera.height],
        }
    }
}

impl From<&RecordedCamera> for Camera {
    fn from(camera: &RecordedCamera) -> Self {
        // Every bit as it was: a quaternion that is brought to unit length once more may be another one.
        Self {
            position_m: glam::DVec3::from_array(camera.position_m),
            orientation: glam::DQuat::from_array(camera.orientation),
            yfov_rad: camera.yfov_rad,
            width: camera.size_px[0],
            height: camera.size_px[1],
        }
    }
}

impl From<&FrameStats> for Timing {
    fn from(stats: &FrameStats) -> Self {
        Self {
            t_ms: stats.t_ms,
            surfaces_ms: stats.surfaces_ms,
            upload_ms: stats.upload_ms,
            shade_ms: stats.shade_ms,
            readback_ms: stats.readback_ms,
            lag: stats.lag,
            response_ms: stats.response_ms,
        }
    }
}

/// Writes a recording.
pub(crate) struct Recorder {
    path: PathBuf,
    file: BufWriter<File>,
    encoder: Encoder,
    bytes: u64,
    full: bool,
}

impl Recorder {
    /// Begins the recording that `options` ask for, if they do, of pictures of `size` pixels.
    pub(crate) fn for_run(
        options: &HeadlessOptions,
        (width, height): (u32, u32),
        welcome: Option<&Welcome>,
        exposure: Exposure,
        gpu: &Gpu,
    ) -> Result<Option<Self>, ClientError> {
        let Some(path) = &options.record else { return Ok(None) };
        let start = Start {
            scene_digest: welcome.map(|welcome| welcome.scene_digest.to_string()),
            size_px: [width, height],
            exposure: exposure.into(),
            predictor: options.predictor,
            adapter: gpu.info.name.clone(),
        };
        Self::create(path, start).map(Some)
    }

    /// Makes the file anew.
    pub(crate) fn create(path: &Path, start: Start) -> Result<Self, ClientError> {
        let failed = |source| ClientError::Write { path: path.into(), source };
        let mut file = BufWriter::new(File::create(path).map_err(failed)?);
        file.write_all(FIRST_LINE.as_bytes()).map_err(failed)?;
        let encoder = Encoder::new(CodecId::PlanesLz4);
        let mut recorder = Self { path: path.into(), file, encoder, bytes: FIRST_LINE.len() as u64, full: false };
        recorder.write(&Record::Start(start))?;
        Ok(recorder)
    }

    /// Adds a mask.
    pub(crate) fn mask(
        &mut self,
        frame: u32,
        traced_for: &Camera,
        (mask, coverage): (&Mask, &Coverage),
    ) -> Result<(), ClientError> {
        if self.full {
            return Ok(());
        }
        let mut body = Vec::new();
        let encoded = self.encoder.encode(mask, &mut body);
        encoded.map_err(|error| self.failed(std::io::Error::other(error)))?;
        let came = (!coverage.is_whole()).then(|| coverage.words().to_vec());
        self.write(&Record::Mask { frame, traced_for: traced_for.into(), body, came })
    }

    /// Adds a record. Beyond the largest size nothing is added any more.
    pub(crate) fn write(&mut self, record: &Record) -> Result<(), ClientError> {
        if self.full {
            return Ok(());
        }
        let bytes = postcard::to_stdvec(record).map_err(|error| self.failed(std::io::Error::other(error)))?;
        let length = u32::try_from(bytes.len()).ok().filter(|length| *length <= MAX_RECORD_BYTES);
        let length = length.ok_or_else(|| self.failed(std::io::Error::other("a record is too long")))?;
        self.bytes += u64::from(length) + 4;
        self.full = self.bytes > MAX_BYTES;
        if self.full {
            tracing::warn!(path = %self.path.display(), "the recording is full, and ends here");
            return Ok(());
        }
        let written = self.file.write_all(&length.to_le_bytes()).and_then(|()| self.file.write_all(&bytes));
        written.map_err(|source| self.failed(source))
    }

    /// Writes what is still in memory.
    pub(crate) fn finish(mut self) -> Result<(), ClientError> {
        let flushed = self.file.flush();
        flushed.map_err(|source| self.failed(source))
    }

    fn failed(&self, source: std::io::Error) -> ClientError {
        ClientError::Write { path: self.path.clone(), source }
    }
}
