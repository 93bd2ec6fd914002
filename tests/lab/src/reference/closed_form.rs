//! Checks the referee against shadows whose outline or area is known in closed form.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use gnomon_scene::{AlphaMode, Scene, Wrap, camera::Camera};

use super::{Reference, Truth, Verdict};
use crate::scenes::builder::SceneBuilder;

const DOWN: Vec3 = Vec3::NEG_Y;

/// A double-sided floor at y = 0 around `centre`.
fn floor(centre: Vec3, half_side: f32) -> SceneBuilder {
    let corner = centre - Vec3::new(half_side, 0.0, half_side);
    SceneBuilder::new().quad(corner, Vec3::Z * 2.0 * half_side, Vec3::X * 2.0 * half_side)
}

/// A camera above `target` that sees a square of `2·half_side` on the floor.
fn above(target: DVec3, height: f64, half_side: f64, side_px: u32) -> Camera {
    let yfov_rad = 2.0 * (half_side / height).atan();
    Camera::looking_at(target + DVec3::Y * height, target, yfov_rad, side_px, side_px)
}

/// Returns the floor point in world space at a pixel of a camera above it.
fn floor_point(camera: &Camera, x: u32, y: u32) -> DVec3 {
    let (from, direction) = camera.ray(x, y);
    from - direction * (from.y / direction.y)
}

fn trace(scene: &Scene, camera: &Camera) -> Truth {
    Reference::new(scene).trace(camera)
}

/// Asserts that light 0's verdicts on a visible floor follow `lit`, and that almost none is undecided.
fn assert_floor(scene: &Scene, camera: &Camera, lit: impl Fn(DVec3) -> bool) {
    let truth = trace(scene, camera);
    let (mut shadow, mut doubts) = (0, 0);
    for y in 0..camera.height {
        for x in 0..camera.width {
            let verdict = truth.at(x, y);
            assert!(verdict.surface && verdict.relevant == 1, "({x}, {y}): {verdict:?}");
            shadow += u32::from(verdict.lit == 0);
            doubts += verdict.undecided;
            let expected = lit(floor_point(camera, x, y));
            assert!(
                (verdict.lit == 1) == expected || verdict.undecided == 1,
                "({x}, {y}): {verdict:?}, not {expected}"
            );
        }
    }
    assert!(shadow > 0 && shadow < camera.width * camera.height, "{shadow} pixels of shadow prove nothing");
    assert!(doubts * 1000 < camera.width * camera.height, "{doubts} bits in doubt");
}

/// Area of light 0's shadow on the floor below the camera.
fn shadow_area(scene: &Scene, camera: &Camera) -> f64 {
    let dark = trace(scene, camera).pixels.iter().filter(|v| v.relevant == 1 && v.lit == 0).count();
    let side = floor_point(camera, 1, 0).distance(floor_point(camera, 0, 0));
    f64::from(u32::try_from(dark).unwrap()) * side * side
}

#[test]
fn a_sphere_in_slanted_sunlight_casts_an_ellipse() {
    // Light at 45°: semi-axes r and r·√2 around a point as far aside as the sphere is high.
    let scene =
        floor(Vec3::ZERO, 50.0).sphere(Vec3::new(-5.0, 5.0, 0.0), 1.0, 128).sun(Vec3::new(1.0, -1.0, 0.0)).build();
    let area = shadow_area(&scene, &above(DVec3::ZERO, 20.0, 2.0, 400));
    assert!((area / (PI * 2.0_f64.sqrt()) - 1.0).abs() < 0.002, "{area}");
}

