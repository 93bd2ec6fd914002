//! What moves is drawn as the scene that stands still at that time.

use glam::{DQuat, DVec3, Vec2, Vec3, Vec4};
use gnomon_protocol::{
    coverage::Coverage,
    mask::{Mask, MaskShape},
};
use gnomon_scene::{
    Aabb, AlphaMode, AnimatedLight, AnimatedNode, Animation, Draw, Interpolation, Material, Piece, Place, Scene,
    SceneAt, Track, camera::Camera,
};
use gnomon_shaders::gpu::Gpu;

use crate::{
    occluders::Occluders,
    predictor::Predictor,
    render::{
        FrameRenderer, PICTURE_FORMAT, PixelVisibility,
        environment::Environment,
        exposure::Exposure,
        predict::MaskView,
        readback::{self, PictureReader},
        survey::Survey,
        testing::{camera, floor_and_lights, gpu},
        work::Work,
    },
};

pub(in crate::render) const SIZE: (u32, u32) = (160, 90);

/// At keys, between them, after many rounds, and back again.
const TIMES_S: [f64; 7] = [0.0, 0.3, 0.9, 1.0, 1.7, 1234.5, 0.3];

pub(super) fn track(interpolation: Interpolation, times_s: &[f32], values: &[f32]) -> Option<Track> {
    let period_s = times_s.last().copied().map_or(0.0, f64::from);
    Some(Track { period_s, interpolation, times_s: times_s.to_vec(), values: values.to_vec() })
}

pub(in crate::render) fn node() -> AnimatedNode {
    // At the scene's origin.
    AnimatedNode { translation_m: DVec3::X * 1000.0, ..AnimatedNode::default() }
}

