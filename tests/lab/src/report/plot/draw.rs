//! Draws a plot with `plotters`.

use anyhow::{Result, anyhow, ensure};
use plotters::{
    coord::{
        Shift,
        cartesian::Cartesian2d,
        ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter},
        types::RangedCoordf64,
    },
    element::DynElement,
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

use super::{
    model::{Axis, Plot, Series, Style},
    ticks::{self, Ticks},
};

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Scale, Scale>>;
type Placed = Vec<Option<(f64, f64)>>;

const WIDTH_PX: u32 = 640;
const HEIGHT_PX: u32 = 420;
const ENTRY_PX: i32 = 22;
const MARK_PX: i32 = 4;
const FONT: &str = "sans-serif";
/// Longest line on which every point is marked; longer ones get about half as many marks.
const MARKED_POINTS: usize = 24;

/// Okabe and Ito's palette ("Color Universal Design", 2008), which colour-blind readers can tell apart. Yellow, faint
/// on white, comes last.
const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(0, 0, 0),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(240, 228, 66),
];
const FRONT: RGBColor = RGBColor(110, 110, 110);

/// Outlines of marks, in units of [`MARK_PX`]; the empty one is a disc. All differ without colour.
const MARKS: [&[(i32, i32)]; 7] = [
    &[],
    &[(-1, -1), (1, -1), (1, 1), (-1, 1)],
    &[(0, -1), (1, 1), (-1, 1)],
    &[(0, -2), (1, 0), (0, 2), (-1, 0)],
    &[(-1, -1), (1, -1), (0, 1)],
    &[(-2, 0), (0, -1), (2, 0), (0, 1)],
    &[(-1, -2), (1, -2), (1, 2), (-1, 2)],
];

struct Scale {
    ticks: Ticks,
    log: bool,
}

impl Scale {
    fn of(axis: &Axis, places: &[f64]) -> Self {
        let low = places.iter().copied().fold(f64::INFINITY, f64::min);
        let high = places.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let ticks = if axis.log { ticks::log(low, high) } else { ticks::linear(low, high) };
        Self { ticks, log: axis.log }
    }
}

impl Ranged for Scale {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, place: &f64, pixels: (i32, i32)) -> i32 {
        RangedCoordf64::from(self.range()).map(place, pixels)
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.ticks.places.clone()
    }

    fn range(&self) -> std::ops::Range<f64> {
        self.ticks.range.0..self.ticks.range.1
    }
}

impl ValueFormatter<f64> for Scale {
    fn format(place: &f64) -> String {
        ticks::name(*place)
    }

    fn format_ext(&self, place: &f64) -> String {
        ticks::name(if self.log { 10.0_f64.powf(*place) } else { *place })
    }
}

impl Plot {
    /// Returns the plot as SVG. Equal plots give equal text. Errors if no point has a place on both axes.
    pub fn svg(&self) -> Result<String> {
        let places = |series: &Series| series.points.iter().map(|&point| self.place(point)).collect();
        let placed: Vec<Placed> = self.series.iter().map(places).collect();
        ensure!(placed.iter().flatten().any(Option::is_some), "nothing to plot under {:?}", self.title);
        svg(self, &placed)
    }
}

fn svg(plot: &Plot, placed: &[Placed]) -> Result<String> {
    let mut text = String::new();
    let names = plot.series.iter().map(|series| series.name.as_str()).chain(plot.front.map(|_| "Pareto front"));
    let longest = names.clone().map(|name| name.chars().count()).max().unwrap_or(0);
    let legend_px = 44 + 8 * u32::try_from(longest.min(60)).unwrap_or(60);
    let entries_px = 60 + ENTRY_PX.unsigned_abs() * u32::try_from(names.count()).unwrap_or(u32::MAX / 100);
    let root =
        SVGBackend::with_string(&mut text, (WIDTH_PX + legend_px, HEIGHT_PX.max(entries_px))).into_drawing_area();
    drawn(plot, placed, &root).map_err(|error| anyhow!("drawing {:?}: {error}", plot.title))?;
    drop(root);
    Ok(text)
}

