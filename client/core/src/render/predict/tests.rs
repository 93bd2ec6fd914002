//! Compares the prediction pass with single rays traced in f64.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use gnomon_protocol::{
    coverage::Coverage,
    limits::MAX_LAYERS,
    mask::{Mask, MaskShape},
};
use gnomon_scene::{
    LightKind, Scene, SceneAt,
    camera::{Camera, NEAR_M},
};
use gnomon_shaders::gpu::Gpu;

use super::MaskView;
use crate::{
    camera::Viewpoint,
    predictor::{Predictor, Unknown},
    render::{
        FrameRenderer, PixelVisibility,
        readback::PictureReader,
        testing::{camera, floor_and_lights, gpu, renderer},
    },
};

const SIZE: (u32, u32) = (160, 90);

/// Radius in pixels that must be uniform around a pixel for its prediction to be checked: the mask samples light and
/// surface only at its own pixels' centres.
const EDGE_PX: f64 = 1.5;

/// The sun lights the wall from the front, the lamp from behind, so that its shadow on the floor is in view.
fn scene_with_shadows() -> Scene {
    let mut scene = floor_and_lights();
    scene.lights[0].direction = Vec3::new(0.5, -0.7, -0.4).normalize();
    scene.lights[1].position = Vec3::new(1.0, 2.0, -2.5);
    scene
}

/// Lights whose shadow on each draw is checked.
const RELEVANT: [u32; 2] = [0b11, 0b01];

/// Returns the draw that a ray hits first, and the point.
fn first_hit(scene: &Scene, origin: DVec3, direction: DVec3, least: f64) -> Option<(usize, f64)> {
    let mut found: Option<(usize, f64)> = None;
    for (number, draw) in scene.draws.iter().enumerate() {
        let first = draw.first_triangle as usize;
        for corners in &scene.triangles[first..first + draw.triangles as usize] {
            let [a, b, c] = corners.map(|index| scene.positions[index as usize].as_dvec3());
            let normal = (b - a).cross(c - a);
            let distance = normal.dot(a - origin) / normal.dot(direction);
            let point = origin + direction * distance;
            let inside =
                [(a, b), (b, c), (c, a)].iter().all(|(from, to)| (to - from).cross(point - from).dot(normal) >= 0.0);
            if inside && distance > least && found.is_none_or(|(_, nearest)| distance < nearest) {
                found = Some((number, distance));
            }
        }
    }
    found
}

/// Returns what is visible at a position in the picture, in pixels: draw, point, and lights that reach it.
fn seen(scene: &Scene, camera: &Camera, x: f64, y: f64) -> Option<(usize, DVec3, u32)> {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let half_height = (camera.yfov_rad / 2.0).tan();
    let right = (2.0 * x / width - 1.0) * half_height * width / height;
    let direction = camera.orientation * DVec3::new(right, (1.0 - 2.0 * y / height) * half_height, -1.0);
    let origin = camera.position_m - scene.origin_m;
    let (draw, distance) = first_hit(scene, origin, direction, NEAR_M)?;
    let point = origin + direction * distance;
    let mut word = 0;
    for (number, light) in scene.lights.iter().enumerate() {
        let way = match light.kind {
            LightKind::Directional => -light.direction.as_dvec3() * 100.0,
            LightKind::Point | LightKind::Spot { .. } => light.position.as_dvec3() - point,
        };
        let hit = first_hit(scene, point, way, 1e-9);
        word |= u32::from(hit.is_none_or(|(_, distance)| distance >= 1.0)) << number;
    }
    Some((draw, point, word))
}

/// The mask of a view, with `bits` applied to what each pixel sees.
fn mask_of(scene: &Scene, camera: &Camera, bits: impl Fn(usize, u32) -> u32) -> Mask {
    let mut mask = Mask::new(MaskShape::new(camera.width, camera.height, 2).unwrap());
    for y in 0..camera.height {
        for x in 0..camera.width {
            let Some((draw, _, word)) = seen(scene, camera, f64::from(x) + 0.5, f64::from(y) + 0.5) else { continue };
            for light in 0..2 {
                mask.set(light, x, y, bits(draw, word) >> light & 1 == 1);
            }
        }
    }
    mask
}

