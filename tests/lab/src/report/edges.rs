//! `lab edges`: shadow edges that the client draws against the referee's share of each pixel.
//!
//! The client gets the referee's bits at the pixels' centres. One light at a time is drawn with them, with none and
//! with all: where its picture lies between the other two is the share that it was drawn with. The truth is the share
//! of samples spread over the pixel that the light reaches. Judged are pixels in which the light reaches some samples
//! and not others, and around which there is one surface only; edges of surfaces are another matter.

use anyhow::Result;
use glam::DVec3;
use gnomon_client::{
    predictor::Predictor,
    render::{quality::Quality, tone::ToneCurve},
};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::camera::Camera;

use super::{predict_rig::PredictRig, scene_args::SceneArgs, table::Table};
use crate::reference::{Point, Truth};

#[derive(Debug, Clone, clap::Args)]
pub struct EdgesOptions {
    /// Scene, path, size, and how many places of the path are judged.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Samples a pixel, in each direction.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(2..=16))]
    pub samples: u32,
    /// Allow a software adapter.
    #[arg(long)]
    pub allow_software: bool,
}

/// Squared errors of shares, of one light or all.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct EdgeError {
    pub pixels: u32,
    /// With a bit for each pixel.
    pub of_bits: f64,
    /// As drawn.
    pub of_shares: f64,
}

impl EdgeError {
    /// Returns how much smaller the error is than with bits, in dB.
    #[must_use]
    pub fn gain_db(&self) -> f64 {
        10.0 * (self.of_bits / self.of_shares).log10()
    }

    fn row(&self, light: String) -> Vec<String> {
        let rms = |sum: f64| format!("{:.4}", (sum / f64::from(self.pixels.max(1))).sqrt());
        let gain = format!("{:.2}", self.gain_db());
        vec![light, self.pixels.to_string(), rms(self.of_bits), rms(self.of_shares), gain]
    }
}

/// Measures each light and all together, which is last. Writes `edges.csv`.
///
/// # Errors
/// If the scene does not load, the adapter fails or a file cannot be written.
pub fn measure(options: &EdgesOptions, mut progress: impl FnMut(&str)) -> Result<(Vec<EdgeError>, Table)> {
    let scene = &options.scene;
    let path = scene.load_path()?;
    let loaded = scene.load_scene()?;
    let lights = loaded.lights.len();
    let mut rig = PredictRig::new(&loaded, scene.size, options.allow_software)?;
    let renderer = rig.renderer();
    renderer.set_quality(Quality::High);
    // Light is read back from pictures.
    renderer.set_tone(ToneCurve::None);
    let mut errors = vec![EdgeError::default(); lights + 1];
    for frame in 0..scene.frames {
        let time_s = path.duration_s() * f64::from(frame) / f64::from(scene.frames);
        let camera = path.camera(time_s, scene.size.0, scene.size.1);
        judge(&mut rig, &camera, options.samples, &mut errors)?;
        progress(&format!("place {} of {} at {time_s:.3} s", frame + 1, scene.frames));
    }
    let mut table = Table::new("light | pixels | rms_of_bits | rms_of_shares | gain_db");
    for (k, error) in errors.iter().enumerate() {
        table.rows.push(error.row(if k < lights { k.to_string() } else { "all".to_owned() }));
    }
    scene.write("edges.csv", &table.csv())?;
    Ok((errors, table))
}

