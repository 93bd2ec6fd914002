//! Where lights look from, and where their views lie in the square that all shadow maps share.

use glam::{DMat4, DVec3, DVec4, Mat4, Vec3};
use gnomon_scene::{Aabb, Light, LightKind};
use gnomon_shaders::shading::ShadowView;

/// Memory for all maps.
const BUDGET_BYTES: u64 = 64 << 20;

/// Longest side of the square: half of it in each direction fills the budget.
const MOST_SIDE: u32 = 4096;

/// Texels by which a cube face extends beyond its edges, so that the four texels around a point lie on one face.
const MARGIN_TEXELS: f64 = 2.0;

/// Number of views for a light of this kind.
pub(crate) fn views_of(kind: LightKind) -> u32 {
    match kind {
        LightKind::Point => 6,
        LightKind::Directional | LightKind::Spot { .. } => 1,
    }
}

/// Returns the square's side in texels, and every light's views, one light after the other. Objects nearer to a lamp
/// than the near plane cast no shadow in its map.
pub(super) fn layout(lights: &[Light], (bounds, near_m): (&Aabb, f64), limit: u32) -> (u32, Vec<ShadowView>) {
    let directional = lights.iter().filter(|light| light.kind == LightKind::Directional).count();
    let others: u32 =
        lights.iter().filter(|light| light.kind != LightKind::Directional).map(|light| views_of(light.kind)).sum();
    let cells = directional * 4 + others as usize;
    // Cells of the grid: directional lights take blocks of 2×2, which fill rows of two from the top.
    let grid = (2_usize..).find(|side| {
        let blocks = side / 2;
        side * side >= cells && (blocks * blocks) >= directional
    });
    let grid = grid.unwrap_or(2);
    let side = MOST_SIDE.min(limit).min(isqrt(BUDGET_BYTES / 4));
    #[expect(clippy::cast_possible_truncation, reason = "at most 32 lights make a grid of at most 16")]
    let cell = (side / grid as u32).max(8);
    let mut taken = vec![false; grid * grid];
    let mut place = |span: usize| {
        let fits =
            |x: usize, y: usize, taken: &[bool]| (0..span * span).all(|i| !taken[(y + i / span) * grid + x + i % span]);
        let spots = (0..=grid - span).step_by(span).flat_map(|y| (0..=grid - span).step_by(span).map(move |x| (x, y)));
        let (x, y) = spots.into_iter().find(|(x, y)| fits(*x, *y, &taken)).unwrap_or((0, 0));
        for i in 0..span * span {
            taken[(y + i / span) * grid + x + i % span] = true;
        }
        (x, y)
    };
    // Directional lights are placed first, since they need whole blocks.
    let blocks: Vec<(usize, usize)> = (0..directional).map(|_| place(2)).collect();
    let mut blocks = blocks.into_iter();
    let mut views = Vec::new();
    for light in lights {
        for face in 0..views_of(light.kind) {
            let (at, span) = match light.kind {
                LightKind::Directional => (blocks.next().unwrap_or((0, 0)), 2),
                LightKind::Point | LightKind::Spot { .. } => (place(1), 1),
            };
            views.push(view(light, face, (bounds, near_m), at, cell, span));
        }
    }
    (side, views)
}

fn isqrt(value: u64) -> u32 {
    u32::try_from(value.isqrt()).unwrap_or(u32::MAX)
}

#[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "texels and rounding to f32")]
fn view(
    light: &Light,
    face: u32,
    (bounds, near_m): (&Aabb, f64),
    (x, y): (usize, usize),
    cell: u32,
    span: u32,
) -> ShadowView {
    let side = cell * span;
    let (clip_from_local, texel_m) = match light.kind {
        LightKind::Directional => parallel(light.direction, bounds, f64::from(side)),
        LightKind::Point => {
            let half = f64::from(side) / (f64::from(side) - 2.0 * MARGIN_TEXELS);
            (perspective(light.position, face_rotation(face), (half, near_m)), 2.0 * half / f64::from(side))
        }
        LightKind::Spot { outer_cone_rad, .. } => {
            let half = f64::from(outer_cone_rad).clamp(0.01, 1.45).tan() * 1.02;
            let rotation = toward(light.direction.as_dvec3());
            (perspective(light.position, rotation, (half, near_m)), 2.0 * half / f64::from(side))
        }
    };
    ShadowView {
        clip_from_local,
        left: x as f32 * cell as f32,
        top: y as f32 * cell as f32,
        side: side as f32,
        texel_m: texel_m as f32,
    }
}