fn drawn(plot: &Plot, placed: &[Placed], root: &Area<'_>) -> Result<(), Box<dyn std::error::Error>> {
    root.fill(&WHITE)?;
    let (chart_area, legend_area) = root.split_horizontally(WIDTH_PX);
    let along = |of: fn(&(f64, f64)) -> f64| placed.iter().flatten().flatten().map(of).collect::<Vec<_>>();
    let (x, y) = (Scale::of(&plot.x, &along(|point| point.0)), Scale::of(&plot.y, &along(|point| point.1)));
    let mut chart = ChartBuilder::on(&chart_area)
        .caption(&plot.title, (FONT, 18))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(64)
        .build_cartesian_2d(x, y)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.15))
        .label_style((FONT, 13))
        .axis_desc_style((FONT, 15))
        .x_desc(&plot.x.label)
        .y_desc(&plot.y.label)
        .draw()?;
    if let Some(front) = plot.front {
        let points: Vec<_> = plot.series.iter().flat_map(|series| series.points.iter().copied()).collect();
        let points: Vec<_> = front.of(&points).into_iter().filter_map(|point| plot.place(point)).collect();
        chart.draw_series(DashedLineSeries::new(points.iter().copied(), 6, 4, FRONT.stroke_width(2)))?;
        chart.draw_series(points.into_iter().map(|point| Circle::new(point, 2 * MARK_PX, FRONT.stroke_width(2))))?;
    }
    for (index, (series, points)) in plot.series.iter().zip(placed).enumerate() {
        draw_series(&mut chart, index, series.style, points)?;
    }
    legend(plot, &legend_area)
}

fn draw_series(
    chart: &mut Chart<'_, '_>,
    index: usize,
    style: Style,
    points: &[Option<(f64, f64)>],
) -> Result<(), Box<dyn std::error::Error>> {
    if style == Style::Line {
        for line in points.split(Option::is_none).filter(|line| line.len() > 1) {
            chart.draw_series(LineSeries::new(line.iter().copied().flatten(), colour(index).stroke_width(2)))?;
        }
    }
    let every =
        if style == Style::Line && points.len() > MARKED_POINTS { points.len() / (MARKED_POINTS / 2) } else { 1 };
    // Lines on top of each other are marked at different points.
    let marked = points.iter().skip(index % every).step_by(every).flatten();
    chart.draw_series(marked.map(|&point| EmptyElement::at(point) + mark(index)))?;
    Ok(())
}

fn legend(plot: &Plot, area: &Area<'_>) -> Result<(), Box<dyn std::error::Error>> {
    let style = TextStyle::from((FONT, 14).into_font()).pos(Pos::new(HPos::Left, VPos::Center));
    let mut y = 50;
    for (index, series) in plot.series.iter().enumerate() {
        if series.style == Style::Line {
            area.draw(&PathElement::new([(4, y), (32, y)], colour(index).stroke_width(2)))?;
        }
        area.draw(&(EmptyElement::at((18, y)) + mark(index)))?;
        area.draw(&Text::new(series.name.as_str(), (40, y), style.clone()))?;
        y += ENTRY_PX;
    }
    if plot.front.is_some() {
        area.draw(&Circle::new((18, y), 2 * MARK_PX, FRONT.stroke_width(2)))?;
        area.draw(&Text::new("Pareto front", (40, y), style))?;
    }
    Ok(())
}

fn colour(index: usize) -> RGBColor {
    COLOURS[index % COLOURS.len()]
}

/// A series' mark, around the origin. Seven marks and eight colours: 56 series differ.
fn mark<'a>(index: usize) -> DynElement<'static, SVGBackend<'a>, (i32, i32)> {
    let style = colour(index).filled();
    match MARKS[index % MARKS.len()] {
        [] => Circle::new((0, 0), MARK_PX, style).into_dyn(),
        outline => {
            let scaled: Vec<_> = outline.iter().map(|&(x, y)| (x * MARK_PX, y * MARK_PX)).collect();
            Polygon::new(scaled, style).into_dyn()
        }
    }
}
