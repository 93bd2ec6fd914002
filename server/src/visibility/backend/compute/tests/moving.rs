//! Scenes that move, compared with the scene that stands still at the time.

use std::time::Duration;

use gnomon_scene::Animation;

use super::*;
use crate::visibility::{
    backend::compute::{
        PartialSubmission, Posers, SLOTS,
        kernels::{KernelOptions, Traversal},
    },
    test_scenes::living_room,
};

/// At keys, between them, with half a box hidden and with the leaf inside out, and after many rounds.
const TIMES_S: [f64; 6] = [0.0, 0.3, 0.7, 1.0, 1.4, 1234.9];

/// The camera along an axis looks exactly along edges of the room. A ray that meets two walls at one distance sees the
/// one that comes first in the hierarchy: so does the still scene's, which has another.
fn slanted() -> Vec<Camera> {
    let mut cameras = cameras();
    cameras.truncate(3);
    cameras
}

fn at(compute: &mut ComputeBackend, scene: &Scene, camera: &Camera, time_s: f64) -> Mask {
    let mut mask = mask_for(scene, camera);
    mask.words_mut().fill(0xdead_beef_dead_beef);
    compute.trace_at(camera, time_s, &mut mask).unwrap();
    mask
}

/// Everything of the living room but its walls and what they are drawn with; and all of it.
fn living() -> Vec<(&'static str, Scene)> {
    let scene = living_room();
    let mut afloat = scene.clone();
    afloat.triangles.retain(|corners| scene.animation.as_ref().unwrap().piece_of(corners[0]).is_some());
    afloat.draws.retain(|draw| draw.material != SINGLE_SIDED);
    let mut first_triangle = 0;
    for draw in &mut afloat.draws {
        draw.first_triangle = first_triangle;
        first_triangle += draw.triangles;
    }
    let mut lamp = scene.clone();
    let Animation { nodes, lights, .. } = *scene.animation.clone().unwrap();
    lamp.animation = Some(Box::new(Animation { nodes, lights, ..Animation::default() }));
    vec![("a room in which things move", scene), ("only what moves", afloat), ("only a lamp moves", lamp)]
}

#[test]
fn a_moving_scene_has_the_mask_of_the_scene_that_stands_still_then() {
    for (name, scene) in living() {
        let cpu = CpuBackend::new(&scene, None).unwrap();
        for (lists, posers) in
            [(Lists::Never, Posers::Host), (Lists::Always, Posers::Device), (Lists::Never, Posers::Device)]
        {
            let options = KernelOptions { lists, posers, ..KernelOptions::new(Traversal::Hierarchy) };
            let open = |scene: &Scene| ComputeBackend::open_with(scene, None, true, options).unwrap();
            let (mut moving, mut masks) = (open(&scene), Vec::new());
            for time_s in TIMES_S {
                let still = scene.still_at(time_s);
                let (mut standing, standing_cpu) = (open(&still), CpuBackend::new(&still, None).unwrap());
                for camera in slanted() {
                    let mask = at(&mut moving, &scene, &camera, time_s);
                    let expected = at(&mut standing, &still, &camera, 0.0);
                    let how = format!("{name} at {time_s} s, {lists:?}, {posers:?}, {camera:?}");
                    assert_eq!(differing(&mask, &expected), 0, "{how}");
                    // So back ends agree as they do on scenes that stand still.
                    let [mut on_cpu, mut expected] = [(); 2].map(|()| mask_for(&scene, &camera));
                    cpu.trace_at(&camera, time_s, &mut on_cpu);
                    standing_cpu.trace(&camera, &mut expected);
                    assert_eq!(differing(&on_cpu, &expected), 0, "{name} at {time_s} s on cpu, {camera:?}");
                    masks.push(mask);
                }
            }
            assert!(masks.iter().map(ones).sum::<u32>() > 10_000, "{name} is dark");
            let first = masks.iter().step_by(slanted().len());
            assert!(first.clone().zip(first.skip(1)).all(|(one, next)| one != next), "{name} stands still");
        }
    }
}

