//! Writing a recording.

use std::{
    fs::File,
    io::{BufWriter, Write as _},
    path::{Path, PathBuf},
};

use gnomon_client_core::camera::Viewpoint;
use gnomon_protocol::{
    codec::{CodecId, EncodedFrame, Encoder},
    coverage::Coverage,
    mask::Mask,
    message::Welcome,
};
use gnomon_shaders::gpu::Gpu;

use super::format::{FIRST_LINE, MAX_BYTES, MAX_RECORD_BYTES, Record, Start};
use crate::{error::ClientError, options::HeadlessOptions, render::FrameRenderer};

pub(crate) struct Recorder {
    path: PathBuf,
    file: BufWriter<File>,
    encoder: Encoder,
    bytes: u64,
    full: bool,
}

impl Recorder {
    /// Starts the recording of a renderer's pictures, if `options` request one. `width` and `height` are in pixels.
    pub(crate) fn for_run(
        options: &HeadlessOptions,
        (width, height): (u32, u32),
        welcome: Option<&Welcome>,
        renderer: &FrameRenderer,
        gpu: &Gpu,
    ) -> Result<Option<Self>, ClientError> {
        let Some(path) = &options.record else { return Ok(None) };
        let start = Start {
            scene_digest: welcome.map(|welcome| welcome.scene_digest.to_string()),
            size_px: [width, height],
            exposure: renderer.exposure().into(),
            tone: renderer.tone(),
            environment: options.settings.environment.clone(),
            survey: renderer.environment().1,
            predictor: options.settings.predict,
            quality: options.settings.quality,
            adapter: gpu.info.name.clone(),
        };
        Self::create(path, start).map(Some)
    }

    fn create(path: &Path, start: Start) -> Result<Self, ClientError> {
        let failed = |source| ClientError::Write { path: path.into(), source };
        let mut file = BufWriter::new(File::create(path).map_err(failed)?);
        file.write_all(FIRST_LINE.as_bytes()).map_err(failed)?;
        let encoder = Encoder::new(CodecId::PlanesLz4);
        let mut recorder = Self { path: path.into(), file, encoder, bytes: FIRST_LINE.len() as u64, full: false };
        recorder.write(&Record::Start(start))?;
        Ok(recorder)
    }

    pub(crate) fn write_mask(
        &mut self,
        frame: u32,
        traced_for: &Viewpoint,
        (mask, coverage): (&Mask, &Coverage),
    ) -> Result<(), ClientError> {
        if self.full {
            return Ok(());
        }
        let mut encoded_mask = EncodedFrame::default();
        let encoded = self.encoder.encode(mask, &mut encoded_mask);
        encoded.map_err(|error| self.failed(std::io::Error::other(error)))?;
        let coverage = (!coverage.is_whole()).then(|| coverage.words().to_vec());
        let Viewpoint { camera, scene } = traced_for;
        let (body, edits) = (encoded_mask.into_body(), scene.edits.as_ref().clone());
        self.write(&Record::Mask {
            frame,
            traced_for: camera.into(),
            scene_time_s: scene.time_s,
            edits,
            body,
            coverage,
        })
    }

    /// Adds a record, unless the recording is full.
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
            tracing::warn!(path = %self.path.display(), "the recording has reached its largest size and ends here");
            return Ok(());
        }
        let written = self.file.write_all(&length.to_le_bytes()).and_then(|()| self.file.write_all(&bytes));
        written.map_err(|source| self.failed(source))
    }

    pub(crate) fn finish(mut self) -> Result<(), ClientError> {
        let flushed = self.file.flush();
        flushed.map_err(|source| self.failed(source))
    }

    fn failed(&self, source: std::io::Error) -> ClientError {
        ClientError::Write { path: self.path.clone(), source }
    }
}
