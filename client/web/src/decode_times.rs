//! How long decoding takes, for `tests/web/decode-times.mjs`.

use gnomon_protocol::{
    codec::Decoder,
    mask::{Mask, MaskShape},
};
use wasm_bindgen::prelude::*;
use web_time::Instant;

/// Decodes a frame's body this many times. Returns the median in ms.
#[wasm_bindgen]
pub fn decode_ms(body: &[u8], rounds: u32) -> Result<f64, JsError> {
    let (mut decoder, mut mask) = (Decoder::new(), Mask::new(MaskShape::new(1, 1, 1)?));
    let mut times = Vec::new();
    for _ in 0..rounds.max(1) {
        let begun = Instant::now();
        decoder.decode(body, &mut mask)?;
        times.push(begun.elapsed());
    }
    times.sort_unstable();
    Ok(times[times.len() / 2].as_secs_f64() * 1e3)
}
