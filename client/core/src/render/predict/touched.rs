//! Which parts of two shadow maps may differ, because something moving is in one of them (`changed.wgsl`).

use super::{shadow_map::ShadowMap, texels::Texels};

/// Side of a block of texels that one bit stands for.
const BLOCK_TEXELS: u32 = 32;

/// A lookup reads texels beside the one that its block is found by: one right and below, and up to one more on every
/// side, since it is made a little above the surface.
const BESIDE_TEXELS: u32 = 2;

/// Rows of [`words`] behind those of blocks.
const FOOT_ROWS: u32 = 3;

/// Returns the width and height of the picture that [`words`] are.
pub(super) fn size(map: &ShadowMap) -> (u32, u32) {
    let across = map.texture.texture().width() / BLOCK_TEXELS;
    (across.div_ceil(u32::BITS), across + FOOT_ROWS)
}

/// Returns a picture of words: for each row of blocks, a bit for each block; then rows that begin with bits of lights:
/// those whose maps may differ, all, and those that have moved.
pub(super) fn words(now: &ShadowMap, then: &ShadowMap) -> Vec<u32> {
    let moved = now.moved(then);
    let mut words = blocks_of(now.texture.texture().width(), now.drawn().chain(then.drawn()));
    let (width, _) = size(now);
    for lights in [now.touched() | then.touched() | moved, now.lights(), moved] {
        words.push(lights);
        words.extend((1..width).map(|_| 0));
    }
    words
}

/// Bits of the blocks of a map with this side, row by row. Bits of blocks that texels lie in or beside are 1.
fn blocks_of<'a>(side: u32, texels: impl Iterator<Item = &'a Texels>) -> Vec<u32> {
    let across = side / BLOCK_TEXELS;
    let width = across.div_ceil(u32::BITS);
    let mut words = vec![0_u32; (width * across) as usize];
    let span = |from: u32, length: u32| {
        let first = from.saturating_sub(BESIDE_TEXELS) / BLOCK_TEXELS;
        let last = (from + length - 1 + BESIDE_TEXELS) / BLOCK_TEXELS;
        first.min(across - 1)..=last.min(across - 1)
    };
    for texels in texels {
        for y in span(texels.top, texels.height) {
            for x in span(texels.left, texels.width) {
                words[(y * width + x / u32::BITS) as usize] |= 1 << (x % u32::BITS);
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
            (0..16).filter(|block| words[*block / 4] >> (block % 4) & 1 == 1).collect::<Vec<usize>>()
        };
        assert_eq!(touched(2, 2, 28, 28), [0]);
        assert_eq!(touched(1, 34, 29, 1), [4]);
        // A texel more, and the next block's lookups read it.
        assert_eq!(touched(2, 2, 29, 28), [0, 1]);
        assert_eq!(touched(33, 96, 1, 32), [8, 9, 12, 13]);
        assert_eq!(touched(0, 0, 128, 128).len(), 16);
    }
}
