//! Prints what a client's frame takes, stage by stage: `cargo run --release -p gnomon-client-core --features testing
//! --example frame_cost -- SCENE WIDTHxHEIGHT [EYE_X,Y,Z TARGET_X,Y,Z] [FRAMES [ANIMATION]]`. Without an eye, it looks
//! from where a client's camera stands first.
//!
//! Each half of a frame is waited for: drawing surfaces, then all the rest. Then whole frames by the adapter's clock.
//! The mask has the shadows of the client's own maps. It is of the same view, or of one 5 cm aside, so that it must be
//! predicted; without any, each light reaches everything. Medians of so many frames, 30 unless told. With an animation,
//! all that is measured twice: while the scene stands, and while it moves by a sixtieth of a second a frame; with what
//! was drawn into shadow maps. A table at the end compares both.

#![expect(clippy::disallowed_methods, reason = "a program of its own that measures")]

use std::{error::Error, path::Path, time::Instant};

use glam::DVec3;
use gnomon_client_core::{
    camera::{default_path::default_path, of_scene},
    occluders::Occluders,
    predictor::Predictor,
    render::{
        FrameRenderer, PICTURE_FORMAT, exposure::Exposure, predict::MaskView, quality::Quality,
        readback::PictureReader, stages, work::Work,
    },
};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{LoadOptions, Scene, SceneAt, camera::Camera};
use gnomon_shaders::gpu::{Gpu, GpuOptions};

fn point(text: &str) -> Result<DVec3, Box<dyn Error>> {
    let numbers: Vec<f64> = text.split(',').map(str::parse).collect::<Result<_, _>>()?;
    let [x, y, z] = numbers[..] else { return Err(format!("{text} is no point").into()) };
    Ok(DVec3::new(x, y, z))
}

struct Frames {
    gpu: Gpu,
    renderer: FrameRenderer,
    reader: PictureReader,
    camera: Camera,
    count: usize,
    /// Time of the scene, and from frame to frame, in seconds.
    time_s: f64,
    step_s: f64,
}

/// How many frames late a mask is that must be predicted.
const LAG: f64 = 6.0;

impl Frames {
    /// The visibility that the client finds by itself.
    fn mask(&mut self, camera: &Camera, shape: MaskShape) -> Result<Mask, Box<dyn Error>> {
        self.renderer.draw_surfaces(camera)?;
        self.renderer.set_mask(None)?;
        self.renderer.shade(camera, 1.0, &self.reader.target(), |_| ())?;
        let mut mask = Mask::new(shape);
        for (place, pixel) in (0..).zip(self.renderer.read_visibility()?) {
            let (x, y) = (place % shape.width(), place / shape.width());
            (0..shape.lights()).for_each(|k| mask.set(k, x, y, pixel.word >> k & 1 == 1));
        }
        Ok(mask)
    }

    /// Draws one frame. Returns the times of both halves in ms, each waited for.
    fn draw(&mut self, mask: Option<(&Mask, &Camera)>, waits: bool) -> Result<[f64; 2], Box<dyn Error>> {
        let mut begun = Instant::now();
        let mut lap = |gpu: &Gpu| -> Result<f64, Box<dyn Error>> {
            if waits {
                gpu.device.poll(wgpu::PollType::wait_indefinitely())?;
            }
            let ms = begun.elapsed().as_secs_f64() * 1e3;
            begun = Instant::now();
            Ok(ms)
        };
        self.time_s += self.step_s;
        self.renderer.set_time(self.time_s);
        self.renderer.draw_surfaces(&self.camera)?;
        let surfaces = lap(&self.gpu)?;
        let late = mask.is_some_and(|(_, traced_for)| *traced_for != self.camera);
        let late_s = if late { LAG * self.step_s } else { 0.0 };
        let scene = SceneAt::from(if self.renderer.moves() { self.time_s - late_s } else { 0.0 });
        let view =
            mask.map(|(mask, traced_for)| MaskView { mask, coverage: None, more: false, traced_for, scene: &scene });
        self.renderer.set_mask(view)?;
        self.renderer.shade(&self.camera, 1.0, &self.reader.target(), |_| ())?;
        Ok([surfaces, lap(&self.gpu)?])
    }

