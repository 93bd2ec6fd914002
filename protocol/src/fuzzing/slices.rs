//! Slices after a valid head.

use crate::{
    codec::{CodecId, Decoder, EncodedFrame, Encoder},
    frame::FrameHead,
    mask::{Mask, MaskShape},
};

/// The bytes of one slice give a mask or an error, and the mask round-trips bit by bit in the same codec. The first two
/// bytes pick codec and shape, so that mutations need not find a head.
pub fn slices(bytes: &[u8]) {
    let [codec, pick, slice @ ..] = bytes else { return };
    let codec = CodecId::ALL[usize::from(*codec) % CodecId::ALL.len()];
    let (width, height, lights) = [(1, 1, 1), (64, 8, 3), (130, 20, 2), (300, 33, 32)][usize::from(*pick) % 4];
    let Ok(shape) = MaskShape::new(width, height, lights) else { return };
    let head = FrameHead { codec, shape, traced_for: None, reference: None };
    let mut body = Vec::new();
    head.begin(1, &mut body);
    head.set_slice_length(&mut body, 0, u32::try_from(slice.len()).unwrap_or(u32::MAX));
    body.extend_from_slice(slice);
    let (mut decoder, mut mask, mut again) = (Decoder::new(), Mask::new(shape), Mask::new(shape));
    if decoder.decode(&body, &mut mask).is_ok() {
        let mut encoded = EncodedFrame::default();
        assert_eq!(Encoder::new(codec).encode(&mask, &mut encoded), Ok(()));
        assert!(decoder.decode(&encoded, &mut again).is_ok_and(|found| found == codec));
        assert!(again == mask, "{codec} changes the mask");
    }
}