/// Draws `camera` with a mask for another view.
fn predict(
    gpu: &Gpu,
    renderer: &mut FrameRenderer,
    camera: &Camera,
    mask: &Mask,
    traced_for: &Camera,
) -> Vec<PixelVisibility> {
    predict_from(
        gpu,
        renderer,
        camera,
        &[MaskView { mask, coverage: None, more: false, traced_for, scene: &SceneAt::default() }],
    )
}

/// Draws `camera` after these masks arrived.
fn predict_from(
    gpu: &Gpu,
    renderer: &mut FrameRenderer,
    camera: &Camera,
    masks: &[MaskView<'_>],
) -> Vec<PixelVisibility> {
    let mut reader = PictureReader::new(gpu, SIZE.0, SIZE.1, 1);
    renderer.draw_surfaces(camera).unwrap();
    for mask in masks {
        assert!(renderer.set_mask(Some(*mask)).unwrap());
    }
    let target = reader.target();
    let submission = renderer.shade(camera, 1.0, &target, |encoder| reader.copy(encoder)).unwrap();
    reader.submitted(0, submission, true);
    reader.take_oldest().unwrap();
    renderer.read_visibility().unwrap()
}

fn with_predictor(gpu: &Gpu, scene: &Scene, predictor: Predictor) -> FrameRenderer {
    let mut renderer = renderer(gpu, scene, MaskShape::new(SIZE.0, SIZE.1, 2).unwrap());
    renderer.set_predictor(predictor);
    renderer
}

/// An earlier view: half a metre to the left, and turned a little.
fn before(now: &Camera) -> Camera {
    let turn = glam::DQuat::from_rotation_y(PI / 60.0);
    Camera { position_m: now.position_m - DVec3::X * 0.5, orientation: turn * now.orientation, ..*now }
}

/// Calls `check` with draw, point and lights of each pixel whose surroundings are uniform.
fn each_calm_pixel(scene: &Scene, camera: &Camera, mut check: impl FnMut(usize, usize, DVec3, u32)) -> usize {
    let mut calm = 0;
    for y in 0..camera.height {
        for x in 0..camera.width {
            let at = |dx: f64, dy: f64| seen(scene, camera, f64::from(x) + 0.5 + dx, f64::from(y) + 0.5 + dy);
            let Some((draw, point, word)) = at(0.0, 0.0) else { continue };
            let same = (0..9).all(|place| {
                let (dx, dy) = (f64::from(place % 3 - 1), f64::from(place / 3 - 1));
                at(dx * EDGE_PX, dy * EDGE_PX).is_some_and(|there| (there.0, there.2) == (draw, word))
            });
            if same {
                calm += 1;
                check((y * camera.width + x) as usize, draw, point, word);
            }
        }
    }
    calm
}

#[test]
fn away_from_edges_every_pixel_and_its_known_flag_are_right() {
    let (gpu, scene, now) = (gpu(), scene_with_shadows(), camera(SIZE.0, SIZE.1));
    let then = before(&now);
    let mask = mask_of(&scene, &then, |_, word| word);
    let mut renderer = with_predictor(&gpu, &scene, Predictor::Surface);
    let shown = predict(&gpu, &mut renderer, &now, &mask, &then);
    let eye = then.position_m - scene.origin_m;
    let (mut unknown, mut shadowed) = (0, 0);
    let calm = each_calm_pixel(&scene, &now, |pixel, draw, point, word| {
        assert_eq!((shown[pixel].word ^ word) & RELEVANT[draw], 0, "pixel {pixel}, draw {draw}: {:?}", shown[pixel]);
        shadowed += usize::from(word != 0b11);
        // Where the point was in the earlier picture, how many pixels inside its border, and whether it was covered.
        let place = then.orientation.inverse() * (point - eye);
        let pixels = f64::from(SIZE.1) / 2.0 / (then.yfov_rad / 2.0).tan() / -place.z;
        let inside = f64::min(
            f64::from(SIZE.0) / 2.0 - (place.x * pixels).abs(),
            f64::from(SIZE.1) / 2.0 - (place.y * pixels).abs(),
        );
        let covered = (0..9).map(|number| {
            let (dx, dy) = (f64::from(number % 3 - 1), f64::from(number / 3 - 1));
            let there = point + then.orientation * DVec3::new(dx, dy, 0.0) * EDGE_PX / pixels;
            first_hit(&scene, eye, there - eye, 0.0).is_none_or(|(hit, _)| hit != draw)
        });
        match covered.filter(|&covered| covered).count() {
            0 if inside > EDGE_PX => assert!(shown[pixel].known, "pixel {pixel} was seen"),
            9 => {
                unknown += 1;
                assert!(!shown[pixel].known, "pixel {pixel} was hidden");
            }
            _ if inside < -EDGE_PX => {
                unknown += 1;
                assert!(!shown[pixel].known, "pixel {pixel} was outside");
            }
            _ => {}
        }
    });
    // The wall hides floor, the picture's side comes into view, and there is shadow.
    assert!(calm > 6000 && unknown > 200 && shadowed > 100, "{calm} calm, {unknown} unknown, {shadowed} shadowed");
}

#[test]
fn nothing_bleeds_from_one_surface_to_another() {
    let (gpu, scene, now) = (gpu(), scene_with_shadows(), camera(SIZE.0, SIZE.1));
    let then = before(&now);
    // All light on the floor, none on the wall: a known pixel's word tells which surface it came from.
    let of_draw = [0b11, 0b00];
    let mask = mask_of(&scene, &then, |draw, _| of_draw[draw]);
    let known_from_the_other_surface = |predictor| {
        let mut renderer = with_predictor(&gpu, &scene, predictor);
        let shown = predict(&gpu, &mut renderer, &now, &mask, &then);
        let (mut known, mut wrong) = ([0; 2], 0);
        for y in 0..SIZE.1 {
            for x in 0..SIZE.0 {
                // Rasterisation may see either surface where an edge passes through the pixel's centre.
                let at = |d: f64| seen(&scene, &now, f64::from(x) + 0.5 + d, f64::from(y) + 0.5 + d).map(|seen| seen.0);
                let Some(draw) = at(0.0).filter(|&draw| at(0.01) == Some(draw) && at(-0.01) == Some(draw)) else {
                    continue;
                };
                let pixel = shown[(y * SIZE.0 + x) as usize];
                known[draw] += usize::from(pixel.known);
                wrong += usize::from(pixel.known && pixel.word != of_draw[draw]);
            }
        }
        assert!(known[0] > 5000 && known[1] > 300, "{known:?}");
        wrong
    };
    assert_eq!(known_from_the_other_surface(Predictor::Surface), 0);
    // The test can fail: the nearest-sample predictor does.
    let wrong = known_from_the_other_surface(Predictor::Dissertation(Unknown::Lit));
    assert!(wrong > 0);
}

#[test]
fn the_masks_own_view_is_copied_bit_for_bit() {
    let (gpu, scene, now) = (gpu(), scene_with_shadows(), camera(SIZE.0, SIZE.1));
    let mut mask = Mask::new(MaskShape::new(SIZE.0, SIZE.1, 2).unwrap());
    let bit =
        |light: u32, x: u32, y: u32| (x.wrapping_mul(2_654_435_761) ^ y.wrapping_mul(40_503) ^ light) >> 7 & 1 == 1;
    for (light, y) in (0..2).flat_map(|light| (0..SIZE.1).map(move |y| (light, y))) {
        (0..SIZE.0).for_each(|x| mask.set(light, x, y, bit(light, x, y)));
    }
    for predictor in [Predictor::None, Predictor::Dissertation(Unknown::Lit), Predictor::Surface] {
        let mut renderer = with_predictor(&gpu, &scene, predictor);
        let shown = predict(&gpu, &mut renderer, &now, &mask, &now);
        let mut surfaces = 0;
        for (pixel, (x, y)) in shown.iter().zip((0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y)))) {
            if pixel.known {
                surfaces += 1;
                assert_eq!(
                    pixel.word,
                    u32::from(bit(0, x, y)) | u32::from(bit(1, x, y)) << 1,
                    "{predictor} ({x}, {y})"
                );
            }
        }
        assert!(surfaces > 6000, "{predictor}: {surfaces}");
    }
}