    /// Prints what frames take, and returns it in ms: both halves, waited for, and all stages by the adapter's clock.
    fn measure(&mut self, what: &str, mask: Option<(&Mask, &Camera)>) -> Result<[f64; 2], Box<dyn Error>> {
        let mut halves = [Vec::new(), Vec::new()];
        let mut stages: Vec<(&str, Vec<f64>)> = Vec::new();
        // The first ones compile and upload.
        for frame in 0..self.count + 3 {
            let times = self.draw(mask, true)?;
            self.renderer.stage_times()?;
            if frame >= 3 {
                halves.iter_mut().zip(times).for_each(|(all, ms)| all.push(ms));
            }
        }
        let before = self.renderer.work();
        for _ in 0..self.count {
            self.draw(mask, false)?;
            for (place, (name, ms)) in self.renderer.stage_times()?.into_iter().enumerate() {
                if stages.len() <= place {
                    stages.push((name, Vec::new()));
                }
                stages[place].1.push(ms);
            }
        }
        let [surfaces, rest] = halves.map(median);
        print!("{what}: {surfaces:.2} + {rest:.2} ms;");
        let stages: Vec<_> = stages.into_iter().map(|(name, times)| (name, median(times))).collect();
        stages.iter().for_each(|(name, ms)| print!(" {name} {ms:.2}"));
        let sum = stages.iter().map(|(_, ms)| ms).sum::<f64>();
        println!(", sum {sum:.2}");
        let work = self.renderer.work() - before;
        if work != Work::default() {
            let frames = self.count.max(1) as u64;
            let Work { passes, draws, triangles, texels, bytes } = work;
            let [passes, draws, triangles, texels, bytes] =
                [passes, draws, triangles, texels, bytes].map(|count| count / frames);
            println!(
                "  a frame: {passes} passes, {draws} draws and {triangles} triangles into shadow maps, {texels} texels \
                 erased, {bytes} bytes written"
            );
        }
        Ok([surfaces + rest, sum])
    }
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_unstable_by(f64::total_cmp);
    times.get(times.len() / 2).copied().unwrap_or(f64::NAN)
}

fn main() -> Result<(), Box<dyn Error>> {
    let begun = Instant::now();
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let usage = "SCENE WIDTHxHEIGHT [EYE TARGET] [FRAMES [ANIMATION]]";
    let (scene, size, place, more) = match &arguments[..] {
        [scene, size, eye, target, more @ ..] if eye.contains(',') => (scene, size, Some((eye, target)), more),
        [scene, size, more @ ..] => (scene, size, None, more),
        _ => return Err(usage.into()),
    };
    let (count, animation) = match more {
        [] => (30, None),
        [count] => (count.parse()?, None),
        [count, animation] => (count.parse()?, Some(animation)),
        _ => return Err(usage.into()),
    };
    let (width, height) = size.split_once('x').ok_or("no size")?;
    let (width, height) = (width.parse()?, height.parse()?);
    let scene =
        Scene::load(Path::new(scene), &LoadOptions { animation: animation.cloned(), ..LoadOptions::default() })?;
    let occluders = Occluders::largest_of(&scene);
    let camera = match place {
        Some((eye, target)) => Camera::looking_at(point(eye)?, point(target)?, 1.0, width, height),
        None => {
            let path = of_scene::path_of(&scene, None).unwrap_or_else(|_| default_path(&scene, &occluders));
            path.camera(0.0, width, height)
        }
    };
    let options = GpuOptions { allow_software: true, wanted: stages::NEEDED, ..GpuOptions::default() };
    let gpu = pollster::block_on(Gpu::open(&options))?;
    let exposure = Exposure::of_scene(&scene, &occluders);
    let renderer = FrameRenderer::new(&gpu, &scene, (width, height), exposure, PICTURE_FORMAT, Predictor::Surface)?;
    let shape = MaskShape::new(width, height, u32::try_from(scene.lights.len())?)?;
    let aside = Camera { position_m: camera.position_m + camera.orientation * DVec3::X * 0.05, ..camera };
    let reader = PictureReader::new(&gpu, width, height, 1);
    let mut frames = Frames { gpu, renderer, reader, camera, count, time_s: 0.0, step_s: 0.0 };
    frames.draw(None, true)?;
    println!("first picture: {:.2} s", begun.elapsed().as_secs_f64());
    let (mask, other_mask) = (frames.mask(&camera, shape)?, frames.mask(&aside, shape)?);
    frames.renderer.time_stages();
    let steps = if frames.renderer.moves() { vec![(0.0, ""), (1.0 / 60.0, "moving, ")] } else { vec![(0.0, "")] };
    let mut compared = Vec::new();
    for quality in Quality::ALL {
        let mut found = Vec::new();
        for (step_s, moving) in &steps {
            frames.step_s = *step_s;
            frames.renderer.set_quality(quality);
            let own = frames.measure(&format!("{moving}{quality}, own view"), Some((&mask, &camera)))?;
            let predicted = frames.measure(&format!("{moving}{quality}, predicted"), Some((&other_mask, &aside)))?;
            frames.renderer.set_predictor(Predictor::None);
            let without = frames.measure(&format!("{moving}{quality}, no mask"), None)?;
            frames.renderer.set_predictor(Predictor::Surface);
            found.push([own, predicted, without]);
        }
        if let [standing, moving] = found[..] {
            let whats = ["own view", "predicted", "no mask"].map(|what| format!("{quality}, {what}"));
            compared.extend(whats.into_iter().zip(standing.into_iter().zip(moving)));
        }
    }
    for (what, ([stands, stands_gpu], [moves, moves_gpu])) in compared {
        let more = |moves: f64, stands: f64| (moves / stands - 1.0) * 100.0;
        println!(
            "standing → moving, {what}: frame {stands:.2} → {moves:.2} ms ({:+.0} %), adapter {stands_gpu:.2} → \
             {moves_gpu:.2} ms ({:+.0} %)",
            more(moves, stands),
            more(moves_gpu, stands_gpu)
        );
    }
    Ok(())
}
