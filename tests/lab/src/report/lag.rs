//! `lab lag`: error of predicted visibility against its lag (the dissertation's Figures 13 and 16 to 19).
//!
//! For each measured frame, spread evenly over the path, the referee judges the frame, the cpu back end traces the mask
//! of the frame `lag` earlier, and the client's renderer predicts one from the other. Without a network or clock, a
//! second run gives the same figures.

mod outcome;
mod plots;

use anyhow::{Context, Result, bail};
use gnomon_client::{Viewpoint, camera_path::CameraPath, guard::GuardSize, predictor::Predictor};
use gnomon_protocol::mask::Mask;
use gnomon_scene::{AlphaMode, Scene, camera::Camera, motion::Motion};

pub use self::outcome::PosePrediction;
use self::outcome::{Outcome, Setting};
use super::{
    predict_rig::PredictRig, prediction_error::wrong_bits, scene_args::SceneArgs, statistics::mean, table::Table,
};
use crate::metrics::{
    image::{ImageError, compare},
    vmaf::vmaf,
};

/// Earlier poses that the server's extrapolation has seen.
const POSES_BEFORE: u32 = 12;

#[derive(Debug, Clone, clap::Args)]
pub struct LagOptions {
    /// Scene, path, size, and how many frames of the path are measured.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Lags, in frames.
    #[arg(long, value_delimiter = ',', default_value = "0,1,2,3,6,10,20,50")]
    pub lags: Vec<u32>,
    /// Predictors: none, dissertation, dissertation-shadow, dissertation-copy, surface.
    #[arg(long, value_delimiter = ',', default_value = "none,dissertation,surface")]
    pub predict: Vec<Predictor>,
    /// Guard bands: WxH extra pixels in total, half on each side.
    #[arg(long, value_delimiter = ',', default_value = "0x0")]
    pub guard: Vec<GuardSize>,
    /// Which pose the server traces for: the newest, or one extrapolated to the frame that shows it.
    #[arg(long, value_delimiter = ',', default_value = "off")]
    pub predict_pose: Vec<PosePrediction>,
    /// Frames a second of the client.
    #[arg(long, default_value_t = 60.0)]
    pub fps: f64,
    /// Turn on the spot at the path's beginning instead of following it, in degrees a second.
    #[arg(long)]
    pub turn: Option<f64>,
    /// Treat MASK surfaces as OPAQUE.
    #[arg(long)]
    pub ignore_alpha: bool,
    /// Allow a software adapter.
    #[arg(long)]
    pub allow_software: bool,
    /// Skip the comparison of pictures, which takes most of the time.
    #[arg(long)]
    pub bits_only: bool,
    /// Write a picture of the wrong bits of each frame and setting.
    #[arg(long)]
    pub pictures: bool,
}

/// Measures, writes `lag.csv` and its plots, and reports each setting to `progress`.
pub fn measure(options: &LagOptions, mut progress: impl FnMut(&str)) -> Result<Table> {
    let mut rig = Rig::new(options)?;
    let settings: Vec<Setting> = settings(options);
    if settings.is_empty() {
        bail!("nothing to measure: --lags, --predict, --guard and --predict-pose each need a value");
    }
    let mut outcomes: Vec<Outcome> = settings.iter().map(|_| Outcome::default()).collect();
    let mut truths = Vec::new();
    for frame in 0..options.scene.frames {
        let time_s = rig.time_s(frame);
        let camera = rig.camera(time_s);
        rig.predict.set_time(time_s);
        let truth = rig.predict.truth(&camera);
        let near = rig.predict.near_movers(&camera, &truth);
        let true_picture = if options.bits_only { None } else { Some(rig.predict.true_picture(&camera)?) };
        let mut traced: Option<(Viewpoint, Mask)> = None;
        for (setting, outcome) in settings.iter().zip(&mut outcomes) {
            let traced_for = rig.traced_for(setting, time_s);
            // Settings that differ only in the predictor share a mask.
            rig.predict.set_mask_time(traced_for.scene.time_s);
            let mask = match traced.take().filter(|(seen, _)| *seen == traced_for) {
                Some((_, mask)) => mask,
                None => rig.predict.trace(&traced_for.camera)?,
            };
            let view = Some((&mask, &traced_for.camera));
            let (picture, visibility) = rig.predict.draw(&camera, setting.predictor, view)?;
            outcome.bits.add(&visibility, &truth, near.as_deref());
            if options.pictures {
                let name = format!("wrong-{frame}-{}-{}-{}.png", setting.lag, setting.predictor, setting.guard);
                let file = options.scene.result(&name)?;
                wrong_bits(&visibility, &truth).save(&file).with_context(|| format!("writing {}", file.display()))?;
            }
            outcome.known_share.push(rig.predict.known_share().unwrap_or(f64::NAN));
            if let Some(true_picture) = &true_picture {
                outcome.images.push(compare(&picture, true_picture));
                outcome.shown.push(picture);
            }
            traced = Some((traced_for, mask));
        }
        progress(&format!("frame {} of {} at {time_s:.3} s", frame + 1, options.scene.frames));
        truths.extend(true_picture);
    }
    if !options.bits_only {
        for outcome in &mut outcomes {
            outcome.vmaf = vmaf(&outcome.shown, &truths, options.fps)?;
        }
    }
    let table = table(options, &settings, &outcomes);
    options.scene.write("lag.csv", &table.csv())?;
    if !options.bits_only {
        plots::draw(&options.scene, &settings, &outcomes, &truths)?;
    }
    Ok(table)
}