#[test]
fn the_dissertations_predictor_fills_outside_points_in_three_ways() {
    let (gpu, scene, now) = (gpu(), scene_with_shadows(), camera(SIZE.0, SIZE.1));
    // Half a turn away: nothing in the new picture was in the old one.
    let away = Camera { orientation: glam::DQuat::from_rotation_y(PI) * now.orientation, ..now };
    let mut mask = Mask::new(MaskShape::new(SIZE.0, SIZE.1, 2).unwrap());
    (0..SIZE.1).for_each(|y| (0..SIZE.0).for_each(|x| mask.set(1, x, y, true)));
    for (unknown, word) in [(Unknown::Lit, 0b11), (Unknown::Shadow, 0b00), (Unknown::Copy, 0b10)] {
        let mut renderer = with_predictor(&gpu, &scene, Predictor::Dissertation(unknown));
        let shown = predict(&gpu, &mut renderer, &now, &mask, &away);
        each_calm_pixel(&scene, &now, |pixel, _, _, _| {
            assert_eq!((shown[pixel].word & 0b11, shown[pixel].known), (word, false), "{unknown:?}");
        });
    }
}

#[test]
fn kept_depth_and_redrawn_depth_give_the_same_result() {
    let (gpu, scene, now) = (gpu(), scene_with_shadows(), camera(SIZE.0, SIZE.1));
    let then = before(&now);
    let mask = mask_of(&scene, &then, |_, word| word);
    let mut renderer = with_predictor(&gpu, &scene, Predictor::Surface);
    let anew = predict(&gpu, &mut renderer, &now, &mask, &then);
    let mut renderer = with_predictor(&gpu, &scene, Predictor::Surface);
    renderer.draw_surfaces(&then).unwrap();
    let kept = predict(&gpu, &mut renderer, &now, &mask, &then);
    assert!(renderer.history.find(&Viewpoint::resting(then)).is_some());
    assert!(anew == kept);
}

