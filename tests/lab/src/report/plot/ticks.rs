//! Ticks of an axis.

/// About as many labels as fit an axis.
const NAMES: f64 = 6.0;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Ticks {
    pub(super) range: (f64, f64),
    pub(super) places: Vec<f64>,
}

/// Even steps of 1, 2 or 5 times a power of ten, covering `low` to `high`.
pub(super) fn linear(low: f64, high: f64) -> Ticks {
    let (low, high) = widen(low, high);
    let raw = (high - low) / NAMES;
    let decade = 10.0_f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|by| by * decade).into_iter().find(|&step| step >= raw * 0.999);
    let step = step.unwrap_or(10.0 * decade);
    let (first, last) = ((low / step).floor(), (high / step).ceil());
    let places = (0..).map(|i| (first + f64::from(i)) * step).take_while(|&p| p <= (last + 0.5) * step).collect();
    Ticks { range: (first * step, last * step), places }
}

/// Whole decades, and 2 and 5 times them if there are few; places are decimal logarithms.
pub(super) fn log(low: f64, high: f64) -> Ticks {
    let (low, high) = if low == high { (low - 0.3, high + 0.3) } else { (low, high) };
    let (first, last) = (low.floor(), high.ceil());
    let decades = last - first;
    let within: &[f64] = if decades <= 2.0 { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let every = (decades / NAMES).ceil().max(1.0);
    let places: Vec<f64> = (0..)
        .map(|i| first + f64::from(i) * every)
        .take_while(|&decade| decade <= last)
        .flat_map(|decade| within.iter().map(move |by| decade + by.log10()))
        .collect();
    // From label to label rather than whole decades: values may span a quarter of one.
    let start = places.iter().copied().rfind(|&place| place <= low + 1e-9).unwrap_or(first);
    let end = places.iter().copied().find(|&place| place >= high - 1e-9).unwrap_or(last);
    Ticks { range: (start, end), places: places.into_iter().filter(|place| (start..=end).contains(place)).collect() }
}

/// Widens a range of one value, and starts ranges near zero at zero, so that heights compare.
fn widen(low: f64, high: f64) -> (f64, f64) {
    if low == high {
        return if low == 0.0 { (0.0, 1.0) } else { (low - low.abs() * 0.1, high + high.abs() * 0.1) };
    }
    if low > 0.0 && low < 0.4 * high { (0.0, high) } else { (low, high) }
}

/// Formats a value with up to four significant digits and no trailing zeros.
pub(super) fn name(value: f64) -> String {
    if value.abs() < 1e-12 {
        return "0".to_owned();
    }
    let size = value.abs();
    if !(1e-4..1e7).contains(&size) {
        return format!("{value:.0e}");
    }
    let decimals = if size >= 1000.0 {
        0
    } else if size >= 100.0 {
        1
    } else if size >= 1.0 {
        3
    } else {
        6
    };
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn steps_are_round() {
        assert_eq!(linear(0.0, 50.0), Ticks { range: (0.0, 50.0), places: vec![0.0, 10.0, 20.0, 30.0, 40.0, 50.0] });
        let (low, high) = linear(3.0, 3.0).range;
        assert!((low - 2.7).abs() < 1e-9 && (high - 3.3).abs() < 1e-9);
        let names = |ticks: Ticks| ticks.places.into_iter().map(name).collect::<Vec<_>>();
        assert_eq!(names(linear(0.0, 0.012)), ["0", "0.002", "0.004", "0.006", "0.008", "0.01", "0.012"]);
        let powers = |ticks: Ticks| ticks.places.into_iter().map(|place| name(10_f64.powf(place))).collect::<Vec<_>>();
        assert_eq!(powers(log(0.0, 2.0)), ["1", "2", "5", "10", "20", "50", "100"]);
        assert_eq!(powers(log(-3.0, 3.0)), ["0.001", "0.01", "0.1", "1", "10", "100", "1000"]);
        assert_eq!(powers(log(0.4, 0.5)), ["2", "5"]);
        assert_eq!([1e9, 123.4, 0.0].map(name), ["1e9", "123.4", "0"]);
    }

    proptest! {
        #[test]
        fn all_values_are_inside_and_names_are_few(low in -1e6..1e6_f64, span in 0.0..1e6_f64) {
            for ticks in [linear(low, low + span), log(low / 1e5, (low + span) / 1e5)] {
                let (start, end) = ticks.range;
                let scale = if ticks.range == linear(low, low + span).range { 1.0 } else { 1e-5 };
                prop_assert!(start <= low * scale + 1e-6 && end >= (low + span) * scale - 1e-6, "{:?}", ticks);
                prop_assert!((2..=12).contains(&ticks.places.len()), "{:?}", ticks);
            }
        }
    }
}
