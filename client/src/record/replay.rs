//! Draws a recording again: the same calls to the same renderer, so the same pictures to the last bit on the same adapter.

use std::{
    fs::File,
    io::{BufReader, Read},
    path::Path,
};

use gnomon_protocol::{
    codec::{DecodeError, Decoder},
    coverage::Coverage,
    mask::{Mask, MaskShape, ShapeError},
};
use gnomon_scene::{Scene, camera::Camera};
use gnomon_shaders::gpu::Gpu;
use thiserror::Error;

use super::{FIRST_LINE, MAX_RECORD_BYTES, Record, Start};
use crate::render::{
    FrameRenderer, PICTURE_FORMAT, RenderError,
    exposure::Exposure,
    predict::MaskView,
    readback::{Picture, PictureReader},
};

/// Why a recording cannot be drawn.
#[derive(Debug, Error)]
pub enum ReplayError {
    /// It cannot be read.
    #[error("cannot read the recording: {0}")]
    Read(#[from] std::io::Error),
    /// It is no recording, or of another version.
    #[error("this is no recording of this version: it does not begin with {:?}", FIRST_LINE.trim_end())]
    Version,
    /// A record is not what it should be.
    #[error("record {number}: {reason}")]
    Malformed {
        /// Its number, from 0.
        number: u64,
        /// What is wrong.
        reason: String,
    },
    /// A mask has an impossible shape.
    #[error("a recorded mask: {0}")]
    Shape(#[from] ShapeError),
    /// A mask does not decode.
    #[error("a recorded mask: {0}")]
    Decode(#[from] DecodeError),
    /// The adapter failed.
    #[error(transparent)]
    Render(#[from] RenderError),
}

/// The records of a file, one after the other.
pub struct Records {
    file: BufReader<File>,
    number: u64,
}

impl Records {
    /// Opens a recording, and reads how it begins.
    ///
    /// # Errors
    /// When it cannot be read or is no recording.
    pub fn open(path: &Path) -> Result<(Start, Self), ReplayError> {
        let mut file = BufReader::new(File::open(path)?);
        let mut line = [0; FIRST_LINE.len()];
        if file.read_exact(&mut line).is_err() || line != FIRST_LINE.as_bytes() {
            return Err(ReplayError::Version);
        }
        let mut records = Self { file, number: 0 };
        match records.next()? {
            Some(Record::Start(start)) => Ok((start, records)),
            _ => Err(ReplayError::Malformed { number: 0, reason: "it is not the beginning".to_owned() }),
        }
    }

    /// The next record, until there is none. One that breaks off is none.
    ///
    /// # Errors
    /// When it cannot be read or is no record.
    #[expect(clippy::should_implement_trait, reason = "an iterator would hide where it fails")]
    pub fn next(&mut self) -> Result<Option<Record>, ReplayError> {
        let mut length = [0; 4];
        let mut bytes = Vec::new();
        let malformed = |number, reason: String| ReplayError::Malformed { number, reason };
        if read_whole(&mut self.file, &mut length)? {
            let length = u32::from_le_bytes(length);
            if length > MAX_RECORD_BYTES {
                return Err(malformed(self.number, format!("{length} bytes are too many")));
            }
            // Memory is taken for what is there, not for what is said to be there.
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

/// Whether all of `bytes` were there.
fn read_whole(file: &mut impl Read, bytes: &mut [u8]) -> Result<bool, std::io::Error> {
    match file.read_exact(bytes) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(error),
    }
}

/// What a replay hands out.
pub enum Replayed<'a> {
    /// A frame's picture.
    Picture {
        /// The picture.
        picture: Picture,
        /// The view that it shows.
        shown: Camera,
        /// How much received visibility counts.
        visibility_share: f32,
        /// What has just drawn it.
        renderer: &'a FrameRenderer,
    },
    /// A record that draws nothing.
    Record(&'a Record),
}

/// Draws those frames of `records` that are `wanted`, by their numbers, and hands out each picture and every record.
///
/// # Errors
/// When the recording breaks a rule, the adapter fails, or `take` does.
pub fn replay<E: From<ReplayError>>(
    gpu: &Gpu,
    scene: &Scene,
    start: &Start,
    records: &mut Records,
    wanted: impl Fn(u32) -> bool,
    mut take: impl FnMut(Replayed<'_>) -> Result<(), E>,
) -> Result<(), E> {
    let render = |error: RenderError| E::from(ReplayError::Render(error));
    let ([width, height], [scale, reference_lux]) = (start.size_px, start.exposure);
    let exposure = Exposure { scale, reference_lux };
    let renderer = FrameRenderer::new(gpu, scene, (width, height), exposure, PICTURE_FORMAT, start.predictor);
    let mut renderer = renderer.map_err(render)?;
    let mut reader = PictureReader::new(gpu, width, height, 1);
    let mut decoder = Decoder::new();
    // The frame of the newest mask.
    let mut newest = None;
    while let Some(record) = records.next().map_err(E::from)? {
        match &record {
            Record::Start(_) => {
                let reason = "it begins twice".to_owned();
                return Err(ReplayError::Malformed { number: records.number - 1, reason }.into());
            }
            Record::Size([width, height]) => {
                renderer.resize((*width, *height)).map_err(render)?;
                reader = PictureReader::new(gpu, *width, *height, 1);
            }
            Record::Predictor(predictor) => renderer.set_predictor(*predictor),
            Record::LightsOn(lights) => renderer.set_lights_on(*lights),
            Record::Split(split) => renderer.set_split(*split),
            Record::View(view) => renderer.set_debug_view(*view),
            Record::Mask { frame, traced_for, body, came } => {
                let traced_for = Camera::from(traced_for);
                let lights = u32::try_from(scene.lights.len()).unwrap_or(u32::MAX);
                let shape = MaskShape::new(traced_for.width, traced_for.height, lights).map_err(ReplayError::from);
                let mut mask = Mask::new(shape.map_err(E::from)?);
                decoder.decode(body, &mut mask).map_err(|error| E::from(ReplayError::from(error)))?;
                let coverage = came.clone().map(|words| {
                    let reason = "a mask with more or fewer places than it has".to_owned();
                    Coverage::from_words(mask.shape(), words)
                        .ok_or(ReplayError::Malformed { number: records.number - 1, reason })
                });
                let coverage = coverage.transpose()?;
                let more = newest.replace(*frame) == Some(*frame);
                let view = MaskView { mask: &mask, coverage: coverage.as_ref(), more, traced_for: &traced_for };
                renderer.set_mask(Some(view)).map_err(render)?;
            }
            Record::Frame { frame, .. } if !wanted(*frame) => {}
            Record::Frame { frame, shown, visibility_share, .. } => {
                let shown = Camera::from(shown);
                renderer.draw_surfaces(&shown).map_err(render)?;
                let target = reader.target();
                let shaded = renderer.shade(&shown, *visibility_share, &target, |encoder| reader.copy(encoder));
                reader.submitted((*frame).into(), shaded.map_err(render)?, true);
                if let Some(picture) = reader.take_oldest().map_err(render)?.flatten() {
                    let visibility_share = *visibility_share;
                    take(Replayed::Picture { picture, shown, visibility_share, renderer: &renderer })?;
                }
            }
            Record::Event { .. } => {}
        }
        take(Replayed::Record(&record))?;
    }
    Ok(())
}