/// A swinging wall; a single-sided square that turns inside out; one that is shown half of the time; a pane of BLEND.
/// The lamp's brightness changes, and if `lights_move` the sun turns and the lamp travels.
pub(in crate::render) fn living(lights_move: bool) -> Scene {
    let mut scene = floor_and_lights();
    scene.lights[0].direction = Vec3::new(0.5, -0.7, -0.4).normalize();
    let mut animation = Animation { nodes: vec![node(); 6], ..Animation::default() };
    let piece = |animation: &mut Animation, node: u32, scene: &Scene, first_vertex: u32| {
        let own = first_vertex as usize..first_vertex as usize + 4;
        let bounds = Aabb::around(&scene.positions[own.clone()]);
        animation.positions.extend_from_slice(&scene.positions[own.clone()]);
        animation.normals.extend_from_slice(&scene.normals[own.clone()]);
        animation.tangents.extend_from_slice(&scene.tangents[own]);
        animation.pieces.push(Piece { node, first_vertex, vertices: 4, bounds, mirrored: false });
    };
    for (material, corner) in
        [(2, Vec3::new(-1.4, 0.1, 0.3)), (1, Vec3::new(0.6, 0.2, 0.5)), (3, Vec3::new(-0.4, 0.1, 1.0))]
    {
        let first = u32::try_from(scene.positions.len()).unwrap();
        let square = [Vec3::ZERO, Vec3::X * 0.7, Vec3::new(0.7, 0.8, 0.0), Vec3::Y * 0.8];
        scene.positions.extend(square.map(|at| at + corner));
        scene.normals.extend([Vec3::Z; 4]);
        scene.uvs.extend([Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y]);
        let first_triangle = u32::try_from(scene.triangles.len()).unwrap();
        scene.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        scene.draws.push(Draw { first_triangle, triangles: 2, material });
    }
    scene.materials.push(Material { base_color: Vec4::new(0.2, 0.7, 0.2, 1.0), ..scene.materials[0].clone() });
    let pane = Vec4::new(0.2, 0.3, 0.9, 0.5);
    scene.materials.push(Material { base_color: pane, alpha: AlphaMode::Blend, ..scene.materials[1].clone() });
    scene.tangents = vec![Vec4::new(1.0, 0.0, 0.0, 1.0); scene.positions.len()];
    for (node, first_vertex) in [(0, 4), (1, 8), (2, 12), (3, 16)] {
        piece(&mut animation, node, &scene, first_vertex);
    }
    let turn = |axis: DVec3, angles: [f64; 3]| {
        let values = angles.map(|angle| DQuat::from_axis_angle(axis, angle).as_quat().to_array());
        track(Interpolation::Linear, &[0.0, 1.0, 2.0], values.as_flattened())
    };
    animation.nodes[0].rotation_track = turn(DVec3::Y, [0.0, 0.9, -0.7]);
    animation.nodes[1].scale_track =
        track(Interpolation::Linear, &[0.0, 1.6, 2.0], &[1.0, 1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 0.5, 1.0]);
    animation.nodes[2].visible_track = track(Interpolation::Step, &[0.0, 0.5, 1.5], &[1.0, 0.0, 1.0]);
    animation.nodes[3].translation_track = track(
        Interpolation::CubicSpline,
        &[0.0, 2.0],
        &[[0.0; 3], [1000.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0; 3], [1000.0, 0.5, 0.9], [0.0; 3]].concat(),
    );
    animation.nodes[4].rotation_track = turn(DVec3::Z, [0.2, 0.9, 0.3]);
    animation.nodes[5].translation_track =
        track(Interpolation::Linear, &[0.0, 1.0, 2.0], &[1000.0, 2.0, 2.0, 1002.0, 2.5, -2.0, 999.0, 3.0, 1.0]);
    let intensity_track = track(Interpolation::Linear, &[0.0, 2.0], &[40.0, 10.0]);
    let mut lamp = AnimatedLight { light: 1, intensity_track, ..AnimatedLight::default() };
    if lights_move {
        // Lights shine along −z.
        let node_from_own = glam::DMat4::from_rotation_x(-1.1);
        let sun = Place { node: 4, node_from_own };
        animation.lights.push(AnimatedLight { light: 0, place: Some(sun), ..AnimatedLight::default() });
        lamp.place = Some(Place { node: 5, node_from_own: glam::DMat4::IDENTITY });
    } else {
        animation.nodes.truncate(4);
    }
    animation.lights.push(lamp);
    scene.animation = Some(Box::new(animation));
    assert_eq!(scene.check(), Ok(()));
    // All that moves stays in there.
    scene.bounds = Aabb { min: Vec3::new(-4.0, -2.0, -4.0), max: Vec3::new(4.0, 3.0, 4.0) };
    scene
}

/// The scene that stands still in a state. Maps and near plane are those of the moving one.
pub(super) fn still(scene: &Scene, at: impl Into<SceneAt>) -> Scene {
    Scene { bounds: scene.bounds, ..scene.still_at(at) }
}

pub(in crate::render) fn renderer(gpu: &Gpu, scene: &Scene, exposure: Exposure) -> FrameRenderer {
    FrameRenderer::new(gpu, scene, SIZE, exposure, PICTURE_FORMAT, Predictor::Surface).unwrap()
}

/// Draws what the camera sees of a state. Returns the picture's bytes and its visibility.
pub(super) fn draw(
    gpu: &Gpu,
    renderer: &mut FrameRenderer,
    (camera, at): (&Camera, impl Into<SceneAt>),
    mask: Option<MaskView<'_>>,
) -> (Vec<u8>, Vec<PixelVisibility>) {
    let mut reader = PictureReader::new(gpu, SIZE.0, SIZE.1, 1);
    renderer.set_time(at);
    renderer.draw_surfaces(camera).unwrap();
    assert_eq!(renderer.set_mask(mask).unwrap(), mask.is_some());
    let submission = renderer.shade(camera, 1.0, &reader.target(), |encoder| reader.copy(encoder)).unwrap();
    reader.submitted(0, submission, true);
    (reader.take_oldest().unwrap().flatten().unwrap().rgba, renderer.read_visibility().unwrap())
}