#[test]
fn a_sphere_under_a_point_light_casts_a_conic() {
    // The light's cone around the sphere has half angle α and leans by β; its cut with the floor is an ellipse with
    // eccentricity sin β / cos α, and its long axis runs from H·tan(β−α) to H·tan(β+α).
    let (light, centre, radius) = (Vec3::new(0.0, 9.0, 0.0), Vec3::new(4.0, 5.0, 0.0), 1.0);
    let scene = floor(Vec3::ZERO, 80.0).sphere(centre, radius, 128).point_light(light, f32::INFINITY).build();
    let to_centre = (centre - light).as_dvec3();
    let alpha = (f64::from(radius) / to_centre.length()).asin();
    let beta = (to_centre.x / -to_centre.y).atan();
    let (near, far) = (9.0 * (beta - alpha).tan(), 9.0 * (beta + alpha).tan());
    let semi_major = (far - near) / 2.0;
    let semi_minor = semi_major * (1.0 - (beta.sin() / alpha.cos()).powi(2)).sqrt();
    let camera = above(DVec3::X * f64::midpoint(near, far), 16.0, semi_major * 1.1, 500);
    let area = shadow_area(&scene, &camera);
    assert!((area / (PI * semi_major * semi_minor) - 1.0).abs() < 0.002, "{area}");
}

#[test]
fn a_box_casts_its_shadow_to_the_pixel() {
    let (min, max) = (Vec3::new(-6.0, 1.0, -1.0), Vec3::new(-4.0, 3.0, 0.5));
    let travel = Vec3::new(2.0, -1.0, 0.3);
    let scene = floor(Vec3::ZERO, 40.0).cuboid(min, max).sun(travel).build();
    let (min, max) = (min.as_dvec3(), max.as_dvec3());
    let to_sun = -scene.lights[0].direction.as_dvec3();
    assert_floor(&scene, &above(DVec3::new(-0.5, 0.0, 0.5), 30.0, 3.5, 300), |p| {
        let (a, b) = ((min - p) / to_sun, (max - p) / to_sun);
        a.min(b).max_element() > a.max(b).min_element()
    });
}

#[test]
fn a_grid_of_slits_lets_stripes_of_light_through() {
    // Planks 0.3 wide every 0.5 at height 2 under a light at height 8: stripes scaled by 8/6.
    let mut builder = floor(Vec3::ZERO, 30.0);
    for k in -20_i16..20 {
        let left = f32::from(k) * 0.5;
        builder = builder.quad(Vec3::new(left, 2.0, -9.0), Vec3::Z * 18.0, Vec3::X * 0.3);
    }
    let scene = builder.point_light(Vec3::new(0.0, 8.0, 0.0), f32::INFINITY).build();
    // From below the planks, which then hide nothing.
    let camera = above(DVec3::new(0.11, 0.0, 0.07), 1.9, 1.5, 300);
    assert_floor(&scene, &camera, |p| {
        let x = p.x * 0.75;
        // The planks' right edges were rounded to f32, by less than makes a bit undecided.
        x - (x / 0.5).floor() * 0.5 > f64::from(0.3_f32)
    });
    let lit = trace(&scene, &camera).pixels.iter().filter(|v| v.lit == 1).count();
    assert!((lit as f64 / 90_000.0 - 0.4).abs() < 0.05, "{lit} of 90000 lit, where the gaps are two fifths");
}