/// A rotation from local space to one whose −z lies along `forward`.
fn toward(forward: DVec3) -> DMat4 {
    let forward = forward.normalize_or(DVec3::NEG_Y);
    let right = forward.any_orthonormal_vector();
    DMat4::from_cols(right.extend(0.0), right.cross(forward).extend(0.0), (-forward).extend(0.0), DVec4::W).transpose()
}

/// The rotation of a cube face, in the order of `cube_face` in `shadow_map.wgsl`.
fn face_rotation(face: u32) -> DMat4 {
    let axis = [DVec3::X, DVec3::Y, DVec3::Z][face as usize / 2 % 3];
    toward(if face.is_multiple_of(2) { axis } else { -axis })
}

/// Reversed-Z with an infinite far plane, `half` wide at distance 1.
fn perspective(position: Vec3, rotation: DMat4, (half, near_m): (f64, f64)) -> Mat4 {
    let projection = DMat4::from_cols(
        DVec4::new(1.0 / half, 0.0, 0.0, 0.0),
        DVec4::new(0.0, 1.0 / half, 0.0, 0.0),
        DVec4::new(0.0, 0.0, 0.0, -1.0),
        DVec4::new(0.0, 0.0, near_m, 0.0),
    );
    (projection * rotation * DMat4::from_translation(-position.as_dvec3())).as_mat4()
}

/// Covers all of `bounds` along `direction`, nearest depth 1 and farthest 0. Also returns a texel's side in metres.
fn parallel(direction: Vec3, bounds: &Aabb, side: f64) -> (Mat4, f64) {
    let rotation = toward(direction.as_dvec3());
    let (low, high) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
    let corners = (0..8).map(|i| {
        let pick = |bit: u32, axis: usize| if i >> bit & 1 == 0 { low[axis] } else { high[axis] };
        rotation.transform_point3(DVec3::new(pick(0, 0), pick(1, 1), pick(2, 2)))
    });
    let (low, high) =
        corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), corner| (low.min(corner), high.max(corner)));
    // Square, so that texels are square, with room for the four texels around a point at its edge and a margin in
    // depth.
    let extent = (high - low).max_element().max(1e-9);
    let wide = (high.x - low.x).max(high.y - low.y).max(extent * 1e-3) * side / (side - 2.0 * MARGIN_TEXELS);
    let deep = (high.z - low.z).max(extent * 1e-3) * 1.02;
    let middle = (low + high) * 0.5;
    let projection = DMat4::from_cols(
        DVec4::new(2.0 / wide, 0.0, 0.0, 0.0),
        DVec4::new(0.0, 2.0 / wide, 0.0, 0.0),
        DVec4::new(0.0, 0.0, 1.0 / deep, 0.0),
        DVec4::new(0.0, 0.0, 0.5, 1.0),
    );
    ((projection * DMat4::from_translation(-middle) * rotation).as_mat4(), wide / side)
}

#[cfg(test)]
mod tests {
    use gnomon_scene::camera::NEAR_M;

    use super::*;

    fn light(kind: LightKind) -> Light {
        Light {
            name: String::new(),
            kind,
            position: Vec3::new(1.0, 2.0, 3.0),
            direction: Vec3::new(0.6, -0.8, 0.0),
            color: Vec3::ONE,
            intensity: 1.0,
            range_m: f32::INFINITY,
        }
    }

