//! Names a mask's content, so that two clients' masks can be compared.

use gnomon_protocol::mask::Mask;

/// Returns the BLAKE3 digest of a mask's size and words, little-endian, in hexadecimal.
#[must_use]
pub fn digest(mask: &Mask) -> String {
    let (shape, mut hasher) = (mask.shape(), blake3::Hasher::new());
    for side in [shape.width(), shape.height(), shape.lights()] {
        hasher.update(&side.to_le_bytes());
    }
    for word in mask.words() {
        hasher.update(&word.to_le_bytes());
    }
    hasher.finalize().to_hex().to_string()
}
