//! Which parts of two shadow maps may differ, because something moving is in one of them (`changed.wgsl`).

use super::{shadow_map::ShadowMap, texels::Texels};

/// Side of a block of texels that one bit stands for.
const BLOCK_TEXELS: u32 = 32;

/// A lookup reads texels beside the one that its block is found by: one right and below, and up to one more on every
/// side, since it is made a little above the surface.
const BESIDE_TEXELS: u32 = 2;

const HEAD_WORDS: usize = 4;

/// The words of `Touched` in `changed.wgsl`.
pub(super) fn words(now: &ShadowMap, then: &ShadowMap) -> Vec<u32> {
    let moved = now.moved(then);
    let some = now.touched() | then.touched() | moved;
    let blocks = blocks_of(now.texture.texture().width(), now.drawn().chain(then.drawn()));
    [&[some, now.lights(), moved, 0][..], &blocks].concat()
}

/// Length of [`words`] in bytes.
pub(super) fn bytes(map: &ShadowMap) -> u64 {
    let blocks = blocks_of(map.texture.texture().width(), std::iter::empty());
    ((HEAD_WORDS + blocks.len()) * size_of::<u32>()) as u64
}

/// A bit for each block of a map with this side, row by row. Bits of blocks that texels lie in or beside are 1.
fn blocks_of<'a>(side: u32, texels: impl Iterator<Item = &'a Texels>) -> Vec<u32> {
    let across = side / BLOCK_TEXELS;
    let mut words = vec![0_u32; (across * across).div_ceil(u32::BITS) as usize];
    let span = |from: u32, length: u32| {
        let first = from.saturating_sub(BESIDE_TEXELS) / BLOCK_TEXELS;
        let last = (from + length - 1 + BESIDE_TEXELS) / BLOCK_TEXELS;
        first.min(across - 1)..=last.min(across - 1)
    };
    for texels in texels {
        for y in span(texels.top, texels.height) {
            for x in span(texels.left, texels.width) {
                let bit = y * across + x;
                words[(bit / u32::BITS) as usize] |= 1 << (bit % u32::BITS);
            }
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_touched_by_texels_in_them_or_beside_them() {
        let touched = |left, top, width, height| {
            let words = blocks_of(128, [Texels { left, top, width, height }].iter());
            (0..16).filter(|bit| words[0] >> bit & 1 == 1).collect::<Vec<u32>>()
        };
        assert_eq!(touched(2, 2, 28, 28), [0]);
        assert_eq!(touched(1, 34, 29, 1), [4]);
        // A texel more, and the next block's lookups read it.
        assert_eq!(touched(2, 2, 29, 28), [0, 1]);
        assert_eq!(touched(33, 96, 1, 32), [8, 9, 12, 13]);
        assert_eq!(touched(0, 0, 128, 128).len(), 16);
    }
}
