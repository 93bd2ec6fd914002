//! The bits of one slice, behind a head that is valid: mutations need not find one. Every codec, some shapes. What decodes comes back bit by bit from the same codec.

#![no_main]

use gnomon_protocol::{
    codec::{CodecId, Decoder, Encoder},
    frame::FrameHead,
    mask::{Mask, MaskShape},
};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let [codec, pick, rest @ ..] = bytes else { return };
    let codec = CodecId::ALL[usize::from(*codec) % CodecId::ALL.len()];
    let (width, height, lights) = [(1, 1, 1), (64, 8, 3), (130, 20, 2), (300, 33, 32)][usize::from(*pick) % 4];
    let Ok(shape) = MaskShape::new(width, height, lights) else { return };
    let head = FrameHead { codec, shape, traced_for: None, reference: None };
    let mut body = Vec::new();
    head.begin(1, &mut body);
    head.set_slice_length(&mut body, 0, u32::try_from(rest.len()).unwrap_or(u32::MAX));
    body.extend_from_slice(rest);
    let (mut decoder, mut mask, mut again) = (Decoder::new(), Mask::new(shape), Mask::new(shape));
    if decoder.decode(&body, &mut mask).is_ok() {
        assert!(Encoder::new(codec).encode(&mask, &mut body).is_ok());
        assert!(decoder.decode(&body, &mut again).is_ok() && again == mask, "{codec} changes the mask");
    }
});
