//! Plots as SVG: lines and scatters with a legend, in colours and marks that every reader can tell apart. [`grid`] lays
//! out pictures with captions.

mod draw;
pub mod front;
pub mod grid;
mod model;
mod ticks;

pub use self::{
    front::{Better, Front},
    model::{Axis, Plot, Series},
};

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
        // Zero has no logarithm: only the line's first point is left out.
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
