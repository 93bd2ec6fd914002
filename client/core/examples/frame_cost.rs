//! Prints what a client's frame takes: `cargo run --release -p gnomon-client-core --features testing --example
//! frame_cost
//! -- SCENE WIDTHxHEIGHT EYE_X,Y,Z TARGET_X,Y,Z`.
//!
//! Each half is waited for: drawing surfaces, then all the rest with a whole mask of the same view. Medians
//! of 30 frames.

#![expect(clippy::disallowed_methods, reason = "a program of its own that measures")]

use std::{error::Error, path::Path, time::Instant};

use glam::DVec3;
use gnomon_client_core::{
    occluders::Occluders,
    predictor::Predictor,
    render::{FrameRenderer, PICTURE_FORMAT, exposure::Exposure, predict::MaskView, readback::PictureReader},
};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{LoadOptions, Scene, camera::Camera};
use gnomon_shaders::gpu::{Gpu, GpuOptions};

const FRAMES: usize = 30;

fn point(text: &str) -> Result<DVec3, Box<dyn Error>> {
    let numbers: Vec<f64> = text.split(',').map(str::parse).collect::<Result<_, _>>()?;
    let [x, y, z] = numbers[..] else { return Err(format!("{text} is no point").into()) };
    Ok(DVec3::new(x, y, z))
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, size, eye, target] = &arguments[..] else { return Err("SCENE WIDTHxHEIGHT EYE TARGET".into()) };
    let (width, height) = size.split_once('x').ok_or("no size")?;
    let (width, height) = (width.parse()?, height.parse()?);
    let scene = Scene::load(Path::new(scene), &LoadOptions::default())?;
    let camera = Camera::looking_at(point(eye)?, point(target)?, 1.0, width, height);
    let gpu = pollster::block_on(Gpu::open(&GpuOptions { allow_software: true, ..GpuOptions::default() }))?;
    let exposure = Exposure::of_scene(&scene, &Occluders::largest_of(&scene));
    let mut renderer = FrameRenderer::new(&gpu, &scene, (width, height), exposure, PICTURE_FORMAT, Predictor::Surface)?;
    let mut mask = Mask::new(MaskShape::new(width, height, u32::try_from(scene.lights.len())?)?);
    mask.words_mut().fill(u64::MAX);
    let reader = PictureReader::new(&gpu, width, height, 1);
    let mut times = [Vec::new(), Vec::new()];
    for _ in 0..FRAMES + 3 {
        let begun = Instant::now();
        renderer.draw_surfaces(&camera)?;
        gpu.device.poll(wgpu::PollType::wait_indefinitely())?;
        times[0].push(begun.elapsed());
        let begun = Instant::now();
        renderer.set_mask(Some(MaskView { mask: &mask, coverage: None, more: false, traced_for: &camera }))?;
        renderer.shade(&camera, 1.0, &reader.target(), |_| ())?;
        gpu.device.poll(wgpu::PollType::wait_indefinitely())?;
        times[1].push(begun.elapsed());
    }
    for (what, times) in ["surfaces", "rest"].into_iter().zip(&mut times) {
        // The first ones compile and upload.
        times.drain(..3);
        times.sort_unstable();
        println!("{what}: {:.2} ms", times[FRAMES / 2].as_secs_f64() * 1e3);
    }
    Ok(())
}