#[test]
fn a_guard_band_covers_what_a_turn_brings_into_view() {
    let (gpu, scene, now) = (gpu(), scene_with_shadows(), camera(SIZE.0, SIZE.1));
    let then = Camera { orientation: glam::DQuat::from_rotation_y(PI / 60.0) * now.orientation, ..now };
    let unknown = |extra: u32| {
        let traced_for = then.widened((extra, extra));
        let mask = mask_of(&scene, &traced_for, |_, word| word);
        let mut renderer = with_predictor(&gpu, &scene, Predictor::Surface);
        let shown = predict(&gpu, &mut renderer, &now, &mask, &traced_for);
        let mut unknown = 0;
        each_calm_pixel(&scene, &now, |pixel, draw, _, word| {
            unknown += usize::from(!shown[pixel].known);
            assert_eq!((shown[pixel].word ^ word) & RELEVANT[draw], 0, "pixel {pixel}");
        });
        unknown
    };
    assert!(unknown(0) > 100);
    assert_eq!(unknown(32), 0);
}

#[test]
fn without_a_mask_the_shadow_maps_are_used() {
    let (gpu, scene, now) = (gpu(), scene_with_shadows(), camera(SIZE.0, SIZE.1));
    let mut renderer = with_predictor(&gpu, &scene, Predictor::Surface);
    let mut reader = PictureReader::new(&gpu, SIZE.0, SIZE.1, 1);
    renderer.draw_surfaces(&now).unwrap();
    let target = reader.target();
    let submission = renderer.shade(&now, 1.0, &target, |encoder| reader.copy(encoder)).unwrap();
    reader.submitted(0, submission, true);
    reader.take_oldest().unwrap();
    let shown = renderer.read_visibility().unwrap();
    let mut shadowed = 0;
    each_calm_pixel(&scene, &now, |pixel, draw, _, word| {
        assert!(!shown[pixel].known);
        assert_eq!((shown[pixel].word ^ word) & RELEVANT[draw], 0, "pixel {pixel}: {:?}", shown[pixel]);
        shadowed += usize::from(word != 0b11);
    });
    assert!(shadowed > 100, "{shadowed} shadowed");
}

