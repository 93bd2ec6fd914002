//! The share of a pixel that a light reaches, for every pattern of its visibility bit and the eight around it.
//!
//! The shadow's edge is taken to be straight there. A line is given by its direction and its distance from the pixel's
//! centre; all lines that come close are equally likely, which is what random lines in a plane are. The mean over the
//! lines that make a pattern has the smallest expected squared error of all estimates: over all lines it is 6.5 dB
//! below a bit's (`edge_shares_are_6_db_better_than_bits`). A pattern that no line makes has leaves, corners or
//! points: a weighted mean of its bits takes a line's place.

use std::f64::consts::TAU;

/// Patterns of nine bits. Bit 3·row + column is the pixel's there, 1 if it is lit; bit 4 is the pixel itself.
pub const PATTERNS: usize = 512;

const ANGLES: u32 = 1440;
const DISTANCES: u32 = 800;

/// Beyond this distance, in pixels, a line passes all nine centres on one side.
const REACH: f64 = std::f64::consts::SQRT_2;

/// Weights of the pixel, its four neighbours and the four at its corners for patterns that no line makes: a Gaussian
/// of half a pixel.
const WEIGHTS: [f64; 3] = [0.619_3, 0.083_8, 0.011_3];

/// Returns the share of each pattern.
#[must_use]
pub fn edge_shares() -> [f32; PATTERNS] {
    let mut sums = [(0.0, 0_u32); PATTERNS];
    for_each_line(|pattern, share| {
        let (sum, count) = &mut sums[pattern];
        *sum += share;
        *count += 1;
    });
    std::array::from_fn(|pattern| {
        let (sum, count) = sums[pattern];
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the point")]
        let rounded = |share: f64| share as f32;
        rounded(if count > 0 { sum / f64::from(count) } else { weighted(pattern) })
    })
}

/// Calls `visit` with the pattern and the true share of evenly spread lines.
fn for_each_line(mut visit: impl FnMut(usize, f64)) {
    for angle in 0..ANGLES {
        let (sin, cos) = (TAU * (f64::from(angle) + 0.5) / f64::from(ANGLES)).sin_cos();
        for step in 0..DISTANCES {
            let distance = REACH * (2.0 * (f64::from(step) + 0.5) / f64::from(DISTANCES) - 1.0);
            let lit = |place: usize| {
                let (x, y) = ((place % 3) as f64 - 1.0, (place / 3) as f64 - 1.0);
                usize::from(cos * x + sin * y > distance) << place
            };
            visit((0..9).map(lit).sum(), share_beyond(cos, sin, distance));
        }
    }
}

/// Returns the share of a unit square around the origin that lies beyond the line (cos, sin) · p = distance.
fn share_beyond(cos: f64, sin: f64, distance: f64) -> f64 {
    let (long, short) = (cos.abs().max(sin.abs()), cos.abs().min(sin.abs()));
    let away = distance.abs();
    let to_corner = (long + short) / 2.0 - away;
    let less = if to_corner <= 0.0 {
        0.0
    } else if away <= (long - short) / 2.0 {
        // A trapezoid along one side.
        0.5 - away / long
    } else {
        // A triangle at one corner.
        to_corner * to_corner / (2.0 * long * short)
    };
    if distance >= 0.0 { less } else { 1.0 - less }
}

fn weighted(pattern: usize) -> f64 {
    (0..9_usize)
        .filter(|place| pattern >> place & 1 == 1)
        .map(|place| {
            let (x, y) = (place % 3, place / 3);
            WEIGHTS[x.abs_diff(1) + y.abs_diff(1)]
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_of_a_square_are_areas() {
        assert!((share_beyond(1.0, 0.0, 0.25) - 0.25).abs() < 1e-12);
        assert!((share_beyond(0.0, -1.0, -0.25) - 0.75).abs() < 1e-12);
        let diagonal = std::f64::consts::FRAC_1_SQRT_2;
        assert!((share_beyond(diagonal, diagonal, 0.0) - 0.5).abs() < 1e-12);
        // A corner's triangle with legs of a half: an eighth.
        assert!((share_beyond(diagonal, diagonal, diagonal * 0.5) - 0.125).abs() < 1e-12);
        assert_eq!(share_beyond(diagonal, diagonal, 0.8), 0.0);
        // Counted on a fine grid for any direction.
        for (angle, distance) in [(0.3_f64, 0.1), (2.7, -0.4), (4.0, 0.55)] {
            let (sin, cos) = angle.sin_cos();
            let grid = 400;
            let centre = |i: i32| (f64::from(i) + 0.5) / f64::from(grid) - 0.5;
            let beyond =
                (0..grid * grid).filter(|i| cos * centre(i % grid) + sin * centre(i / grid) > distance).count();
            // The line crosses at most 2 · 400 cells.
            assert!((share_beyond(cos, sin, distance) - beyond as f64 / f64::from(grid * grid)).abs() < 2.0 / 400.0);
        }
    }

    #[test]
    fn light_and_shadow_are_treated_alike() {
        let shares = edge_shares();
        assert_eq!((shares[0], shares[511]), (0.0, 1.0));
        for (pattern, share) in shares.iter().enumerate() {
            // A pattern and its opposite add up to a whole pixel, up to rounding and the weights' digits.
            assert!((share + shares[511 - pattern] - 1.0).abs() < 1e-3, "{pattern:09b}");
            assert!((0.0..=1.0).contains(share));
        }
    }

    #[test]
    fn edge_shares_are_6_db_better_than_bits() {
        let shares = edge_shares();
        let (mut of_bits, mut of_shares) = (0.0, 0.0);
        for_each_line(|pattern, share| {
            of_bits += (f64::from(u8::from(pattern >> 4 & 1 == 1)) - share).powi(2);
            of_shares += (f64::from(shares[pattern]) - share).powi(2);
        });
        let gain_db = 10.0 * (of_bits / of_shares).log10();
        assert!(gain_db > 6.0, "{gain_db} dB");
    }
}
