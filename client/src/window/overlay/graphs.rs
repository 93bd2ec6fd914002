//! Ten seconds as lines: how long frames took, how late masks were, how much came.

use egui::{Align2, Color32, FontId, Pos2, Rect, Sense, Stroke, pos2, vec2};

use super::{
    BLUE, GREEN, ORANGE, TEXT,
    figures::{Figure, Figures, SPAN},
};

const HEIGHT: f32 = 34.0;

/// Points of a line: as many as it has pixels.
const POINTS: u16 = 240;

pub(super) fn show(ui: &mut egui::Ui, figures: &Figures) {
    ui.separator();
    graph(ui, figures, "frame time", "ms", GREEN, Of::Largest(|figure| figure.frame_ms));
    graph(ui, figures, "lag", "frames", ORANGE, Of::Largest(|figure| figure.lag.map_or(0.0, f64::from)));
    graph(ui, figures, "received", "kbit a point", BLUE, Of::Sum(|figure| figure.bits / 1e3));
}

/// What a point shows of the frames that fall on it.
#[derive(Clone, Copy)]
enum Of {
    Largest(fn(&Figure) -> f64),
    Sum(fn(&Figure) -> f64),
}

/// A value for each point; none where no frame falls on it.
fn points(figures: &Figures, of: Of) -> Vec<Option<f64>> {
    let mut values = vec![None; usize::from(POINTS)];
    let Some(newest) = figures.frames().last().map(|figure| figure.at) else { return values };
    for figure in figures.frames() {
        let age = newest.saturating_duration_since(figure.at).as_secs_f64() / SPAN.as_secs_f64();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 0 to the number of points")]
        let back = (age.clamp(0.0, 1.0) * f64::from(POINTS - 1)).round() as usize;
        let place = &mut values[usize::from(POINTS) - 1 - back];
        *place = Some(match of {
            Of::Largest(value) => value(figure).max(place.unwrap_or(0.0)),
            Of::Sum(value) => value(figure) + place.unwrap_or(0.0),
        });
    }
    values
}

fn graph(ui: &mut egui::Ui, figures: &Figures, name: &str, unit: &str, color: Color32, of: Of) {
    let values = points(figures, of);
    let most = values.iter().flatten().fold(0.0, |most: f64, value| most.max(*value));
    let top = scale(most);
    let (area, _) = ui.allocate_exact_size(vec2(ui.available_width(), HEIGHT), Sense::hover());
    let painter = ui.painter_at(area);
    painter.rect_filled(area, 3.0, Color32::from_black_alpha(120));
    let line = values.iter().enumerate().filter_map(|(index, value)| Some(place(area, index, (*value)? / top)));
    painter.line(line.collect(), Stroke::new(1.5, color));
    let text = format!("{name}: at most {most:.1} {unit}");
    painter.text(area.left_top() + vec2(4.0, 1.0), Align2::LEFT_TOP, text, FontId::proportional(11.0), TEXT);
    ui.add_space(3.0);
}

fn place(area: Rect, index: usize, share: f64) -> Pos2 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "places on a screen")]
    let (x, y) = (index as f32 / f32::from(POINTS - 1), share as f32);
    // The text has the top.
    pos2(area.left() + x * area.width(), area.bottom() - 2.0 - y * (area.height() - 16.0))
}

/// The upper end of a scale: 1, 2 or 5 times a power of ten, so that it does not jump with every frame.
fn scale(most: f64) -> f64 {
    let decade = 10_f64.powf(most.max(1e-3).log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|step| step * decade).find(|top| *top >= most).unwrap_or(most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_are_round_and_large_enough() {
        for (most, top) in [(16.7, 20.0), (20.0, 20.0), (33.0, 50.0), (0.4, 0.5), (700.0, 1000.0), (1.0, 1.0)] {
            assert!((scale(most) - top).abs() < 1e-9 * top, "{most}: {}", scale(most));
        }
        assert!(scale(0.0) > 0.0);
    }
}