/// Whether two pictures and their visibility are the same, but for what rounding may do. The adapter puts vertices that
/// move a few rounding units from where the still scene has them: so the centre of a pixel may fall on the other side
/// of an edge, and a colour may round to its neighbour.
pub(super) fn alike(one: &(Vec<u8>, Vec<PixelVisibility>), other: &(Vec<u8>, Vec<PixelVisibility>)) -> bool {
    let far = |(a, b): &(&[u8; 4], &[u8; 4])| a.iter().zip(*b).any(|(a, b)| a.abs_diff(*b) > 1);
    let pixels = one.0.as_chunks().0.iter().zip(other.0.as_chunks().0);
    let visibility = one.1.iter().zip(&other.1);
    let differing = pixels.filter(far).count() + visibility.filter(|(one, other)| one != other).count();
    one.0.len() == other.0.len() && differing * 1000 <= one.1.len()
}

#[test]
fn a_moving_scene_is_drawn_as_the_still_one_of_its_time() {
    let (gpu, camera) = (gpu(), camera(SIZE.0, SIZE.1));
    for lights_move in [false, true] {
        let scene = living(lights_move);
        let exposure = Exposure::of_scene(&scene, &Occluders::default());
        let mut moving = renderer(&gpu, &scene, exposure);
        let mut pictures = Vec::new();
        for time_s in TIMES_S {
            let mut standing = renderer(&gpu, &still(&scene, time_s), exposure);
            let found = draw(&gpu, &mut moving, (&camera, time_s), None);
            let expected = draw(&gpu, &mut standing, (&camera, time_s), None);
            assert!(alike(&found, &expected), "{time_s} s, {lights_move}");
            pictures.push(found.0);
        }
        assert_eq!(pictures[1], pictures[6]);
        assert!(pictures[..6].iter().enumerate().all(|(i, one)| !pictures[..i].contains(one)), "nothing moves");
    }
}

/// Of what moves, only what may shade a picture is drawn into its maps. The picture is the same with all of it, which
/// is drawn when the same state is seen from elsewhere.
#[test]
fn shadow_maps_have_what_shades_the_picture_wherever_it_is_taken() {
    let (gpu, first, scene) = (gpu(), camera(SIZE.0, SIZE.1), living(false));
    let mut renderer = renderer(&gpu, &scene, Exposure::of_scene(&scene, &Occluders::default()));
    let looking = |from: DVec3, to: DVec3| {
        let middle = DVec3::X * 1000.0;
        Camera::looking_at(middle + from, middle + to, 1.0, SIZE.0, SIZE.1)
    };
    // A corner that no shadow reaches, and one behind the things.
    let corner = looking(DVec3::new(-3.0, 1.0, 3.0), DVec3::new(-3.2, 0.0, 3.4));
    let behind = looking(DVec3::new(0.9, 1.4, 0.2), DVec3::new(1.6, 0.0, -0.7));
    let mut left_out = 0;
    for time_s in [0.3, 0.9, 1.7] {
        for (camera, other) in [(first, corner), (corner, behind), (behind, first)] {
            // Of another state, so that the next one is drawn anew.
            draw(&gpu, &mut renderer, (&first, time_s + 0.1), None);
            let mut drawn = |camera: &Camera| {
                let before = renderer.work().triangles;
                let found = draw(&gpu, &mut renderer, (camera, time_s), None);
                (found, renderer.work().triangles - before)
            };
            let ((culled, _), (_, again), (whole, none)) = (drawn(&camera), drawn(&other), drawn(&camera));
            assert!(culled == whole, "{time_s} s, {camera:?}");
            assert_eq!(none, 0);
            left_out += u32::from(again > 0);
        }
    }
    assert!(left_out > 2, "all is drawn for {left_out} pictures only");
}

#[test]
fn the_sky_follows_a_sun() {
    let (gpu, camera, scene) = (gpu(), camera(SIZE.0, SIZE.1), living(true));
    let exposure = Exposure::of_scene(&scene, &Occluders::default());
    let survey = Survey { lux: 3.0, daylight: 0.8, ..Survey::default() };
    let drawn = |scene: &Scene, time_s: f64| {
        let mut renderer = renderer(&gpu, scene, exposure);
        renderer.set_environment(Environment::Sky, survey);
        draw(&gpu, &mut renderer, (&camera, time_s), None)
    };
    let found = drawn(&scene, 0.75);
    assert!(alike(&found, &drawn(&still(&scene, 0.75), 0.75)));
    assert_ne!(found, drawn(&scene, 0.0));
}

