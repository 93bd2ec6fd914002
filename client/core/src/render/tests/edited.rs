//! What people change is drawn as if the file had it, and late masks know it.

use std::sync::Arc;

use glam::{DQuat, DVec3};
use gnomon_scene::{AnimatedNode, Edit, Edits, LightEdit, NodeEdit, Scene, SceneAt};

use super::living::{SIZE, alike, as_mask, draw, living, node, renderer, still};
use crate::{
    occluders::Occluders,
    render::{
        PixelVisibility,
        exposure::Exposure,
        predict::MaskView,
        testing::{camera, gpu},
    },
};

fn at(time_s: f64, edits: &[Edit]) -> SceneAt {
    let mut all = Edits::default();
    edits.iter().for_each(|edit| all.apply(*edit).unwrap());
    SceneAt { time_s, edits: Arc::new(all) }
}

fn lamp(position_m: DVec3) -> Edit {
    Edit::Light(1, LightEdit { position_m: Some(position_m), ..LightEdit::default() })
}

/// A scene at rest, one that moves, and one whose lights move too, each with states in which it is edited.
fn edited() -> Vec<(Scene, Vec<SceneAt>)> {
    let sun = LightEdit { direction: Some(DVec3::new(0.6, -0.8, 0.0)), ..LightEdit::default() };
    let off = LightEdit { intensity: Some(0.0), ..LightEdit::default() };
    let carried = NodeEdit {
        translation_m: Some(DVec3::new(1000.3, 0.2, 0.1)),
        rotation: Some(DQuat::from_rotation_y(0.5)),
        ..NodeEdit::default()
    };
    let there = DVec3::new(1000.9, 2.2, 1.2);
    let lights = [at(0.4, &[lamp(there)]), at(0.4, &[Edit::Light(0, sun), Edit::Light(1, off)]), at(0.4, &[])];
    let nodes = [at(0.4, &[Edit::Node(0, carried), lamp(there)]), at(0.4, &[Edit::Node(0, carried)])];
    let all: Vec<SceneAt> = [&lights[..], &nodes].concat();
    vec![(still(&living(false), 0.4), lights.to_vec()), (living(false), all.clone()), (living(true), all)]
}

#[test]
fn an_edited_scene_is_drawn_as_the_still_one_that_stands_so() {
    let (gpu, camera) = (gpu(), camera(SIZE.0, SIZE.1));
    for (scene, states) in edited() {
        let exposure = Exposure::of_scene(&scene, &Occluders::default());
        let mut changing = renderer(&gpu, &scene, exposure);
        let mut pictures = Vec::new();
        for state in &states {
            let found = draw(&gpu, &mut changing, (&camera, state), None);
            let mut standing = renderer(&gpu, &still(&scene, state), exposure);
            assert!(alike(&found, &draw(&gpu, &mut standing, (&camera, 0.0), None)), "{state:?}");
            pictures.push(found.0);
        }
        assert!(pictures.windows(2).all(|pair| pair[0] != pair[1]), "nothing is edited");
    }
}

#[test]
fn late_masks_know_where_an_edited_lamp_has_gone() {
    let (gpu, camera) = (gpu(), camera(SIZE.0, SIZE.1));
    for (scene, _) in edited() {
        let mut changing = renderer(&gpu, &scene, Exposure::of_scene(&scene, &Occluders::default()));
        let [then_at, now_at] =
            [DVec3::new(1000.0, 2.0, 2.0), DVec3::new(1000.9, 2.2, 1.2)].map(|there| at(0.4, &[lamp(there)]));
        let then = draw(&gpu, &mut changing, (&camera, &then_at), None).1;
        let truth = draw(&gpu, &mut changing, (&camera, &now_at), None).1;
        // In a scene at rest no time is told apart.
        let seen = if changing.moves() { then_at } else { then_at.at_any_time() };
        let (mask, coverage, more) = (as_mask(&then), None, false);
        let view = MaskView { mask: &mask, coverage, more, traced_for: &camera, scene: &seen };
        let found = draw(&gpu, &mut changing, (&camera, &now_at), Some(view)).1;
        let wrong = |pixels: &[PixelVisibility]| {
            pixels.iter().zip(&truth).map(|(one, other)| (one.word ^ other.word).count_ones()).sum::<u32>()
        };
        assert!(wrong(&then) > 100, "the lamp's shadows stand still: {}", wrong(&then));
        assert!(wrong(&found) * 10 < wrong(&then), "{} of {}", wrong(&found), wrong(&then));
        let known = found.iter().filter(|pixel| pixel.known).count();
        assert!(known * 2 > found.len(), "{known} known");
    }
}

/// Only what may be edited is drawn into maps again.
#[test]
fn late_masks_know_where_a_thing_has_gone_that_rests_unless_it_is_edited() {
    let (gpu, camera, mut scene) = (gpu(), camera(SIZE.0, SIZE.1), living(false));
    let animation = scene.animation.as_mut().unwrap();
    animation.nodes.fill(AnimatedNode { editable: true, ..node() });
    animation.lights.clear();
    let mut changing = renderer(&gpu, &scene, Exposure::of_scene(&scene, &Occluders::default()));
    assert!(!changing.moves());
    let carried = |aside_m: f64| {
        let translation_m = Some(DVec3::new(1000.0 + aside_m, 0.2, 0.1));
        at(0.0, &[Edit::Node(0, NodeEdit { translation_m, ..NodeEdit::default() })])
    };
    let mut then_at = SceneAt::default();
    let mut then = draw(&gpu, &mut changing, (&camera, &then_at), None).1;
    for (edit, aside_m) in [0.3, 0.8].into_iter().enumerate() {
        let now_at = carried(aside_m);
        let truth = draw(&gpu, &mut changing, (&camera, &now_at), None).1;
        let (mask, coverage, more, before) = (as_mask(&then), None, false, changing.work());
        let view = MaskView { mask: &mask, coverage, more, traced_for: &camera, scene: &then_at };
        let found = draw(&gpu, &mut changing, (&camera, &now_at), Some(view)).1;
        let wrong = |pixels: &[PixelVisibility]| {
            pixels.iter().zip(&truth).map(|(one, other)| (one.word ^ other.word).count_ones()).sum::<u32>()
        };
        println!("{} wrong of old bits, {} of predicted ones", wrong(&then), wrong(&found));
        assert!(wrong(&then) > 100, "nothing is carried: {}", wrong(&then));
        assert!(wrong(&found) * 10 < wrong(&then), "{} of {}", wrong(&found), wrong(&then));
        let work = changing.work() - before;
        // Three things of two triangles, in the sun's view and the lamp's six, once what rests is kept.
        assert!(edit == 0 || work.triangles <= 3 * 2 * 7, "{work:?}");
        (then, then_at) = (truth, now_at);
    }
}
