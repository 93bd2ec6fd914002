//! Promise: the referee can fail a back end. Masks of a real back end pass; with one fault planted in its input or
//! output, the same comparison under the same bounds fails.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use glam::{DVec3, Vec3};
use gnomon_lab::{
    backends::BackendName,
    metrics::RelevantError,
    reference::{Reference, Truth},
    scenes::builder::SceneBuilder,
};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{AlphaMode, Scene, camera::Camera};
use gnomon_server::visibility::backend::compute::ComputeBackend;

/// The bounds of `tests/accuracy.rs`.
const MOST_WRONG: f64 = 0.0001;

/// A hall with a box, a coarse ball and a tilted screen, far enough from its origin for coordinates to round.
fn scene() -> Scene {
    SceneBuilder::new()
        .quad(Vec3::new(40.0, 30.0, 30.0), Vec3::Z * 12.0, Vec3::X * 12.0)
        .quad(Vec3::new(42.0, 30.3, 33.0), Vec3::new(0.3, 2.0, 0.4), Vec3::new(1.7, 0.1, 0.9))
        .material(AlphaMode::Opaque, false)
        .cuboid(Vec3::new(45.0, 30.0, 35.0), Vec3::new(46.3, 31.7, 36.1))
        .sphere(Vec3::new(48.2, 31.0, 36.0), 1.0, 12)
        .point_light(Vec3::new(47.0, 33.5, 39.0), f32::INFINITY)
        .point_light(Vec3::new(41.0, 32.0, 37.0), 9.0)
        .sun(Vec3::new(0.4, -1.0, -0.3))
        .build()
}

fn camera() -> Camera {
    Camera::looking_at(DVec3::new(47.5, 33.2, 41.5), DVec3::new(46.0, 30.6, 35.5), 1.0, 160, 96)
}

fn judge(mask: &Mask, truth: &Truth) -> RelevantError {
    RelevantError::of(mask, truth)
}

/// Returns whether a mask would pass the test on real scenes.
fn passes(error: &RelevantError) -> bool {
    error.sure_share() <= MOST_WRONG && error.worst_distance_px <= 1.0 && error.irrelevant_set == 0
}

/// Returns the scene's truth, and a correct mask.
fn sound(scene: &Scene, backend: BackendName) -> (Truth, Mask) {
    let truth = Reference::new(scene).trace(&camera());
    let mask = backend.mask(scene, &camera()).unwrap();
    let error = judge(&mask, &truth);
    assert!(error.relevant > 20_000 && passes(&error), "without a fault: {error}");
    (truth, mask)
}

#[test]
fn an_offset_error_is_caught() {
    let scene = scene();
    let (truth, _) = sound(&scene, BackendName::Compute);
    let traced = |roundings: u16| {
        let mut backend = ComputeBackend::open_with_offset(&scene, None, true, roundings).unwrap();
        let mut mask = Mask::new(MaskShape::new(160, 96, 3).unwrap());
        backend.trace(&camera(), &mut mask).unwrap();
        judge(&mask, &truth)
    };
    let right = traced(16);
    assert!(passes(&right), "with the offset that the rules give: {right}");
    // At the floor's height of 30 m these are 11 cm: light gets under objects.
    let far = traced(60_000);
    assert!(!passes(&far) && far.sure_leaks > 20, "{far}");
}

#[test]
fn a_missing_triangle_is_caught() {
    let scene = scene();
    for backend in BackendName::EVERYWHERE {
        let (truth, _) = sound(&scene, backend);
        let mut caught = 0;
        // Triangles of the floor, the screen, the box and the ball.
        for missing in [0, 1, 2, 3, 4, 5, 14, 15, 100, 180] {
            let mut broken = scene.clone();
            // It stays with zero area, so that indices do not change.
            let [first, ..] = broken.triangles[missing];
            broken.triangles[missing] = [first; 3];
            let error = judge(&backend.mask(&broken, &camera()).unwrap(), &truth);
            let changes = Reference::new(&broken).trace(&camera()) != truth;
            // An invisible triangle without a shadow may be missing.
            assert!(changes || passes(&error), "triangle {missing} on {}: {error}", backend.name());
            caught += u32::from(!passes(&error));
        }
        assert!(caught >= 5, "{caught} of 10 missing triangles caught on {}", backend.name());
    }
}

#[test]
fn an_off_by_one_in_a_bit_plane_is_caught() {
    let scene = scene();
    for backend in BackendName::EVERYWHERE {
        let (truth, mask) = sound(&scene, backend);
        let shape = mask.shape();
        let altered = |from: &dyn Fn(u32, u32, u32) -> Option<[u32; 3]>| {
            let mut altered = Mask::new(shape);
            for (y, x) in (0..shape.height()).flat_map(|y| (0..shape.width()).map(move |x| (y, x))) {
                for light in 0..shape.lights() {
                    let set = from(light, x, y).is_some_and(|[light, x, y]| mask.get(light, x, y));
                    altered.set(light, x, y, set);
                }
            }
            judge(&altered, &truth)
        };
        assert!(passes(&altered(&|light, x, y| Some([light, x, y]))));
        for (fault, error) in [
            ("planes in another order", altered(&|light, x, y| Some([(light + 1) % 3, x, y]))),
            ("a column too far", altered(&|light, x, y| Some([light, x.checked_sub(1)?, y]))),
            ("a row too far", altered(&|light, x, y| Some([light, x, y.checked_sub(1)?]))),
        ] {
            assert!(!passes(&error), "{fault} on {}: {error}", backend.name());
        }
        // Shifts the words of one plane, as a tile index one too high would.
        let mut shifted = mask.clone();
        shifted.words_mut()[..shape.tiles()].rotate_right(1);
        let error = judge(&shifted, &truth);
        assert!(!passes(&error), "a tile too far on {}: {error}", backend.name());
        // Loses the last bit of every word: one pixel of 64.
        let mut cut = mask.clone();
        cut.words_mut().iter_mut().for_each(|word| *word &= !(1 << 63));
        let error = judge(&cut, &truth);
        assert!(!passes(&error) && error.leaks == 0, "a bit too few on {}: {error}", backend.name());
    }
}
