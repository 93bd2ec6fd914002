//! Replays a recording: the same calls to the renderer give the same pictures, bit for bit, on the same adapter.

use std::{
    fs::File,
    io::{BufReader, Read},
    path::Path,
    sync::Arc,
};

use gnomon_protocol::{
    codec::{DecodeError, Decoder},
    coverage::Coverage,
    mask::{Mask, MaskShape, ShapeError},
};
use gnomon_scene::{Scene, SceneAt, camera::Camera};
use gnomon_shaders::gpu::Gpu;
use thiserror::Error;

use super::format::{FIRST_LINE, MAX_RECORD_BYTES, Record, Start};
use crate::environment::EnvironmentError;
use crate::render::{
    FrameRenderer, PICTURE_FORMAT, RenderError,
    predict::MaskView,
    readback::{Picture, PictureReader},
};

#[derive(Debug, Error)]
pub enum ReplayError {
    #[error("cannot read the recording: {0}")]
    Read(#[from] std::io::Error),
    /// Not a recording, or one of another version.
    #[error("this is no recording of this version: it does not begin with {:?}", FIRST_LINE.trim_end())]
    Version,
    #[error("record {number}: {reason}")]
    Malformed { number: u64, reason: String },
    #[error("a recorded mask: {0}")]
    Shape(#[from] ShapeError),
    #[error("a recorded mask: {0}")]
    Decode(#[from] DecodeError),
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
    #[error(transparent)]
    Render(#[from] RenderError),
}

/// Reads the records of a file in order.
pub struct Records {
    file: BufReader<File>,
    number: u64,
}

impl Records {
    /// Opens a recording and reads its first record.
    ///
    /// # Errors
    /// Errors if the file cannot be read or is not a recording.
    pub fn open(path: &Path) -> Result<(Start, Self), ReplayError> {
        let mut file = BufReader::new(File::open(path)?);
        let mut line = [0; FIRST_LINE.len()];
        if file.read_exact(&mut line).is_err() || line != FIRST_LINE.as_bytes() {
            return Err(ReplayError::Version);
        }
        let mut records = Self { file, number: 0 };
        match records.next()? {
            Some(Record::Start(start)) => Ok((start, records)),
            _ => Err(ReplayError::Malformed { number: 0, reason: "not a start".to_owned() }),
        }
    }

    /// Returns the next record. `None` at the end, and where the file was cut off within a record.
    ///
    /// # Errors
    /// Errors if the file cannot be read or the record is malformed.
    #[expect(clippy::should_implement_trait, reason = "an iterator would hide where it fails")]
    pub fn next(&mut self) -> Result<Option<Record>, ReplayError> {
        let mut length = [0; 4];
        let mut bytes = Vec::new();
        let malformed = |number, reason: String| ReplayError::Malformed { number, reason };
        if fill(&mut self.file, &mut length)? {
            let length = u32::from_le_bytes(length);
            if length > MAX_RECORD_BYTES {
                return Err(malformed(self.number, format!("{length} bytes: at most {MAX_RECORD_BYTES} are allowed")));
            }
            // Allocates for the bytes that exist, not for the claimed length.
            let read = (&mut self.file).take(length.into()).read_to_end(&mut bytes)?;
            if read == length as usize {
                let record = postcard::from_bytes(&bytes).map_err(|error| malformed(self.number, error.to_string()))?;
                self.number += 1;
                return Ok(Some(record));
            }
        }
        Ok(None)
    }
}

/// Fills `bytes`. Returns false if the file ends first.
fn fill(file: &mut impl Read, bytes: &mut [u8]) -> Result<bool, std::io::Error> {
    match file.read_exact(bytes) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(error),
    }
}

/// What [`replay`] passes to its caller.
pub enum Replayed<'a> {
    Picture {
        picture: Picture,
        /// View that the picture shows.
        shown: Camera,
        scene: SceneAt,
        /// Weight of received visibility, 0 to 1.
        visibility_share: f32,
        renderer: &'a FrameRenderer,
    },
    /// Any record, after it was applied.
    Record(&'a Record),
}

/// Draws the frames of `records` whose numbers are `wanted`. Passes each picture and every record to `visit`.
///
/// # Errors
/// Errors if the recording is malformed, the adapter fails, or `visit` does.
pub fn replay<E: From<ReplayError>>(
    gpu: &Gpu,
    scene: &Scene,
    start: &Start,
    records: &mut Records,
    wanted: impl Fn(u32) -> bool,
    mut visit: impl FnMut(Replayed<'_>) -> Result<(), E>,
) -> Result<(), E> {
    let render = |error: RenderError| E::from(ReplayError::Render(error));
    let ([width, height], exposure) = (start.size_px, start.exposure.into());
    let renderer = FrameRenderer::new(gpu, scene, (width, height), exposure, PICTURE_FORMAT, start.predictor);
    let mut renderer = renderer.map_err(render)?;
    renderer.set_quality(start.quality);
    let environment = start.environment.open().map_err(|error| E::from(error.into()))?;
    renderer.set_environment(environment, start.survey);
    renderer.set_tone(start.tone);
    let mut reader = PictureReader::new(gpu, width, height, 1);
    let mut decoder = Decoder::new();
    let mut newest_mask_frame = None;
    while let Some(record) = records.next().map_err(E::from)? {
        match &record {
            Record::Start(_) => {
                let reason = "a second start".to_owned();
                return Err(ReplayError::Malformed { number: records.number - 1, reason }.into());
            }
            Record::Size([width, height]) => {
                renderer.resize((*width, *height)).map_err(render)?;
                reader = PictureReader::new(gpu, *width, *height, 1);
            }
            Record::Predictor(predictor) => renderer.set_predictor(*predictor),
            Record::Quality(quality) => renderer.set_quality(*quality),
            Record::Tone(tone) => renderer.set_tone(*tone),
            Record::Exposure(exposure) => renderer.set_exposure((*exposure).into()),
            Record::LightsOn(lights) => renderer.set_lights_on(*lights),
            Record::Split(split) => renderer.set_split(*split),
            Record::View(view) => renderer.set_debug_view(*view),
            Record::Mask { frame, traced_for, scene_time_s, edits, body, coverage } => {
                let at = SceneAt { time_s: *scene_time_s, edits: Arc::new(edits.clone()) };
                let traced_for = Camera::from(traced_for);
                let lights = u32::try_from(scene.lights.len()).unwrap_or(u32::MAX);
                let shape = MaskShape::new(traced_for.width, traced_for.height, lights).map_err(ReplayError::from);
                let mut mask = Mask::new(shape.map_err(E::from)?);
                decoder.decode(body, &mut mask).map_err(|error| E::from(ReplayError::from(error)))?;
                let coverage = coverage.clone().map(|words| {
                    let reason = "the coverage of a mask of another shape".to_owned();
                    Coverage::from_words(mask.shape(), words)
                        .ok_or(ReplayError::Malformed { number: records.number - 1, reason })
                });
                let coverage = coverage.transpose()?;
                let more = newest_mask_frame.replace(*frame) == Some(*frame);
                let coverage = coverage.as_ref();
                let view = MaskView { mask: &mask, coverage, more, traced_for: &traced_for, scene: &at };
                renderer.set_mask(Some(view)).map_err(render)?;
            }
            Record::Frame { frame, .. } if !wanted(*frame) => {}
            Record::Frame { frame, shown, scene_time_s, edits, visibility_share, .. } => {
                let shown = Camera::from(shown);
                let scene = SceneAt { time_s: *scene_time_s, edits: Arc::new(edits.clone()) };
                renderer.set_time(&scene);
                renderer.draw_surfaces(&shown).map_err(render)?;
                let target = reader.target();
                let shaded = renderer.shade(&shown, *visibility_share, &target, |encoder| reader.copy(encoder));
                reader.submitted((*frame).into(), shaded.map_err(render)?, true);
                if let Some(picture) = reader.take_oldest().map_err(render)?.flatten() {
                    let visibility_share = *visibility_share;
                    let renderer = &renderer;
                    visit(Replayed::Picture { picture, shown, scene, visibility_share, renderer })?;
                }
            }
            Record::Event { .. } => {}
        }
        visit(Replayed::Record(&record))?;
    }
    Ok(())
}