    const BOUNDS: Aabb = Aabb { min: Vec3::new(-4.0, 0.0, -2.0), max: Vec3::new(5.0, 3.0, 8.0) };

    #[test]
    fn map_squares_do_not_overlap() {
        let spot = LightKind::Spot { inner_cone_rad: 0.1, outer_cone_rad: 0.5 };
        for kinds in [
            vec![],
            vec![LightKind::Directional],
            vec![LightKind::Directional, LightKind::Point, LightKind::Point, LightKind::Point],
            vec![LightKind::Directional; 32],
            vec![LightKind::Point; 32],
            [vec![spot; 7], vec![LightKind::Directional; 3], vec![LightKind::Point; 5]].concat(),
        ] {
            let lights: Vec<Light> = kinds.iter().map(|kind| light(*kind)).collect();
            let (side, views) = layout(&lights, (&BOUNDS, NEAR_M), 16384);
            assert_eq!(views.len(), kinds.iter().map(|kind| views_of(*kind) as usize).sum::<usize>());
            assert!(u64::from(side) * u64::from(side) * 4 <= BUDGET_BYTES);
            for (i, one) in views.iter().enumerate() {
                assert!(one.left + one.side <= side as f32 && one.top + one.side <= side as f32, "{kinds:?}");
                for other in &views[..i] {
                    let apart = one.left + one.side <= other.left
                        || other.left + other.side <= one.left
                        || one.top + one.side <= other.top
                        || other.top + other.side <= one.top;
                    assert!(apart, "{kinds:?}: {one:?} {other:?}");
                }
            }
        }
    }

    #[test]
    fn points_around_a_lamp_lie_on_the_face_that_the_shader_picks() {
        let lamp = light(LightKind::Point);
        let (_, views) = layout(std::slice::from_ref(&lamp), (&BOUNDS, NEAR_M), 4096);
        let steps = [-1.0_f32, -0.7, -0.2, 0.0, 0.3, 0.9, 1.0];
        for i in 0..7 * 7 * 7 {
            let from_light = Vec3::new(steps[i % 7], steps[i / 7 % 7], steps[i / 49]);
            let size = from_light.abs();
            if size.max_element() == 0.0 {
                continue;
            }
            // Mirrors `cube_face`.
            let axis = if size.x >= size.y && size.x >= size.z {
                0
            } else if size.y >= size.z {
                1
            } else {
                2
            };
            let face = axis * 2 + usize::from(from_light[axis] < 0.0);
            let clip = views[face].clip_from_local * (lamp.position + from_light).extend(1.0);
            assert!((clip.w - size.max_element()).abs() < 1e-5);
            assert!((clip.x / clip.w).abs() < 1.0 && (clip.y / clip.w).abs() < 1.0, "{from_light} on face {face}");
        }
    }

    #[test]
    fn a_directional_view_covers_the_scene_with_reversed_depth() {
        let (_, views) = layout(&[light(LightKind::Directional)], (&BOUNDS, NEAR_M), 4096);
        let clip = |point: Vec3| views[0].clip_from_local.project_point3(point);
        for i in 0..8 {
            let pick = |bit: u32, axis: usize| if i >> bit & 1 == 0 { BOUNDS.min[axis] } else { BOUNDS.max[axis] };
            let ndc = clip(Vec3::new(pick(0, 0), pick(1, 1), pick(2, 2)));
            assert!(ndc.x.abs() < 1.0 && ndc.y.abs() < 1.0 && (0.0..=1.0).contains(&ndc.z), "{ndc}");
        }
        let (near, far) = (clip(Vec3::new(0.0, 2.0, 0.0)), clip(Vec3::new(0.6, 1.2, 0.0)));
        assert!(near.z > far.z && (near - far).truncate().length() < 1e-5, "{near} {far}");
        let moved = clip(Vec3::new(0.0, 2.0, 1.0));
        let texels = (moved - near).truncate().length() * 0.5 * views[0].side;
        assert!((texels * views[0].texel_m - 1.0).abs() < 1e-3);
    }
}
