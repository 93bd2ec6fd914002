//! Slices of equally many rows of tiles, and their bytes.

use std::ops::Range;

use super::{lz4, planes, words};
use crate::{
    codec::error::DecodeError,
    mask::{Mask, MaskShape, TILE_PX},
};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::codec) enum Form {
    Words,
    WordsLz4,
    PlanesLz4,
}

pub(in crate::codec) struct Writer {
    raw: Vec<u8>,
    lz4: lz4::Compressor,
}

impl Writer {
    pub(in crate::codec) fn new() -> Self {
        Self { raw: Vec::new(), lz4: lz4::Compressor::new() }
    }

    pub(in crate::codec) fn append(&mut self, form: Form, mask: &Mask, rows: &Range<usize>, body: &mut Vec<u8>) {
        let (shape, words) = (mask.shape(), mask.words());
        match form {
            Form::Words => {
                for row in rows.clone() {
                    let bytes = at_least(&mut self.raw, raw_bytes(form, shape, &(row..row + 1)));
                    words::from_planes(shape, words, row, bytes);
                    body.extend_from_slice(bytes);
                }
            }
            Form::WordsLz4 => {
                let raw = at_least(&mut self.raw, raw_bytes(form, shape, rows));
                let mut rest = &mut *raw;
                for row in rows.clone() {
                    let bytes = raw_bytes(form, shape, &(row..row + 1));
                    let (head, tail) = rest.split_at_mut(bytes);
                    words::from_planes(shape, words, row, head);
                    rest = tail;
                }
                body.extend_from_slice(self.lz4.compress(raw));
            }
            Form::PlanesLz4 => {
                let raw = at_least(&mut self.raw, raw_bytes(form, shape, rows));
                planes::write(shape, words, rows, raw);
                body.extend_from_slice(self.lz4.compress(raw));
            }
        }
    }
}

/// Errors if `found` bytes cannot hold the rows of tiles `rows`. Check before allocating memory for them.
pub(in crate::codec) fn check_length(
    form: Form,
    shape: MaskShape,
    slice: usize,
    rows: &Range<usize>,
    found: usize,
) -> Result<(), DecodeError> {
    let raw = raw_bytes(form, shape, rows);
    let fits = match form {
        Form::Words => found == raw,
        Form::WordsLz4 | Form::PlanesLz4 => lz4::can_be(found, raw),
    };
    if fits { Ok(()) } else { Err(DecodeError::SliceLength { slice, found, raw }) }
}

/// Reads slice `slice`, which holds the rows of tiles `rows`. `memory` is reused from slice to slice.
pub(in crate::codec) fn read(
    form: Form,
    memory: &mut Vec<u8>,
    slice: usize,
    rows: &Range<usize>,
    bytes: &[u8],
    mask: &mut Mask,
) -> Result<(), DecodeError> {
    let shape = mask.shape();
    let raw_len = raw_bytes(form, shape, rows);
    let raw = match form {
        Form::Words => bytes,
        Form::WordsLz4 | Form::PlanesLz4 => {
            lz4::decompress(bytes, raw_len, memory).map_err(|failure| match failure {
                lz4::Failure::Block(source) => DecodeError::Lz4 { slice, source },
                lz4::Failure::Short(found) => DecodeError::Short { slice, found, raw: raw_len },
            })?
        }
    };
    match form {
        Form::Words | Form::WordsLz4 => {
            let mut rest = raw;
            for row in rows.clone() {
                let (head, tail) = rest.split_at(raw_bytes(form, shape, &(row..row + 1)));
                words::to_planes(shape, head, row, mask.words_mut()).map_err(|words::StrayLights(set)| {
                    DecodeError::StrayLights { slice, set, lights: shape.lights() }
                })?;
                rest = tail;
            }
            Ok(())
        }
        Form::PlanesLz4 => planes::read(shape, raw, rows, mask.words_mut())
            .map_err(|planes::StrayPixels { light, tile }| DecodeError::StrayPixels { light, tile }),
    }
}

/// Returns the bytes of the rows of tiles `rows` before compression. `rows` is not empty.
fn raw_bytes(form: Form, shape: MaskShape, rows: &Range<usize>) -> usize {
    match form {
        Form::Words | Form::WordsLz4 => {
            let pixel_rows = (rows.end * TILE_PX as usize).min(shape.height() as usize) - rows.start * TILE_PX as usize;
            pixel_rows * shape.width() as usize * words::WORD_BYTES
        }
        Form::PlanesLz4 => rows.len() * shape.tiles_x() as usize * shape.lights() as usize * planes::TILE_BYTES,
    }
}

/// Returns the first `len` bytes of a buffer, which grows if it is shorter.
fn at_least(buffer: &mut Vec<u8>, len: usize) -> &mut [u8] {
    if buffer.len() < len {
        buffer.resize(len, 0);
    }
    &mut buffer[..len]
}