/// A mask in which each light reaches every second column.
fn stripes() -> Mask {
    let mut mask = Mask::new(MaskShape::new(SIZE.0, SIZE.1, 2).unwrap());
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            (0..2).for_each(|light| mask.set(light, x, y, (x / 4 + light) % 2 == 0));
        }
    }
    mask
}

#[test]
fn a_mask_of_an_earlier_time_is_laid_over_what_was_seen_then() {
    let (gpu, now, scene) = (gpu(), camera(SIZE.0, SIZE.1), living(false));
    let exposure = Exposure::of_scene(&scene, &Occluders::default());
    let mask = stripes();
    let (then_s, now_s) = (0.4, 0.7);
    let (then_at, now_at) = (SceneAt::from(then_s), SceneAt::from(now_s));
    let view = |scene| MaskView { mask: &mask, coverage: None, more: false, traced_for: &now, scene };
    let mut seen_before = renderer(&gpu, &scene, exposure);
    draw(&gpu, &mut seen_before, (&now, then_s), None);
    let kept = draw(&gpu, &mut seen_before, (&now, now_s), Some(view(&then_at)));
    let mut fresh = renderer(&gpu, &scene, exposure);
    // Its depth is drawn again, in the same submission that draws the picture of another time.
    assert!(kept == draw(&gpu, &mut fresh, (&now, now_s), Some(view(&then_at))));
    // A mask of this time is taken as it is; the same camera at another time is another view.
    let own = draw(&gpu, &mut fresh, (&now, now_s), Some(view(&now_at)));
    assert!(own.1.iter().enumerate().all(|(at, pixel)| {
        let x = u32::try_from(at).unwrap() % SIZE.0;
        pixel.word == 0 || pixel.word == 1 << (x / 4 % 2)
    }));
    let unknown = |(_, pixels): &(Vec<u8>, Vec<PixelVisibility>)| {
        pixels.iter().filter(|pixel| !pixel.known && pixel.word != 0).count()
    };
    assert!(unknown(&kept) > unknown(&own), "{} {}", unknown(&kept), unknown(&own));
    // The next picture is of its own time again.
    let after = draw(&gpu, &mut fresh, (&now, now_s), None);
    let standing = draw(&gpu, &mut renderer(&gpu, &still(&scene, now_s), exposure), (&now, now_s), None);
    assert!(alike(&after, &standing));
}

/// The visibility that the client finds by itself, as a mask.
pub(super) fn as_mask(pixels: &[PixelVisibility]) -> Mask {
    let mut mask = Mask::new(MaskShape::new(SIZE.0, SIZE.1, 2).unwrap());
    for (place, pixel) in (0..).zip(pixels) {
        (0..2).for_each(|light| mask.set(light, place % SIZE.0, place / SIZE.0, pixel.word >> light & 1 == 1));
    }
    mask
}

/// The depth of each pixel of the last picture, as bits.
fn depth(gpu: &Gpu, renderer: &FrameRenderer) -> Vec<[u8; 4]> {
    let bytes = readback::texels(gpu, renderer.history.view(), wgpu::TextureAspect::DepthOnly).unwrap();
    bytes.as_chunks().0.to_vec()
}

/// Bits with another one of the same light within two pixels, where a point is looked up.
fn disputed(pixels: &[PixelVisibility]) -> u32 {
    let at = |x: u32, y: u32| pixels[(y * SIZE.0 + x) as usize].word;
    let around = |at: u32, end: u32| at.saturating_sub(2)..(at + 3).min(end);
    let of_pixel = |x: u32, y: u32| {
        let near = around(y, SIZE.1).flat_map(|ny| around(x, SIZE.0).map(move |nx| at(nx, ny) ^ at(x, y)));
        near.fold(0, |word, other| word | other).count_ones()
    };
    (0..SIZE.1).map(|y| (0..SIZE.0).map(|x| of_pixel(x, y)).sum::<u32>()).sum()
}

