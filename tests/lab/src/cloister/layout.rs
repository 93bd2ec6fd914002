//! Where the parts of the cloister stand, in metres. +Y is up, +X is east, +Z is south; the garth's centre is the
//! origin.
//!
//! Each of the four sides is built once, in a frame whose x runs along the side and whose z points out of the garth,
//! and is then turned into place. Lengths along a side are sums of powers of two, so that neighbouring bays meet
//! exactly.

use glam::DVec3;

/// Width of one bay of the arcade, from column to column.
pub(crate) const BAY: f64 = 2.125;
pub(crate) const BAYS: usize = 7;
/// Half the length of the arcade between its corner piers.
pub(crate) const HALF_RUN: f64 = 7.4375;
/// Distance of the arcade wall's middle plane from the centre.
pub(crate) const ARCADE: f64 = 7.75;
pub(crate) const ARCADE_HALF: f64 = 0.25;
/// Inner edge of the walk.
pub(crate) const WALK_IN: f64 = 8.0;
/// Outer edge of the walk: the inner face of the outer wall.
pub(crate) const WALK_OUT: f64 = 11.25;
/// Outer face of the outer wall.
pub(crate) const OUTSIDE: f64 = 11.75;
/// Level of the garth; the walk's floor is at 0.
pub(crate) const GARTH: f64 = -0.15;
/// Lowest level of anything built.
pub(crate) const GROUND: f64 = -0.4;
/// Top of the low wall between the columns.
pub(crate) const SILL: f64 = 0.5;
pub(crate) const CAPITAL: f64 = 2.25;
/// Height where arches and vaults begin to curve.
pub(crate) const SPRINGING: f64 = 2.4;
/// Half the clear width of an arch.
pub(crate) const ARCH_HALF: f64 = 0.8125;
/// Distance of an arc's centre beyond the middle, as a share of the half width; 0 gives a round arch.
pub(crate) const ARCH_POINT: f64 = 0.3;
/// Height of the vaults above their springing.
pub(crate) const VAULT_RISE: f64 = 1.5;
/// Top of the arcade wall, hidden below the tiles.
pub(crate) const ARCADE_TOP: f64 = 4.34;
/// Lower edge of the roof: distance from the centre and height of its upper face.
pub(crate) const EAVE: (f64, f64) = (7.0, 4.2);
/// Upper edge of the roof, at the outer wall.
pub(crate) const ROOF_TOP: f64 = 5.7;
pub(crate) const WALL_TOP: f64 = 6.0;
/// Size of the wall texture: one bay, so that courses continue across bays.
pub(crate) const ASHLAR: f64 = BAY;

/// x of the `index`-th column axis of a side, 0 ..= BAYS (the first and last stand at the corner piers).
pub(crate) fn column_x(index: usize) -> f64 {
    index as f64 * BAY - HALF_RUN
}

/// x of the middle of the `index`-th bay.
pub(crate) fn bay_x(index: usize) -> f64 {
    column_x(index) + BAY * 0.5
}

/// Height of a pointed arch of half width 1 and height 1 above its springing, at `t` from its middle.
pub(crate) fn arch_height(t: f64) -> f64 {
    let radius = 1.0 + ARCH_POINT;
    let height = |t: f64| (radius * radius - (t + ARCH_POINT).powi(2)).max(0.0).sqrt();
    height(t.abs().min(1.0)) / height(0.0)
}

/// A pointed arch over `2 · half` metres in the plane z = 0, from its right foot over its apex to its left foot.
pub(crate) fn arch_curve(half: f64, springing: f64, steps: usize) -> Vec<DVec3> {
    let radius = half * (1.0 + ARCH_POINT);
    let last = (ARCH_POINT / (1.0 + ARCH_POINT)).acos();
    let right = (0..=steps).map(|i| {
        let angle = last * i as f64 / steps as f64;
        let x = if i == steps { 0.0 } else { radius * angle.cos() - half * ARCH_POINT };
        DVec3::new(x, springing + radius * angle.sin(), 0.0)
    });
    let right: Vec<DVec3> = right.collect();
    let left = right.iter().rev().skip(1).map(|p| DVec3::new(-p.x, p.y, 0.0));
    right.iter().copied().chain(left).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bays_fill_the_run_between_the_piers() {
        assert_eq!(column_x(BAYS), HALF_RUN);
        assert_eq!(bay_x(BAYS / 2), 0.0);
    }

    #[test]
    fn arches_start_and_end_at_their_springing() {
        let curve = arch_curve(ARCH_HALF, SPRINGING, 12);
        assert_eq!(curve.len(), 25);
        assert!((curve[0] - DVec3::new(ARCH_HALF, SPRINGING, 0.0)).length() < 1e-12);
        assert_eq!(curve[12].x, 0.0);
        assert!((arch_height(0.0), arch_height(1.0)) == (1.0, 0.0));
        // The curve and the height function are the same arch.
        let rise = curve[12].y - SPRINGING;
        for p in curve {
            assert!((arch_height(p.x / ARCH_HALF) * rise - (p.y - SPRINGING)).abs() < 1e-6, "{p}");
        }
    }
}