#[test]
fn masked_leaves_cast_the_shadow_of_their_alpha() {
    // Two texels, 0 and 255, across a sheet of width 4: alpha crosses ¼ at u = 0.375. Then eight such sheets in one.
    let masked = AlphaMode::Mask { cutoff: 0.25 };
    let sheet = |wrap, repeat: f32| {
        let scene = floor(Vec3::ZERO, 30.0).material(masked, true).alpha_picture(2, &[0, 255], wrap).quad(
            Vec3::new(-2.0, 1.0, 2.0),
            Vec3::X * 4.0,
            Vec3::NEG_Z * 4.0,
        );
        let mut scene = scene.sun(Vec3::new(0.4, -1.0, 0.1)).build();
        scene.uvs.iter_mut().for_each(|uv| uv.x *= repeat);
        scene
    };
    let under = |p: DVec3| {
        let (u, z) = ((p.x - 0.4 + 2.0) / 4.0, p.z - 0.1);
        (u > 0.0 && u < 1.0 && z.abs() < 2.0).then_some(u)
    };
    let camera = above(DVec3::new(0.4, 0.0, 0.1), 0.9, 2.3, 300);
    assert_floor(&sheet(Wrap::ClampToEdge, 1.0), &camera, |p| under(p).is_none_or(|u| u < 0.375));
    // Repeated, alpha falls again after u = 0.75 and reaches ¼ at u = 1.125, which is 0.125 of the next one.
    assert_floor(&sheet(Wrap::Repeat, 8.0), &camera, |p| {
        under(p).is_none_or(|u| (0.125..0.375).contains(&(u * 8.0).fract()))
    });
    // Mirrored, the second half of each pair is reversed.
    assert_floor(&sheet(Wrap::MirroredRepeat, 8.0), &camera, |p| {
        under(p).is_none_or(|u| !(0.375..1.625).contains(&((u * 8.0).rem_euclid(2.0))))
    });
    // The camera sees through holes too; a hole has no visibility of its own.
    let from_above = trace(&sheet(Wrap::ClampToEdge, 1.0), &above(DVec3::ZERO, 100.0, 2.5, 100));
    assert_eq!(from_above.at(20, 50), Verdict { surface: true, relevant: 1, lit: 1, undecided: 0 });
    assert_eq!(from_above.at(75, 50), Verdict { surface: true, relevant: 1, lit: 1, undecided: 0 });
    assert_eq!(from_above.at(55, 8), Verdict { surface: true, relevant: 1, lit: 1, undecided: 0 });
}

#[test]
fn range_and_cone_bound_what_is_relevant() {
    let lamp = Vec3::new(0.0, 3.0, 0.0);
    let ranged = floor(Vec3::ZERO, 30.0).point_light(lamp, 5.0).build();
    let spot = floor(Vec3::ZERO, 30.0).spot_light(lamp, DOWN, 0.6).build();
    let camera = above(DVec3::ZERO, 10.0, 6.0, 300);
    // 3-4-5: the range ends 4 m aside.
    for (scene, radius) in [(ranged, 4.0), (spot, 3.0 * f64::from(0.6_f32).tan())] {
        let truth = trace(&scene, &camera);
        let relevant: u32 = truth.pixels.iter().map(|v| v.relevant).sum();
        for y in 0..300 {
            for x in 0..300 {
                let verdict = truth.at(x, y);
                let inside = floor_point(&camera, x, y).length() <= radius;
                assert!((verdict.relevant == 1) == inside || verdict.undecided == 1, "({x}, {y}): {verdict:?}");
                assert_eq!(verdict.lit, verdict.relevant);
            }
        }
        assert!(relevant > 5_000);
    }
}

#[test]
fn single_sided_backs_are_passed_through_but_stop_light() {
    // A ceiling that faces down, seen from above: the camera looks through it, the sun does not.
    let scene = floor(Vec3::ZERO, 30.0)
        .material(AlphaMode::Opaque, false)
        .quad(Vec3::new(-2.0, 3.0, -2.0), Vec3::X * 4.0, Vec3::Z * 4.0)
        .sun(DOWN)
        .build();
    let lit = |p: DVec3| p.x.abs() > 2.0 || p.z.abs() > 2.0;
    assert_floor(&scene, &above(DVec3::ZERO, 40.0, 5.0, 200), lit);
    // One that faces up, seen from below: light meets its front, shadow rays its back.
    let scene = floor(Vec3::ZERO, 30.0)
        .material(AlphaMode::Opaque, false)
        .quad(Vec3::new(-2.0, 3.0, -2.0), Vec3::Z * 4.0, Vec3::X * 4.0)
        .sun(DOWN)
        .build();
    assert_floor(&scene, &above(DVec3::ZERO, 2.9, 2.7, 200), lit);
}