#[test]
fn late_masks_know_where_movers_and_their_shadows_have_gone() {
    let (gpu, camera) = (gpu(), camera(SIZE.0, SIZE.1));
    let (then_s, now_s) = (0.3, 0.45);
    for lights_move in [false, true] {
        let scene = living(lights_move);
        let mut moving = renderer(&gpu, &scene, Exposure::of_scene(&scene, &Occluders::default()));
        let then = draw(&gpu, &mut moving, (&camera, then_s), None).1;
        let depth_then = depth(&gpu, &moving);
        let truth = draw(&gpu, &mut moving, (&camera, now_s), None).1;
        let depth_now = depth(&gpu, &moving);
        let mask = as_mask(&then);
        let (coverage, more, traced_for) = (None, false, &camera);
        let then_at = SceneAt::from(then_s);
        let view = MaskView { mask: &mask, coverage, more, traced_for, scene: &then_at };
        let found = draw(&gpu, &mut moving, (&camera, now_s), Some(view)).1;
        let wrong = |pixels: &[PixelVisibility], stayed: bool| {
            let shown = depth_then.iter().zip(&depth_now).map(|(then, now)| then == now);
            let pixels = pixels.iter().zip(&truth).zip(shown).filter(|(_, same)| *same == stayed);
            pixels.map(|((one, other), _)| (one.word ^ other.word).count_ones()).sum::<u32>()
        };
        let known = found.iter().filter(|pixel| pixel.known).count();
        println!(
            "{lights_move}: of what stayed {} wrong of old bits, {} of predicted ones; else {}, {}; {known} known",
            wrong(&then, true),
            wrong(&found, true),
            wrong(&then, false),
            wrong(&found, false),
        );
        let old = wrong(&then, true) + wrong(&then, false);
        assert!(old > 100, "nothing moves: {old}");
        // A point that is seen in the same pixel has a sample of its own, which the maps of now and then confirm; or
        // the map decides, as for the truth.
        assert_eq!(wrong(&found, true), 0);
        // Others lie between samples, and are wrong only where these disagree.
        assert!(wrong(&found, false) <= disputed(&then), "{} of {}", wrong(&found, false), disputed(&then));
        // Most of the picture rests, and so do most shadows.
        assert!(known * 2 > found.len(), "{known} known");
    }
}

/// Three things of two triangles each are drawn, where light can see them: into maps of the picture's time, and into
/// those of the mask's. All that rests, and the maps of lights that nothing moves near, are left as they are.
#[test]
fn maps_of_another_time_cost_what_moves_alone() {
    let (gpu, camera, scene) = (gpu(), camera(SIZE.0, SIZE.1), living(false));
    let mut renderer = renderer(&gpu, &scene, Exposure::of_scene(&scene, &Occluders::default()));
    let mask = stripes();
    let (mut last, at) = (Work::default(), |frame: u8| 0.1 + 0.05 * f64::from(frame));
    for frame in 0..5_u8 {
        let time_s = at(frame);
        let then = SceneAt::from(time_s - 0.1);
        let view = MaskView { mask: &mask, coverage: None, more: false, traced_for: &camera, scene: &then };
        draw(&gpu, &mut renderer, (&camera, time_s), Some(view));
        let work = renderer.work() - last;
        println!("{work:?}");
        last = renderer.work();
        // The first maps have what rests; the second ones nothing to take out.
        if frame < 2 {
            continue;
        }
        // A sun has one view and a lamp six, of which a thing is seen in three at most, beside a corner.
        assert!((1..=2 * 2 * 3 * (1 + 3)).contains(&work.triangles), "{work:?}");
        assert!(work.draws * 2 <= work.triangles, "{work:?}");
        // A metre before a view of eight, or of four from the lamp: a 16th of either, and not in all views.
        assert!((1..=2 * 3 * 4096 * 4096 / 16).contains(&work.texels), "{work:?}");
    }
    // The same time takes nothing.
    draw(&gpu, &mut renderer, (&camera, at(4)), None);
    assert_eq!(renderer.work(), last);
}

