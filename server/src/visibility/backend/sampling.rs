//! Fewer shadow rays than pixels: which pixels have their own, and what the others make of their neighbours' answers.
//!
//! Twin of `wgsl/visibility/sampling.wgsl`, which has the rules. Here a tile's answers are words, so most of it is done for
//! 64 pixels at once.

use glam::Vec3;

/// Which pixels trace shadow rays of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sampling {
    /// All that want one.
    #[default]
    All,
    /// Every other one, as on a checkerboard.
    Checkerboard {
        /// Whether pixels whose neighbours disagree trace a ray after all.
        refine: bool,
    },
    /// One of four: half the resolution each way.
    Quarter {
        /// As for the checkerboard.
        refine: bool,
    },
}

impl Sampling {
    /// `SAMPLING` and `REFINE` of the kernels.
    pub(super) fn constants(self) -> (u32, bool) {
        match self {
            Self::All => (0, false),
            Self::Checkerboard { refine } => (1, refine),
            Self::Quarter { refine } => (2, refine),
        }
    }

    /// The pixels of a tile that have their own ray.
    pub(super) fn own(self) -> u64 {
        match self {
            Self::All => u64::MAX,
            Self::Checkerboard { .. } => 0xaa55_aa55_aa55_aa55,
            Self::Quarter { .. } => 0x0055_0055_0055_0055,
        }
    }
}

/// A neighbour's point is near within this many widths of a pixel.
const NEAR_PX: f32 = 8.0;

/// What neighbours said of pixels without a ray of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Filled {
    /// Pixels that are lit.
    pub(super) lit: u64,
    /// Pixels that must trace a ray after all.
    pub(super) undecided: u64,
}

/// What the traced pixels of a tile say of the others. `wanted` want the light, `lit` of those with a ray of their own
/// reach it; `point` gives where a pixel's shadow ray starts and how wide a pixel is there, in metres.
pub(super) fn fill(sampling: Sampling, wanted: u64, lit: u64, point: impl Fn(u32) -> (Vec3, f32)) -> Filled {
    let (own, (_, refine)) = (wanted & sampling.own(), sampling.constants());
    let mut filled = Filled::default();
    let mut left = wanted & !own;
    while left != 0 {
        let bit = left.trailing_zeros();
        left &= left - 1;
        let (start, pixel_m) = point(bit);
        let (mut for_lit, mut for_dark) = (0.0, 0.0);
        let mut around = neighbours(bit) & own;
        while around != 0 {
            let other = around.trailing_zeros();
            around &= around - 1;
            let apart = start.distance(point(other).0);
            if apart > NEAR_PX * pixel_m {
                continue;
            }
            let weight = 1.0 / (apart * apart + pixel_m * pixel_m * 0.0625);
            *(if lit >> other & 1 == 1 { &mut for_lit } else { &mut for_dark }) += weight;
        }
        let undecided = for_lit + for_dark == 0.0 || (refine && for_lit > 0.0 && for_dark > 0.0);
        filled.undecided |= u64::from(undecided) << bit;
        filled.lit |= u64::from(!undecided && for_lit > for_dark) << bit;
    }
    filled
}

/// The up to eight pixels around pixel `bit` of a tile, inside it.
fn neighbours(bit: u32) -> u64 {
    const LEFT: u64 = 0x0101_0101_0101_0101;
    let one = 1_u64 << bit;
    let row = one | (one & !LEFT) >> 1 | (one & !(LEFT << 7)) << 1;
    (row | row << 8 | row >> 8) & !one
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pixels of 1 m on a plane.
    fn flat(bit: u32) -> (Vec3, f32) {
        (Vec3::new((bit % 8) as f32, (bit / 8) as f32, 0.0), 1.0)
    }

    #[test]
    fn neighbours_stay_inside_the_tile() {
        assert_eq!(neighbours(0), 0x0302);
        assert_eq!(neighbours(7), 0xc040);
        assert_eq!(neighbours(9), 0x0007_0507);
        assert_eq!(neighbours(63), 0x40c0_0000_0000_0000);
    }

    #[test]
    fn where_neighbours_agree_so_does_the_pixel() {
        for sampling in [Sampling::Checkerboard { refine: true }, Sampling::Quarter { refine: true }] {
            let own = sampling.own();
            assert_eq!(fill(sampling, u64::MAX, own, flat), Filled { lit: !own, undecided: 0 });
            assert_eq!(fill(sampling, u64::MAX, 0, flat), Filled::default());
            // Nobody else wants the light: nobody can be asked.
            assert_eq!(fill(sampling, 2, 0, flat), Filled { lit: 0, undecided: 2 });
        }
    }

    #[test]
    fn a_shadow_edge_is_traced_or_put_to_the_vote() {
        // The left half is lit.
        let lit = 0x0f0f_0f0f_0f0f_0f0f;
        let own = Sampling::Checkerboard { refine: true }.own();
        let refined = fill(Sampling::Checkerboard { refine: true }, u64::MAX, lit & own, flat);
        assert_eq!(refined.undecided & !0x1818_1818_1818_1818, 0, "{refined:x?}");
        assert!(refined.undecided != 0);
        assert_eq!(refined.lit, lit & !own & !refined.undecided);
        let voted = fill(Sampling::Checkerboard { refine: false }, u64::MAX, lit & own, flat);
        assert_eq!(voted.undecided, 0);
        assert!((voted.lit ^ (lit & !own)).count_ones() <= 4, "{voted:x?}");
    }

    #[test]
    fn what_lies_on_another_surface_is_not_asked() {
        // The right half is 100 m behind, and dark; the lit pixels at its edge do not listen to it.
        let (lit, sampling) = (0x0f0f_0f0f_0f0f_0f0f, Sampling::Checkerboard { refine: true });
        let step = |bit: u32| {
            let (point, width) = flat(bit);
            (if bit % 8 > 3 { point - Vec3::Z * 100.0 } else { point }, width)
        };
        let filled = fill(sampling, u64::MAX, lit & sampling.own(), step);
        assert_eq!(filled, Filled { lit: lit & !sampling.own(), undecided: 0 });
    }
}
