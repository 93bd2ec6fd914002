//! Plots of error against lag, one line per way of predicting, and a grid of pictures.

use anyhow::{Context, Result};
use image::{Rgb, RgbImage};

use super::outcome::{Outcome, PosePrediction, Setting};
use crate::report::{
    plot::{
        Axis, Plot, Series,
        grid::{Cell, grid},
    },
    scene_args::SceneArgs,
};

/// File name, axis and value of a plot.
type Quantity = (&'static str, Axis, fn(&Outcome) -> f64);

/// Draws `lag_*.svg`, and `lag_grid.png`: the shown picture of each lag, and its difference from the truth.
pub(super) fn draw(scene: &SceneArgs, settings: &[Setting], outcomes: &[Outcome], truths: &[RgbImage]) -> Result<()> {
    let quantities: [Quantity; 5] = [
        ("bit_error", Axis::log("wrong bits, % of the relevant ones"), |outcome| outcome.bits.wrong_percent()),
        ("psnr", Axis::linear("PSNR, dB"), |outcome| outcome.mean_image(|error| error.psnr_db)),
        ("ssim", Axis::linear("SSIM"), |outcome| outcome.mean_image(|error| error.ssim)),
        ("flip", Axis::linear("FLIP"), |outcome| outcome.mean_image(|error| error.flip)),
        ("vmaf", Axis::linear("VMAF"), |outcome| outcome.vmaf.unwrap_or(f64::NAN)),
    ];
    for (name, axis, value) in quantities {
        let series = series(settings, outcomes, value);
        if series.iter().all(|series| series.points.is_empty()) {
            continue;
        }
        let title = format!("{}: {name} against lag", scene.scene_name());
        let plot = Plot::new(&title, Axis::linear("lag, frames"), axis, series);
        scene.write(&format!("lag_{name}.svg"), &plot.svg()?)?;
    }
    let file = scene.result("lag_grid.png")?;
    let rows = rows(settings, outcomes, truths);
    grid(&rows)?.save(&file).with_context(|| format!("writing {}", file.display()))
}

/// A line for each predictor, guard band and extrapolation.
fn series(settings: &[Setting], outcomes: &[Outcome], value: fn(&Outcome) -> f64) -> Vec<Series> {
    let mut lines: Vec<(String, Vec<(f64, f64)>)> = Vec::new();
    for (setting, outcome) in settings.iter().zip(outcomes) {
        let name = name(setting);
        let place = lines.iter().position(|(known, _)| *known == name).unwrap_or_else(|| {
            lines.push((name, Vec::new()));
            lines.len() - 1
        });
        let value = value(outcome);
        if value.is_finite() {
            lines[place].1.push((f64::from(setting.lag), value));
        }
    }
    lines.into_iter().map(|(name, points)| Series::line(&name, points)).collect()
}

fn name(setting: &Setting) -> String {
    let mut name = setting.predictor.to_string();
    if setting.guard.width + setting.guard.height > 0 {
        name += &format!(", guard {}", setting.guard);
    }
    if setting.predict_pose == PosePrediction::Velocity {
        name += ", poses by velocity";
    }
    name
}

/// Rows for the middle frame, one per lag: the picture of each way of predicting, and its difference from the truth
/// times four.
fn rows(settings: &[Setting], outcomes: &[Outcome], truths: &[RgbImage]) -> Vec<Vec<Cell>> {
    let middle = truths.len() / 2;
    let mut lags: Vec<u32> = settings.iter().map(|setting| setting.lag).collect();
    lags.dedup();
    let rows = lags.iter().map(|lag| {
        let of_lag = settings.iter().zip(outcomes).filter(|(setting, _)| setting.lag == *lag);
        of_lag
            .flat_map(|(setting, outcome)| {
                let shown = &outcome.shown[middle];
                let caption = format!("lag {lag}, {}", name(setting));
                let difference = difference(shown, &truths[middle]);
                [
                    Cell { caption, picture: small(shown) },
                    Cell { caption: "4 x difference".to_owned(), picture: small(&difference) },
                ]
            })
            .collect()
    });
    rows.collect()
}

fn difference(one: &RgbImage, other: &RgbImage) -> RgbImage {
    RgbImage::from_fn(one.width(), one.height(), |x, y| {
        let (one, other) = (one.get_pixel(x, y), other.get_pixel(x, y));
        Rgb([0, 1, 2].map(|channel| one[channel].abs_diff(other[channel]).saturating_mul(4)))
    })
}

/// Shrinks to at most 480 pixels wide.
fn small(picture: &RgbImage) -> RgbImage {
    let width = picture.width().min(480);
    let height = (picture.height() * width / picture.width()).max(1);
    image::imageops::resize(picture, width, height, image::imageops::FilterType::Triangle)
}
