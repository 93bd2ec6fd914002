//! Plots of the reports, as SVG: lines and scatters with a legend beside the data, in colours and marks that stay apart
//! for every eye. [`grid`] lays pictures out under captions.

mod draw;
pub mod front;
pub mod grid;
mod ticks;

use anyhow::{Result, ensure};

pub use front::{Better, Front};

/// A quantity along one side.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Axis {
    /// What it is, with its unit: `lag, frames`.
    pub label: String,
    /// Whether decades are evenly spaced. Values that have no logarithm are left out.
    pub log: bool,
}

impl Axis {
    /// An axis of even steps.
    #[must_use]
    pub fn linear(label: &str) -> Self {
        Self { label: label.to_owned(), log: false }
    }

    /// An axis of even decades.
    #[must_use]
    pub fn log(label: &str) -> Self {
        Self { label: label.to_owned(), log: true }
    }

    /// Where a value lies on it; nowhere, if it is not finite or has no logarithm here.
    fn place(&self, value: f64) -> Option<f64> {
        let place = if self.log { value.log10() } else { value };
        place.is_finite().then_some(place)
    }
}

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Style {
    Line,
    Dots,
}

/// Points that belong together.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// x and y. A line has a gap where a value is not finite or has no place on its axis.
    pub points: Vec<(f64, f64)>,
    style: Style,
}

impl Series {
    /// Points joined by a line, in their order, and marked.
    #[must_use]
    pub fn line(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.to_owned(), points, style: Style::Line }
    }

    /// Points that are only marked.
    #[must_use]
    pub fn dots(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.to_owned(), points, style: Style::Dots }
    }
}

/// A plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Plot {
    /// Heading.
    pub title: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// What is drawn; a series' colour and mark follow from its place here.
    pub series: Vec<Series>,
    /// Marks the points that no other point beats in both directions.
    pub front: Option<Front>,
}

impl Plot {
    /// A plot without a front.
    #[must_use]
    pub fn new(title: &str, x: Axis, y: Axis, series: Vec<Series>) -> Self {
        Self { title: title.to_owned(), x, y, series, front: None }
    }

    /// The same with its Pareto front marked.
    #[must_use]
    pub fn with_front(self, front: Front) -> Self {
        Self { front: Some(front), ..self }
    }

    /// The plot as SVG. Equal plots give equal text.
    ///
    /// # Errors
    /// When no point has a place on both axes.
    pub fn svg(&self) -> Result<String> {
        let placed: Vec<Vec<Option<(f64, f64)>>> =
            self.series.iter().map(|series| series.points.iter().map(|&point| self.place(point)).collect()).collect();
        ensure!(placed.iter().flatten().any(Option::is_some), "nothing to plot under {:?}", self.title);
        draw::svg(self, &placed)
    }

    fn place(&self, (x, y): (f64, f64)) -> Option<(f64, f64)> {
        Some((self.x.place(x)?, self.y.place(y)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(log: bool) -> Plot {
        let lines = |name: &str, by: f64| {
            Series::line(name, (0..40).map(|x| (f64::from(x), by * f64::from(x).powi(2))).collect())
        };
        let y = Axis { label: "error, %".into(), log };
        Plot::new("A & <B>", Axis::linear("lag, frames"), y, vec![lines("one", 1.0), lines("two", 3.0)])
    }

    #[test]
    fn names_labels_and_title_are_in_the_text_and_escaped() {
        let svg = plot(false).svg().unwrap();
        for text in ["A &amp; &lt;B&gt;", "lag, frames", "error, %", "one", "two"] {
            assert!(svg.contains(text), "{text}: {svg}");
        }
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
        assert_eq!(svg, plot(false).svg().unwrap());
    }

    #[test]
    fn values_without_a_place_leave_gaps() {
        let lines = |plot: &Plot| plot.svg().unwrap().matches("<polyline").count();
        let mut gap = plot(false);
        let whole = lines(&gap);
        gap.series[0].points[20].1 = f64::INFINITY;
        assert_eq!(lines(&gap), whole + 1);
        // Zero has no logarithm: the point goes, at the line's end, and nothing is torn.
        assert_eq!(plot(true).svg().unwrap().matches("NaN").count(), 0);
        let nothing = Plot::new("t", Axis::linear("x"), Axis::log("y"), vec![Series::dots("s", vec![(1.0, 0.0)])]);
        assert!(nothing.svg().unwrap_err().to_string().contains("nothing to plot"));
    }

    #[test]
    fn one_point_is_enough() {
        let dot = Plot::new("t", Axis::log("x"), Axis::linear("y"), vec![Series::dots("s", vec![(7.0, 0.0)])]);
        assert!(dot.svg().unwrap().contains("<circle"));
    }
}