/// Every combination, the predictor varying fastest: predictors share masks.
fn settings(options: &LagOptions) -> Vec<Setting> {
    let mut settings = Vec::new();
    for &lag in &options.lags {
        for &guard in &options.guard {
            for &predict_pose in &options.predict_pose {
                for &predictor in &options.predict {
                    settings.push(Setting { lag, predictor, guard, predict_pose });
                }
            }
        }
    }
    settings
}

fn table(options: &LagOptions, settings: &[Setting], outcomes: &[Outcome]) -> Table {
    let mut table = Table::new(
        "scene | path | lights | size | predictor | guard | server_prediction | lag | bit_error \
         | known_share | psnr | ssim | flip | vmaf | known_inside_error | known_edge_error | unknown_error \
         | near_movers_share | near_movers_error",
    );
    let path = options.scene.path_text().to_string_lossy().into_owned();
    let path = path.rsplit_once('#').map_or("path", |(_, name)| name);
    let path = options.turn.map_or_else(|| path.to_owned(), |rate| format!("turn {rate}°/s"));
    for (setting, outcome) in settings.iter().zip(outcomes) {
        let bits = &outcome.bits;
        let near = bits.near_percent();
        let mean_image = |of: fn(&ImageError) -> f64, decimals: usize| {
            let mean = outcome.mean_image(of);
            if mean.is_nan() { String::new() } else { format!("{mean:.decimals$}") }
        };
        table.rows.push(vec![
            options.scene.scene_name(),
            path.clone(),
            bits.lights.to_string(),
            format!("{}x{}", options.scene.size.0, options.scene.size.1),
            setting.predictor.to_string(),
            setting.guard.to_string(),
            setting.predict_pose.name().to_owned(),
            setting.lag.to_string(),
            format!("{:.4}", bits.wrong_percent()),
            format!("{:.4}", mean(&outcome.known_share)),
            mean_image(|error| error.psnr_db, 2),
            mean_image(|error| error.ssim, 4),
            mean_image(|error| error.flip, 4),
            outcome.vmaf.map_or(String::new(), |vmaf| format!("{vmaf:.2}")),
            format!("{:.4}", bits.percent(bits.known_inside)),
            format!("{:.4}", bits.percent(bits.known_edge)),
            format!("{:.4}", bits.percent(bits.unknown)),
            near.map_or(String::new(), |_| format!("{:.4}", bits.percent(bits.relevant_near))),
            near.map_or(String::new(), |near| format!("{near:.4}")),
        ]);
    }
    table
}

struct Rig {
    predict: PredictRig,
    path: CameraPath,
    size: (u32, u32),
    fps: f64,
    turn_rad_per_s: Option<f64>,
    first_s: f64,
    span_s: f64,
    frames: u32,
}

impl Rig {
    fn new(options: &LagOptions) -> Result<Self> {
        let mut scene = options.scene.load_scene()?;
        if options.ignore_alpha {
            ignore_alpha(&mut scene);
        }
        let path = options.scene.load_path()?;
        let most = options.lags.iter().max().copied().unwrap_or(0) + POSES_BEFORE;
        let first_s = f64::from(most) / options.fps;
        Ok(Self {
            predict: PredictRig::new(&scene, options.scene.size, options.allow_software)?,
            span_s: (path.duration_s() - first_s).max(0.0),
            first_s,
            path,
            size: options.scene.size,
            fps: options.fps,
            turn_rad_per_s: options.turn.map(f64::to_radians),
            frames: options.scene.frames,
        })
    }

    /// Time of a measured frame: the middle of its share of the path.
    fn time_s(&self, frame: u32) -> f64 {
        self.first_s + self.span_s * (f64::from(frame) + 0.5) / f64::from(self.frames)
    }

    fn camera(&self, time_s: f64) -> Camera {
        let (width, height) = self.size;
        let Some(rate) = self.turn_rad_per_s else { return self.path.camera(time_s, width, height) };
        let start = self.path.camera(0.0, width, height);
        Camera { orientation: glam::DQuat::from_rotation_y(rate * time_s) * start.orientation, ..start }
    }

    /// The view of the newest mask at `time_s`: that of `lag` frames before, or the server's extrapolation from it and
    /// the poses before.
    fn traced_for(&self, setting: &Setting, time_s: f64) -> Viewpoint {
        let before = |frames: u32| time_s - f64::from(frames) / self.fps;
        let (mut camera, mut scene_time_s) = (self.camera(before(setting.lag)), before(setting.lag));
        if setting.predict_pose == PosePrediction::Velocity {
            let mut motion = Motion::default();
            for frames in (setting.lag..=setting.lag + POSES_BEFORE).rev() {
                motion.push(before(frames), self.camera(before(frames)));
            }
            camera = motion.extrapolate(time_s).unwrap_or(camera);
            scene_time_s = time_s;
        }
        Viewpoint { camera: camera.widened(setting.guard.per_side()), scene: scene_time_s.into() }
    }
}

fn ignore_alpha(scene: &mut Scene) {
    for material in &mut scene.materials {
        if matches!(material.alpha, AlphaMode::Mask { .. }) {
            material.alpha = AlphaMode::Opaque;
        }
    }
}