/// Adds what one view shows.
fn judge(rig: &mut PredictRig, camera: &Camera, samples: u32, errors: &mut [EdgeError]) -> Result<()> {
    let (width, height) = (camera.width, camera.height);
    let fine = Camera { width: width * samples, height: height * samples, ..*camera };
    let (centres, truth) = (rig.truth(camera), rig.truth(&fine));
    let one_surface = one_surface(&rig.points(&fine), &fine, samples);
    let mask = mask_of(&centres)?;
    let mut full = Mask::new(mask.shape());
    full.words_mut().fill(u64::MAX);
    let empty = Mask::new(mask.shape());
    let Some((total, of_lights)) = errors.split_last_mut() else { return Ok(()) };
    for (k, error) in (0_u32..).zip(of_lights) {
        rig.renderer().set_lights_on(1 << k);
        let mut light = |mask: &Mask| -> Result<Vec<f64>> {
            let picture = rig.draw(camera, Predictor::Surface, Some((mask, camera)))?.0;
            Ok(picture.pixels().map(|pixel| linear(pixel.0[1])).collect())
        };
        let (drawn, dark, lit) = (light(&mask)?, light(&empty)?, light(&full)?);
        for pixel in 0..width * height {
            let (x, y, place) = (pixel % width, pixel / width, pixel as usize);
            let Some(share) = share_of(&truth, (x, y), samples, k) else { continue };
            let is_edge = share > 0.0 && share < 1.0;
            if !is_edge || !one_surface[place] || lit[place] - dark[place] < LEAST || lit[place] > MOST {
                continue;
            }
            let bit = f64::from(centres.at(x, y).lit >> k & 1);
            let drawn = (drawn[place] - dark[place]) / (lit[place] - dark[place]);
            for error in [&mut *error, &mut *total] {
                error.pixels += 1;
                error.of_bits += (bit - share).powi(2);
                error.of_shares += (drawn - share).powi(2);
            }
        }
    }
    Ok(())
}

/// Bytes resolve differences of light from here on; and what is not cut off.
const LEAST: f64 = 0.05;
const MOST: f64 = 0.95;

/// Returns linear light from an sRGB byte.
fn linear(byte: u8) -> f64 {
    let value = f64::from(byte) / 255.0;
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

fn mask_of(truth: &Truth) -> Result<Mask> {
    let mut mask = Mask::new(MaskShape::new(truth.width, truth.height, truth.lights)?);
    for (x, y) in (0..truth.height).flat_map(|y| (0..truth.width).map(move |x| (x, y))) {
        (0..truth.lights).for_each(|k| mask.set(k, x, y, truth.at(x, y).lit >> k & 1 == 1));
    }
    Ok(mask)
}

/// Returns the share of a pixel's samples that light k reaches; `None` if it could not reach some.
fn share_of(truth: &Truth, (x, y): (u32, u32), samples: u32, k: u32) -> Option<f64> {
    let mut lit = 0;
    for sample in 0..samples * samples {
        let verdict = truth.at(x * samples + sample % samples, y * samples + sample / samples);
        if verdict.relevant >> k & 1 == 0 {
            return None;
        }
        lit += verdict.lit >> k & 1;
    }
    Some(f64::from(lit) / f64::from(samples * samples))
}

/// Returns for each pixel whether all samples of it and of the pixels around it lie in one plane, as far as the client
/// can tell (`same_surface.wgsl`).
fn one_surface(points: &[Option<Point>], fine: &Camera, samples: u32) -> Vec<bool> {
    let (width, height) = (fine.width / samples, fine.height / samples);
    let pixel_m = 2.0 * fine.half_extent().1 / f64::from(height);
    let at = |x: u32, y: u32| points[(y * fine.width + x) as usize];
    let judge = |pixel: u32| {
        let (x, y) = (pixel % width, pixel / width);
        if x == 0 || y == 0 || x + 1 == width || y + 1 == height {
            return false;
        }
        let Some(own) = at(x * samples + samples / 2, y * samples + samples / 2) else { return false };
        let (columns, rows) = ((x - 1) * samples..(x + 2) * samples, (y - 1) * samples..(y + 2) * samples);
        rows.flat_map(|y| columns.clone().map(move |x| (x, y))).all(|(x, y)| {
            let away: Option<DVec3> = at(x, y).map(|other| other.place - own.place);
            away.is_some_and(|away| away.dot(own.normal).abs() <= 0.2 * pixel_m * own.depth_m)
        })
    };
    (0..width * height).map(judge).collect()
}