/// A mask whose pixels all have this word; `came` gives the lights that arrived for each tile position.
fn in_part(word: u32, came: impl Fn(u32, u32) -> u32) -> (Mask, Coverage) {
    let shape = MaskShape::new(SIZE.0, SIZE.1, 2).unwrap();
    let mut mask = Mask::new(shape);
    for (y, x) in (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (y, x))) {
        (0..2).for_each(|light| mask.set(light, x, y, word >> light & 1 == 1));
    }
    let [across, down] = Coverage::places(shape);
    let words = (0..down).flat_map(|y| (0..across).map(move |x| (x, y))).map(|(x, y)| came(x, y)).collect();
    (mask, Coverage::from_words(shape, words).unwrap())
}

/// Projects a point into a view, in pixels. Returns `None` if it is covered or near an edge.
fn place_in(scene: &Scene, camera: &Camera, draw: usize, point: DVec3) -> Option<(f64, f64)> {
    let eye = camera.position_m - scene.origin_m;
    let place = camera.orientation.inverse() * (point - eye);
    let pixels = f64::from(SIZE.1) / 2.0 / (camera.yfov_rad / 2.0).tan() / -place.z;
    let (x, y) = (f64::from(SIZE.0) / 2.0 + place.x * pixels, f64::from(SIZE.1) / 2.0 - place.y * pixels);
    let visible = (0..9).all(|number| {
        let (dx, dy) = (f64::from(number % 3 - 1), f64::from(number / 3 - 1));
        let there = point + camera.orientation * DVec3::new(dx, dy, 0.0) * EDGE_PX / pixels;
        first_hit(scene, eye, there - eye, 0.0).is_some_and(|(hit, _)| hit == draw)
    });
    let inside = |at: f64, side: u32| at > EDGE_PX && at < f64::from(side) - EDGE_PX;
    (visible && inside(x, SIZE.0) && inside(y, SIZE.1)).then_some((x, y))
}

/// The newest mask has the upper half of one light and the lower half of the other; the one before has the left two
/// thirds of both; the oldest has everything. Each point must come from the newest mask that has it, and bits that did
/// not arrive must never be used.
#[test]
fn missing_tiles_are_looked_up_in_earlier_masks() {
    let at = SceneAt::default();
    let (gpu, scene, now) = (gpu(), scene_with_shadows(), camera(SIZE.0, SIZE.1));
    let views = [0.6, 0.3, 0.1].map(|left| Camera { position_m: now.position_m - DVec3::X * left, ..now });
    let (oldest, all) = in_part(0b00, |_, _| 0b11);
    let (middle, left) = in_part(0b01, |x, _| if x < 2 { 0b11 } else { 0 });
    let (newest, halves) = in_part(0b11, |_, y| if y < 6 { 0b01 } else { 0b10 });
    let masks = [(&oldest, &all), (&middle, &left), (&newest, &halves)];
    let masks: Vec<_> = masks
        .iter()
        .zip(&views)
        .map(|((mask, coverage), traced_for)| MaskView {
            mask,
            coverage: Some(coverage),
            more: false,
            traced_for,
            scene: &at,
        })
        .collect();
    let mut renderer = with_predictor(&gpu, &scene, Predictor::Surface);
    let shown = predict_from(&gpu, &mut renderer, &now, &masks);
    let mut seen_in = [0; 3];
    each_calm_pixel(&scene, &now, |pixel, draw, point, _| {
        let places = views.each_ref().map(|view| place_in(&scene, view, draw, point));
        let [_, Some((x, _)), Some((_, y))] = places else { return };
        // Skips the borders of what arrived.
        if (x - 128.0).abs() < 2.0 || (y - 48.0).abs() < 2.0 {
            return;
        }
        let upper = y < 48.0;
        let newest = if upper { 0b01 } else { 0b10 };
        let expected = if x < 128.0 {
            newest | 0b01
        } else if places[0].is_some() {
            seen_in[0] += 1;
            newest
        } else {
            return;
        };
        seen_in[1 + usize::from(upper)] += 1;
        let shown = shown[pixel];
        assert_eq!((shown.word, shown.known), (expected, true), "pixel {pixel}: {places:?}");
        assert_eq!(shown.oldest_layer, if x < 128.0 { 1 } else { 2 }, "pixel {pixel}: {places:?}");
    });
    assert!(seen_in.iter().all(|pixels| *pixels > 300), "{seen_in:?}");
    // A complete mask replaces the others.
    let view = masks[0];
    let shown = predict_from(&gpu, &mut renderer, &now, &[view]);
    assert!(shown.iter().all(|pixel| !pixel.known || pixel.word == 0b00));
    assert_eq!(renderer.predict.layers.stack().len(), 1);
}

