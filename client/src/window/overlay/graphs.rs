//! Graphs of the last ten seconds: frame time, lag, received bits.

use egui::{Align2, Color32, FontId, Pos2, Rect, Sense, Stroke, pos2, vec2};

use super::{
    figures::{Figure, Figures, SPAN},
    style::{BLUE, GREEN, ORANGE, TEXT},
};

const HEIGHT: f32 = 34.0;

/// One for each pixel.
const POINTS: u16 = 240;

pub(super) fn show(ui: &mut egui::Ui, figures: &Figures) {
    ui.separator();
    graph(ui, figures, "frame time", "ms", GREEN, Reduce::Largest(|figure| figure.frame_ms));
    graph(ui, figures, "lag", "frames", ORANGE, Reduce::Largest(|figure| figure.lag.map_or(0.0, f64::from)));
    graph(ui, figures, "received", "kbit a point", BLUE, Reduce::Sum(|figure| figure.bits / 1e3));
}

/// Combines the frames of one point into a value.
#[derive(Clone, Copy)]
enum Reduce {
    Largest(fn(&Figure) -> f64),
    Sum(fn(&Figure) -> f64),
}

/// Returns each point's value; `None` if no frame falls on it.
fn points(figures: &Figures, reduce: Reduce) -> Vec<Option<f64>> {
    let mut values = vec![None; usize::from(POINTS)];
    let Some(newest) = figures.frames().last().map(|figure| figure.at) else { return values };
    for figure in figures.frames() {
        let age = newest.saturating_duration_since(figure.at).as_secs_f64() / SPAN.as_secs_f64();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 0 to the number of points")]
        let points_ago = (age.clamp(0.0, 1.0) * f64::from(POINTS - 1)).round() as usize;
        let point = &mut values[usize::from(POINTS) - 1 - points_ago];
        *point = Some(match reduce {
            Reduce::Largest(value) => value(figure).max(point.unwrap_or(0.0)),
            Reduce::Sum(value) => value(figure) + point.unwrap_or(0.0),
        });
    }
    values
}

fn graph(ui: &mut egui::Ui, figures: &Figures, name: &str, unit: &str, color: Color32, reduce: Reduce) {
    let values = points(figures, reduce);
    let peak = values.iter().flatten().fold(0.0, |peak: f64, value| peak.max(*value));
    let top = scale(peak);
    let (area, _) = ui.allocate_exact_size(vec2(ui.available_width(), HEIGHT), Sense::hover());
    let painter = ui.painter_at(area);
    painter.rect_filled(area, 3.0, Color32::from_black_alpha(120));
    let line = values.iter().enumerate().filter_map(|(index, value)| Some(position(area, index, (*value)? / top)));
    painter.line(line.collect(), Stroke::new(1.5, color));
    let text = format!("{name}: peak {peak:.1} {unit}");
    painter.text(area.left_top() + vec2(4.0, 1.0), Align2::LEFT_TOP, text, FontId::proportional(11.0), TEXT);
    ui.add_space(3.0);
}

fn position(area: Rect, index: usize, share: f64) -> Pos2 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "pixel positions")]
    let (x, y) = (index as f32 / f32::from(POINTS - 1), share as f32);
    // The text needs the top.
    pos2(area.left() + x * area.width(), area.bottom() - 2.0 - y * (area.height() - 16.0))
}

/// Returns the upper end of a scale: 1, 2 or 5 times a power of ten, so that it rarely changes.
fn scale(peak: f64) -> f64 {
    let decade = 10_f64.powf(peak.max(1e-3).log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|step| step * decade).find(|top| *top >= peak).unwrap_or(peak)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_are_round_and_large_enough() {
        for (peak, top) in [(16.7, 20.0), (20.0, 20.0), (33.0, 50.0), (0.4, 0.5), (700.0, 1000.0), (1.0, 1.0)] {
            assert!((scale(peak) - top).abs() < 1e-9 * top, "{peak}: {}", scale(peak));
        }
        assert!(scale(0.0) > 0.0);
    }
}
