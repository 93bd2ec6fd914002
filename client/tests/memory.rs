//! Drawing takes no memory that it does not give back. A program of its own: what a process holds is the process's.

#![cfg(target_os = "linux")]
#![expect(clippy::unwrap_used, reason = "clippy knows tests by their functions")]

use gnomon_client_core::{
    predictor::Predictor,
    render::{
        FrameRenderer,
        debug_view::DebugView,
        testing::{self, floor_and_lights},
    },
};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{AlphaMode, Draw, Scene, camera::Camera};
use gnomon_shaders::gpu::Gpu;

const SIZE: (u32, u32) = (96, 54);

/// Frames that are measured. Mesa 22.3 kept 4 MB or more of each while shaders read uniform buffers.
const FRAMES: u32 = 200;

/// A frame keeps nothing. Allocators and drivers keep pools, and the process's pages are counted in full: at most as
/// much as the textures of this renderer, of which its shadow map alone takes 64 MiB.
const MOST_KEPT: u64 = 200 << 20;

/// Bytes of this process in memory.
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.trim().strip_suffix(" kB").unwrap().parse::<u64>().unwrap() << 10
}

/// Surfaces of all three kinds: an opaque floor, and a wall that is drawn both as MASK and as BLEND.
fn scene() -> Scene {
    let mut scene = floor_and_lights();
    scene.materials.push(scene.materials[1].clone());
    scene.materials[1].alpha = AlphaMode::Mask { cutoff: 0.5 };
    scene.materials[2].alpha = AlphaMode::Blend;
    scene.draws.push(Draw { material: 2, ..scene.draws[1] });
    scene
}

/// Draws views that turn, each with the mask of a view that was never drawn, so that every pass runs in every frame.
fn draw(gpu: &Gpu, renderer: &mut FrameRenderer, frames: std::ops::Range<u32>) {
    let views = [DebugView::Picture, DebugView::Picture, DebugView::Light(1), DebugView::Depth];
    let mut mask = Mask::new(MaskShape::new(SIZE.0, SIZE.1, 2).unwrap());
    mask.words_mut().fill(0x00ff_00ff_f0f0_f0f0);
    for frame in frames {
        let turned = |frame: u32| {
            let turn = glam::DQuat::from_rotation_y(f64::from(frame % 100) * 0.002);
            let camera = testing::camera(SIZE.0, SIZE.1);
            Camera { orientation: turn * camera.orientation, ..camera }
        };
        renderer.set_debug_view(views[frame as usize % views.len()]);
        let picture = testing::draw_with(gpu, renderer, &turned(frame), Some((&mask, &turned(frame + 1))));
        assert!(picture.rgba.iter().any(|byte| *byte != picture.rgba[0]), "frame {frame} is of one colour");
    }
}

#[test]
fn hundreds_of_frames_leave_no_memory_behind() {
    let gpu = testing::gpu();
    let mut renderer = testing::renderer(&gpu, &scene(), MaskShape::new(SIZE.0, SIZE.1, 2).unwrap());
    renderer.set_predictor(Predictor::Surface);
    draw(&gpu, &mut renderer, 0..20);
    let before = resident();
    draw(&gpu, &mut renderer, 20..20 + FRAMES);
    let kept = resident().saturating_sub(before);
    println!("{FRAMES} frames on {} kept {} KiB", gpu.info.name, kept >> 10);
    assert!(kept < MOST_KEPT, "{FRAMES} frames on {} kept {} MiB", gpu.info.name, kept >> 20);
}