/// More masks than layers, each with one row of tile positions, from the lowest up: the newest eight are found, and
/// rows that only older ones had are unknown.
#[test]
fn the_number_of_layers_is_limited() {
    let at = SceneAt::default();
    let (gpu, scene, now) = (gpu(), scene_with_shadows(), camera(SIZE.0, SIZE.1));
    let rows = 11;
    let views: Vec<Camera> = (0..rows)
        .map(|n| Camera { position_m: now.position_m - DVec3::X * (0.001 * f64::from(rows - n)), ..now })
        .collect();
    let parts: Vec<_> = (0..rows).map(|row| in_part(0b11, move |_, y| if y + row == 10 { 0b11 } else { 0 })).collect();
    let masks: Vec<_> = parts
        .iter()
        .zip(&views)
        .map(|((mask, coverage), traced_for)| MaskView {
            mask,
            coverage: Some(coverage),
            more: false,
            traced_for,
            scene: &at,
        })
        .collect();
    let mut renderer = with_predictor(&gpu, &scene, Predictor::Surface);
    // One after the other, so that pictures are drawn from few layers and from many.
    let mut shown = Vec::new();
    for mask in &masks {
        shown = predict_from(&gpu, &mut renderer, &now, &[*mask]);
    }
    assert_eq!(renderer.predict.layers.stack().len(), MAX_LAYERS);
    let mut known = [0; 2];
    each_calm_pixel(&scene, &now, |pixel, _, _, _| {
        let row = u32::try_from(pixel).unwrap() / SIZE.0;
        if matches!(row % 8, 2..6) && row / 8 < rows {
            let kept = row / 8 < 8;
            known[usize::from(kept)] += 1;
            assert_eq!(shown[pixel].known, kept, "pixel {pixel}");
        }
    });
    assert!(known[0] > 100 && known[1] > 1000, "{known:?}");
    // The camera stands still: tiles for the same view add up, and more tiles of the same mask replace it.
    let masks = [&parts[3], &parts[4]].map(|(mask, coverage)| MaskView {
        mask,
        coverage: Some(coverage),
        more: false,
        traced_for: &now,
        scene: &at,
    });
    let known_rows = |masks: &[MaskView<'_>], renderer: &mut FrameRenderer| {
        renderer.set_mask(None).unwrap();
        let shown = predict_from(&gpu, renderer, &now, masks);
        let row = |row: u32| &shown[(row * 8 * SIZE.0) as usize..][..(8 * SIZE.0) as usize];
        (renderer.predict.layers.stack().len(), [7, 6, 5].map(|number| row(number).iter().any(|pixel| pixel.known)))
    };
    assert_eq!(known_rows(&masks, &mut renderer), (2, [true, true, false]));
    let more = [masks[0], MaskView { more: true, ..masks[1] }];
    assert_eq!(known_rows(&more, &mut renderer), (1, [false, true, false]));
}
