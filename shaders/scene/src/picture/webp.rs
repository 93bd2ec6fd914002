//! The head of a WebP picture (RFC 9649). Pixels are decoded by `image-webp`, pure Rust without `unsafe`.

/// Returns the size of a still picture.
/// Errors with a sentence if it moves, or if its parts disagree about their size: the decoder takes memory for what the
/// inner part says, whatever the outer one.
pub(super) fn size(encoded: &[u8]) -> Result<(u32, u32), String> {
    let mut chunks = encoded.get(12..).unwrap_or_default();
    let mut canvas = None;
    let mut picture = None;
    while let Some(([a, b, c, d, e, f, g, h], rest)) = chunks.split_first_chunk() {
        let bytes = u32::from_le_bytes([*e, *f, *g, *h]) as usize;
        // A cut chunk is the decoder's to refuse.
        let body = rest.get(..bytes).unwrap_or(rest);
        match &[*a, *b, *c, *d] {
            b"VP8X" => canvas = extended(body)?.or(canvas),
            b"VP8 " => picture = picture.or(lossy(body)),
            b"VP8L" => picture = picture.or(lossless(body)),
            b"ANIM" | b"ANMF" => return Err("it is an animated WebP picture, which is not supported".to_owned()),
            _ => {}
        }
        if picture.is_some() {
            break;
        }
        chunks = bytes.checked_next_multiple_of(2).and_then(|bytes| rest.get(bytes..)).unwrap_or_default();
    }
    match (canvas, picture) {
        (_, None) => Err("it is a WebP picture without pixels".to_owned()),
        (Some(canvas), Some(picture)) if canvas != picture => {
            Err(format!("it says {canvas:?} pixels, and contains a picture of {picture:?}"))
        }
        (_, Some(size)) => Ok(size),
    }
}

fn extended(body: &[u8]) -> Result<Option<(u32, u32)>, String> {
    let [flags, _, _, _, a, b, c, d, e, f, ..] = *body else { return Ok(None) };
    if flags & 2 != 0 {
        return Err("it is an animated WebP picture, which is not supported".to_owned());
    }
    Ok(Some((u32::from_le_bytes([a, b, c, 0]) + 1, u32::from_le_bytes([d, e, f, 0]) + 1)))
}

fn lossy(body: &[u8]) -> Option<(u32, u32)> {
    let [_, _, _, 0x9d, 0x01, 0x2a, a, b, c, d, ..] = *body else { return None };
    let side = |low, high| u32::from(u16::from_le_bytes([low, high]) & 0x3fff);
    Some((side(a, b), side(c, d)))
}

fn lossless(body: &[u8]) -> Option<(u32, u32)> {
    let [0x2f, a, b, c, d, ..] = *body else { return None };
    let bits = u32::from_le_bytes([a, b, c, d]);
    Some(((bits & 0x3fff) + 1, (bits >> 14 & 0x3fff) + 1))
}