#[test]
fn frames_of_different_times_are_under_way_at_once() {
    let scene = living_room();
    let always =
        KernelOptions { lists: Lists::Always, posers: Posers::Device, ..KernelOptions::new(Traversal::Hierarchy) };
    let mut compute = ComputeBackend::open_with(&scene, None, true, always).unwrap();
    let (mut alone, views) = (backend(&scene), cameras());
    let shape = |camera: &Camera| mask_for(&scene, camera).shape();
    compute.fit(views.iter().map(shape)).unwrap();
    // Later rounds find regions that hold other times, or their own.
    for round in 0..3_u8 {
        let jobs: Vec<(Camera, f64)> =
            (0..SLOTS).map(|job| (views[job % views.len()], f64::from(round / 2) + job as f64 * 0.23)).collect();
        let begin = |(camera, time_s): &(Camera, f64)| compute.begin(camera, *time_s, shape(camera)).unwrap();
        let mut parts: Vec<Option<PartialSubmission>> = jobs.iter().map(begin).map(Some).collect();
        assert!(compute.begin(&views[0], 0.0, shape(&views[0])).is_err(), "no slot is left");
        let mut order = Vec::new();
        while order.len() < SLOTS {
            for (job, part) in parts.iter_mut().enumerate() {
                let Some(frame) = part.take() else { continue };
                *part = compute.submit_part(frame, 3 + u32::try_from(job % 2).unwrap()).unwrap();
                if part.is_none() {
                    order.push(job);
                }
            }
        }
        for job in order {
            let (camera, time_s) = jobs[job];
            let mut mask = mask_for(&scene, &camera);
            while compute.collect(Duration::from_secs(1), &mut mask).unwrap().is_none() {}
            assert_eq!(mask, at(&mut alone, &scene, &camera, time_s), "{time_s} s in round {round}");
        }
    }
}

#[test]
fn a_frame_that_is_given_up_leaves_nothing_behind() {
    let scene = living_room();
    let mut compute = backend(&scene);
    let camera = cameras()[0];
    let expected = at(&mut backend(&scene), &scene, &camera, 0.7);
    compute.fit([expected.shape()]).unwrap();
    for time_s in [0.7, 1.4, 0.7] {
        drop(compute.begin(&camera, time_s, expected.shape()).unwrap());
    }
    assert_eq!(at(&mut compute, &scene, &camera, 0.7), expected);
    // Buffers for masks that are made anew do not change where things are.
    compute.fit([MaskShape::new(64, 64, 5).unwrap()]).unwrap();
    assert_eq!(at(&mut compute, &scene, &camera, 0.7), expected);
}

#[test]
fn only_scenes_that_move_have_regions_of_geometry() {
    // Where everything rests a region has the lights alone, for when they are edited.
    let resting = room();
    assert_eq!(backend(&resting).memory().moving_bytes, SLOTS as u64 * 48 * resting.lights.len() as u64);
    let scene = living_room();
    let open = |posers| ComputeBackend::open_with_posers(&scene, None, true, posers).unwrap();
    let memory = open(Posers::Host).memory();
    let animation = scene.animation.as_ref().unwrap();
    let moves = |corners: &&[u32; 3]| animation.piece_of(corners[0]).is_some();
    let triangles = scene.tracing_triangles().iter().filter(moves).count() as u64;
    let lights = scene.lights.len() as u64;
    // A triangle and its normals take 48 bytes each, as does a light. Nodes are few.
    let least = SLOTS as u64 * (96 * triangles + 48 * lights);
    assert!((least..2 * least).contains(&memory.moving_bytes), "{memory:?}, at least {least}");
    assert!(open(Posers::Device).memory().moving_bytes > memory.moving_bytes, "what moves them counts, too");
}
