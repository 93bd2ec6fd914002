//! `lab predict-cost`: cost of prediction in a client's frame.
//!
//! Masks are traced in advance, without a network or server, and every predictor draws each frame in turn, so that
//! other load of the machine affects all alike.

use std::time::Instant;

use anyhow::{Result, ensure};
use glam::DVec3;
use gnomon_client::predictor::Predictor;
use gnomon_scene::camera::Camera;

use super::{predict_rig::PredictRig, scene_args::SceneArgs, statistics::median, table::Table};

#[derive(Debug, Clone, clap::Args)]
pub struct PredictCostOptions {
    /// Scene, path, size, and how many frames of the path are drawn.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Age of the mask, in frames at 60 a second.
    #[arg(long, default_value_t = 6)]
    pub lag: u32,
    /// Rounds per frame and predictor.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    pub runs: u32,
    /// Allow a software adapter.
    #[arg(long)]
    pub allow_software: bool,
}

/// A predictor, and whether the depth of the mask's view is kept in the history or drawn anew.
const WAYS: [(Predictor, &str); 4] = [
    (Predictor::None, "unused"),
    (Predictor::Dissertation(gnomon_client::predictor::Unknown::Lit), "unused"),
    (Predictor::Surface, "kept"),
    (Predictor::Surface, "drawn"),
];

/// Offset that no pixel shows, but that makes a camera unknown to the history.
const ELSEWHERE_M: f64 = 1e-9;

/// Measures, writes `predict_cost.csv`, and reports each frame to `progress`.
pub fn measure(options: &PredictCostOptions, mut progress: impl FnMut(&str)) -> Result<Table> {
    let scene = &options.scene;
    let path = scene.load_path()?;
    let lag_s = f64::from(options.lag) / 60.0;
    ensure!(path.duration_s() > lag_s, "the path takes {} s, less than the lag", path.duration_s());
    let mut rig = PredictRig::new(&scene.load_scene()?, scene.size, options.allow_software)?;
    let mut times_ms: [Vec<f64>; WAYS.len()] = Default::default();
    let mut ratios: [Vec<f64>; WAYS.len()] = Default::default();
    for frame in 0..scene.frames {
        let share = (f64::from(frame) + 0.5) / f64::from(scene.frames);
        let time_s = lag_s + (path.duration_s() - lag_s) * share;
        let at = |time_s: f64| path.camera(time_s, scene.size.0, scene.size.1);
        let (now, then) = (at(time_s), at(time_s - lag_s));
        let elsewhere = Camera { position_m: then.position_m + DVec3::X * ELSEWHERE_M, ..then };
        let mask = rig.trace(&then)?;
        for run in 0..=options.runs {
            let mut none_ms = f64::NAN;
            for (way, (predictor, depth)) in WAYS.iter().enumerate() {
                rig.see(&then)?;
                let traced_for = if *depth == "kept" { &then } else { &elsewhere };
                let begun = Instant::now();
                rig.show(&now, *predictor, Some((&mask, traced_for)))?;
                let ms = begun.elapsed().as_secs_f64() * 1e3;
                // The first round warms up.
                if run > 0 {
                    if way == 0 {
                        none_ms = ms;
                    }
                    times_ms[way].push(ms);
                    ratios[way].push(ms / none_ms);
                }
            }
        }
        progress(&format!("frame {} of {} at {time_s:.3} s", frame + 1, scene.frames));
    }
    let mut table = Table::new("scene | size | predictor | depth | lag | ms_p50 | ratio_to_none");
    for ((predictor, depth), (times, ratios)) in WAYS.iter().zip(times_ms.iter().zip(&ratios)) {
        let figure = |values: &[f64], decimals: usize| median(values).map(|value| format!("{value:.decimals$}"));
        table.rows.push(vec![
            scene.scene_name(),
            format!("{}x{}", scene.size.0, scene.size.1),
            predictor.to_string(),
            (*depth).to_owned(),
            options.lag.to_string(),
            figure(times, 2).unwrap_or_default(),
            figure(ratios, 3).unwrap_or_default(),
        ]);
    }
    scene.write("predict_cost.csv", &table.csv())?;
    Ok(table)
}