#[test]
fn relevance_follows_the_shading_normal_and_facing_the_plane() {
    // A floor whose normals lean by 30° to +x, under suns that rise by 10° on either side, above and below the horizon.
    let sun = |angle_deg: f32| -Vec3::new(angle_deg.to_radians().cos(), angle_deg.to_radians().sin(), 0.0);
    let mut scene = floor(Vec3::ZERO, 5.0).sun(sun(10.0)).sun(sun(-10.0)).sun(sun(170.0)).sun(sun(-170.0)).build();
    scene.normals.fill(Vec3::new(0.5, 0.75_f32.sqrt(), 0.0));
    // From above: points that face the lean are relevant, and of those, only light above the horizon reaches them.
    let seen = trace(&scene, &above(DVec3::X * 0.3, 2.0, 1.0, 8));
    assert!(seen.pixels.iter().all(|v| (v.relevant, v.lit) == (0b0011, 0b0001)), "{:?}", seen.pixels[0]);
    // From below both normals are flipped.
    let eye = DVec3::new(0.3, -2.0, 0.2);
    let seen = trace(&scene, &Camera::looking_at(eye, eye + DVec3::Y, 1.0, 8, 8));
    assert!(seen.pixels.iter().all(|v| (v.relevant, v.lit) == (0b1100, 0b1000)), "{:?}", seen.pixels[0]);
}

#[test]
fn a_closed_room_is_lit_everywhere_from_inside_and_nowhere_from_outside() {
    let room = |builder: SceneBuilder| {
        builder.cuboid(Vec3::new(-3.0, 0.0, -2.0), Vec3::new(3.0, 3.0, 2.0)).origin(DVec3::new(1e6, 0.0, -2e6)).build()
    };
    let eye = DVec3::new(1e6 + 1.0, 1.5, -2e6 + 1.1);
    let camera = Camera::looking_at(eye, eye + DVec3::new(-1.0, -0.2, -0.7), 1.4, 200, 150);
    let inside = trace(&room(SceneBuilder::new().point_light(Vec3::new(0.3, 2.0, 0.4), f32::INFINITY)), &camera);
    assert!(inside.pixels.iter().all(|v| *v == Verdict { surface: true, relevant: 1, lit: 1, undecided: v.undecided }));
    assert!(inside.pixels.iter().filter(|v| v.undecided != 0).count() < 10);
    // From inside, an outside lamp is blocked by the walls, though some faces point towards it.
    let outside = trace(&room(SceneBuilder::new().point_light(Vec3::new(9.0, 9.0, 9.0), f32::INFINITY)), &camera);
    assert!(outside.pixels.iter().all(|v| v.surface && v.lit == 0));
    assert!(outside.pixels.iter().filter(|v| v.relevant == 1).count() > 10_000);
}

#[test]
fn bits_are_undecided_only_where_rounding_decides() {
    // One light's shadow edge runs exactly through a row of pixel centres; the other's does not.
    let scene = floor(Vec3::ZERO, 8.0)
        .quad(Vec3::new(-8.0, 1.0, -8.0), Vec3::Z * 8.5, Vec3::X * 16.0)
        .sun(DOWN)
        .sun(Vec3::new(0.0, -1.0, 0.05))
        .build();
    let camera = above(DVec3::ZERO, 0.5, 1.0, 8);
    let truth = trace(&scene, &camera);
    let rows: Vec<_> = (0..8).map(|y| (0..8).map(|x| truth.at(x, y).undecided).collect::<Vec<_>>()).collect();
    // Rows are ¼ m apart; the centres of row 2 lie at z = −0.375 or +0.375: neither is 0.5, so nothing is in doubt …
    assert!(rows.iter().flatten().all(|&undecided| undecided == 0), "{rows:?}");
    // … until the camera moves by ⅛ m, which puts a row on the edge.
    let truth = trace(&scene, &above(DVec3::Z * 0.125, 0.5, 1.0, 8));
    let doubts: Vec<_> = (0..8).map(|y| truth.at(0, y).undecided).collect();
    assert_eq!(doubts.iter().filter(|&&undecided| undecided == 1).count(), 1, "{doubts:?}");
    assert_eq!(doubts.iter().filter(|&&undecided| undecided == 0).count(), 7, "{doubts:?}");
}
