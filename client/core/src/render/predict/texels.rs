//! Rectangles of a shadow map, and which of its texels a thing may cover.

use glam::{Vec3, Vec4Swizzles as _};
use gnomon_shaders::shading::ShadowView;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Texels {
    pub(super) left: u32,
    pub(super) top: u32,
    pub(super) width: u32,
    pub(super) height: u32,
}

impl Texels {
    /// A view's square.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "whole, at most 4096")]
    pub(super) fn of(view: &ShadowView) -> Self {
        let [left, top, side] = [view.left, view.top, view.side].map(|texels| texels as u32);
        Self { left, top, width: side, height: side }
    }

    pub(super) fn count(self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }
}

/// Texels around what is computed here, which the adapter may round to: it snaps corners to 1/256 of a texel or finer.
const MARGIN: f32 = 1.0;

/// Returns the texels of a view that a thing between these corners may cover. `None` if it covers none.
pub(super) fn covered(view: &ShadowView, corners: &[Vec3; 8]) -> Option<Texels> {
    let corners = corners.map(|corner| view.clip_from_local * corner.extend(1.0));
    // Beyond one of the planes that clip. Depth is reversed; a far plane is not asked.
    let wide = 1.0 + 2.0 * MARGIN / view.side;
    let beyond = |side: fn(&glam::Vec4, f32) -> bool| corners.iter().all(|corner| side(corner, corner.w * wide));
    if beyond(|at, w| at.x > w)
        || beyond(|at, w| at.x < -w)
        || beyond(|at, w| at.y > w)
        || beyond(|at, w| at.y < -w)
        || corners.iter().all(|corner| corner.z > corner.w)
    {
        return None;
    }
    let square = Texels::of(view);
    // Around the light, or beside it.
    if corners.iter().any(|corner| corner.w <= 0.0) {
        return Some(square);
    }
    let places = corners.map(|corner| (corner.xy() / corner.w * glam::Vec2::new(0.5, -0.5) + 0.5) * view.side);
    let (low, high) =
        places.iter().fold((glam::Vec2::MAX, glam::Vec2::MIN), |(low, high), at| (low.min(*at), high.max(*at)));
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "whole, 0 to 4096")]
    let [left, top, right, bottom] =
        [(low.x - MARGIN).floor(), (low.y - MARGIN).floor(), (high.x + MARGIN).ceil(), (high.y + MARGIN).ceil()]
            .map(|edge| edge.clamp(0.0, view.side) as u32);
    let (width, height) = (right - left, bottom - top);
    (width > 0 && height > 0).then_some(Texels { left: square.left + left, top: square.top + top, width, height })
}

#[cfg(test)]
mod tests {
    use glam::{Mat4, Vec4};

    use super::*;

    /// A view along −z from the origin, 90° wide, whose square begins at (64, 128).
    fn view(side: f32) -> ShadowView {
        let clip_from_local = Mat4::from_cols(Vec4::X, Vec4::Y, Vec4::NEG_W, Vec4::Z * 0.1);
        ShadowView { clip_from_local, left: 64.0, top: 128.0, side, texel_m: 2.0 / side }
    }

    #[test]
    fn a_thing_covers_the_texels_that_it_is_seen_through() {
        let view = view(100.0);
        let sign = |number: usize, bit: usize| if number >> bit & 1 == 1 { 1.0 } else { -1.0 };
        let around = |centre: Vec3, half: f32| {
            std::array::from_fn(|n| centre + half * Vec3::new(sign(n, 0), sign(n, 1), sign(n, 2)))
        };
        // From −1 to 1 of ±10 m at 10 m: texels 45 to 55, seen from the near side a little more.
        let found = covered(&view, &around(Vec3::new(0.0, 0.0, -10.0), 1.0)).unwrap();
        assert_eq!(found, Texels { left: 64 + 43, top: 128 + 43, width: 14, height: 14 });
        // Right and up, cut off at the corner.
        let found = covered(&view, &around(Vec3::new(10.0, 10.0, -10.0), 1.0)).unwrap();
        assert_eq!((found.left + found.width, found.top), (164, 128));
        for (centre, seen) in [
            (Vec3::Z * 5.0, false),
            (Vec3::new(20.0, 0.0, -5.0), false),
            (Vec3::new(-20.0, 0.0, -0.5), false),
            (Vec3::new(0.0, -9.0, -0.5), false),
            (Vec3::new(0.0, -9.0, -8.5), true),
        ] {
            assert_eq!(covered(&view, &around(centre, 1.0)).is_some(), seen, "{centre}");
        }
        assert_eq!(covered(&view, &around(Vec3::ZERO, 1.0)), Some(Texels::of(&view)));
    }
}