/// Late masks from another place, frame by frame, in a scene at rest, and in one that moves.
#[test]
fn a_still_scene_pays_nothing_for_what_might_move() {
    let (gpu, camera, scene) = (gpu(), camera(SIZE.0, SIZE.1), living(false));
    let mask = stripes();
    // What all but the first frame take.
    let work = |scene: &Scene| {
        let mut renderer = renderer(&gpu, scene, Exposure::of_scene(scene, &Occluders::default()));
        let mut first = None;
        for frame in 0..4_u8 {
            let aside = DVec3::X * 0.01 * f64::from(frame + 1);
            let traced_for = Camera { position_m: camera.position_m + aside, ..camera };
            let time_s = 0.1 * f64::from(frame);
            let then = SceneAt::from(if renderer.moves() { time_s - 0.1 } else { 0.0 });
            let view = MaskView { mask: &mask, coverage: None, more: false, traced_for: &traced_for, scene: &then };
            draw(&gpu, &mut renderer, (&camera, time_s), Some(view));
            first.get_or_insert(renderer.work());
        }
        let first = first.unwrap_or_default();
        (first, renderer.work() - first)
    };
    let resting = still(&scene, 0.3);
    let (first, later) = work(&resting);
    // A sun has one view and a lamp six.
    let is_drawn = |draw: &&Draw| resting.materials[draw.material as usize].alpha != AlphaMode::Blend;
    let triangles = resting.draws.iter().filter(is_drawn).map(|draw| 7 * u64::from(draw.triangles)).sum();
    assert_eq!(first, Work { passes: 1, draws: first.draws, triangles, ..Work::default() });
    assert_eq!(later, Work::default());
    // The count counts.
    let (_, later) = work(&scene);
    let Work { passes, draws, triangles, texels, bytes } = later;
    assert!([passes, draws, triangles, texels, bytes].iter().all(|count| *count > 0), "{later:?}");
}

/// The newest mask is partial, and of the picture's own time, from another place. What an older one of another time
/// lacks, because shadows have changed since, it still has.
#[test]
fn an_older_mask_takes_nothing_from_one_of_the_pictures_own_time() {
    let (gpu, camera, scene) = (gpu(), camera(SIZE.0, SIZE.1), living(true));
    let (then_s, now_s) = (0.4, 0.7);
    let (then_at, now_at) = (SceneAt::from(then_s), SceneAt::from(now_s));
    let shape = MaskShape::new(SIZE.0, SIZE.1, 2).unwrap();
    let [across, down] = Coverage::places(shape);
    let left = (0..down).flat_map(|_| (0..across).map(|x| if x == 0 { 0b11 } else { 0 })).collect();
    let (mask, part) = (stripes(), Coverage::from_words(shape, left).unwrap());
    let aside = Camera { position_m: camera.position_m + DVec3::X * 0.05, ..camera };
    let newest = MaskView { mask: &mask, coverage: Some(&part), more: false, traced_for: &aside, scene: &now_at };
    let older = MaskView { coverage: None, scene: &then_at, ..newest };
    let found = |older: Option<MaskView<'_>>| {
        let mut renderer = renderer(&gpu, &scene, Exposure::of_scene(&scene, &Occluders::default()));
        assert_eq!(renderer.set_mask(older).unwrap(), older.is_some());
        draw(&gpu, &mut renderer, (&camera, now_s), Some(newest)).1
    };
    let (alone, above) = (found(None), found(Some(older)));
    let known = alone.iter().zip(&above).filter(|(alone, _)| alone.known);
    assert!(known.clone().filter(|(alone, _)| alone.word != 0).count() > 100);
    for (alone, above) in known {
        assert_eq!((alone.word, alone.known), (above.word, above.known));
    }
}
