use super::front::Front;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Axis {
    /// Name and unit: `lag, frames`.
    pub label: String,
    /// Logarithmic: leaves out values without a logarithm.
    pub log: bool,
}

impl Axis {
    pub fn linear(label: &str) -> Self {
        Self { label: label.to_owned(), log: false }
    }

    pub fn log(label: &str) -> Self {
        Self { label: label.to_owned(), log: true }
    }

    /// Returns a value's place on the axis; `None` if it is not finite or has no logarithm.
    pub(super) fn place(&self, value: f64) -> Option<f64> {
        let place = if self.log { value.log10() } else { value };
        place.is_finite().then_some(place)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Style {
    Line,
    Dots,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    pub name: String,
    /// x and y. A line has a gap where a point has no place on its axes.
    pub points: Vec<(f64, f64)>,
    pub(super) style: Style,
}

impl Series {
    /// Points joined by a line, in their order, and marked.
    pub fn line(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.to_owned(), points, style: Style::Line }
    }

    pub fn dots(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.to_owned(), points, style: Style::Dots }
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct Plot {
    pub title: String,
    pub x: Axis,
    pub y: Axis,
    /// The index selects colour and mark.
    pub series: Vec<Series>,
    pub front: Option<Front>,
}

impl Plot {
    pub fn new(title: &str, x: Axis, y: Axis, series: Vec<Series>) -> Self {
        Self { title: title.to_owned(), x, y, series, front: None }
    }

    pub fn with_front(self, front: Front) -> Self {
        Self { front: Some(front), ..self }
    }

    pub(super) fn place(&self, (x, y): (f64, f64)) -> Option<(f64, f64)> {
        Some((self.x.place(x)?, self.y.place(y)?))
    }
}
