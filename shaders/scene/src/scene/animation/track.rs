//! Values over time: keys, and what lies between them (glTF 2.0, §3.11 and appendix C). Everything is computed in f64.

use glam::{DQuat, DVec4};
use serde::{Deserialize, Serialize};

/// Quaternions closer than this, in radians, are mixed in a straight line: their sine would have no digits left.
const STRAIGHT_RAD: f64 = 1e-9;

/// The values of one property. There is at least one key.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Track {
    /// Length of a round, in seconds. Time starts anew after it; with 0 it stands still.
    pub period_s: f64,
    pub interpolation: Interpolation,
    /// Times of the keys. Never descending; of equal ones, the last counts from that time on.
    pub times_s: Vec<f32>,
    /// Components of the keys' values, key by key. CUBICSPLINE has in-tangent, value and out-tangent of each key.
    pub values: Vec<f32>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Interpolation {
    Step,
    /// Spherical for rotations.
    Linear,
    CubicSpline,
}

impl Interpolation {
    /// Elements of a key: the value, and perhaps its tangents.
    pub(crate) fn elements(self) -> usize {
        match self {
            Self::Step | Self::Linear => 1,
            Self::CubicSpline => 3,
        }
    }
}

/// Where a time lies among the keys.
#[derive(Clone, Copy)]
enum Time {
    /// At a key, or before the first or after the last one.
    At(usize),
    Between {
        /// The key before.
        key: usize,
        /// Way to the next key, 0 to 1.
        share: f64,
        /// Time from key to key.
        step_s: f64,
    },
}

impl Track {
    /// Returns the value at a time, which may be any number. Values that are missing count as 0.
    #[must_use]
    pub fn sample<const N: usize>(&self, time_s: f64) -> [f64; N] {
        match self.find(time_s) {
            Time::At(key) => self.value(key),
            Time::Between { key, share, step_s } => match self.interpolation {
                Interpolation::Step => self.value(key),
                Interpolation::Linear => {
                    let (from, to) = (self.value::<N>(key), self.value::<N>(key + 1));
                    std::array::from_fn(|i| from[i] * (1.0 - share) + to[i] * share)
                }
                Interpolation::CubicSpline => self.spline(key, share, step_s),
            },
        }
    }

    /// Returns the first components of the value at a time, as many as there are in `value`.
    pub(crate) fn sample_into(&self, time_s: f64, value: &mut [f64]) {
        let (time, width) = (self.find(time_s), value.len());
        for (at, component) in value.iter_mut().enumerate() {
            let element = |number: usize| self.component(number, width, at);
            *component = match time {
                Time::At(key) => element(self.value_of(key)),
                Time::Between { key, share, step_s } => match self.interpolation {
                    Interpolation::Step => element(key),
                    Interpolation::Linear => element(key) * (1.0 - share) + element(key + 1) * share,
                    Interpolation::CubicSpline => hermite([1, 2, 3, 4].map(|n| element(3 * key + n)), share, step_s),
                },
            };
        }
    }

    /// Returns the value as a rotation. Values without a length count as no rotation.
    #[must_use]
    pub fn rotation(&self, time_s: f64) -> DQuat {
        match self.find(time_s) {
            Time::Between { key, share, .. } if self.interpolation == Interpolation::Linear => {
                slerp(unit(self.value(key)), unit(self.value(key + 1)), share)
            }
            _ => unit(self.sample(time_s)),
        }
    }

    /// Returns whether the value never changes.
    pub(crate) fn is_constant(&self, width: usize) -> bool {
        let elements = self.interpolation.elements();
        let keys = self.values.chunks_exact(width * elements);
        let value =
            |key: &[f32]| if elements == 3 { key.get(width..2 * width) } else { key.get(..width) }.map(<[_]>::to_vec);
        let first = self.values.get(..width * elements).and_then(value);
        let flat = |key: &[f32]| {
            elements == 1 || key.iter().take(width).chain(key.iter().skip(2 * width)).all(|tangent| *tangent == 0.0)
        };
        let single = self.times_s.len() == 1;
        self.period_s == 0.0 || single || keys.into_iter().all(|key| value(key) == first && flat(key))
    }

    fn find(&self, time_s: f64) -> Time {
        let time_s = if self.period_s > 0.0 { time_s.rem_euclid(self.period_s) } else { 0.0 };
        let after = self.times_s.partition_point(|key| f64::from(*key) <= time_s);
        let (Some(key), Some(end_s)) = (after.checked_sub(1), self.times_s.get(after)) else {
            return Time::At(after.saturating_sub(1));
        };
        let start_s = self.times_s.get(key).copied().map_or(0.0, f64::from);
        // Above 0: the next key is later than the time, and this one is not.
        let step_s = f64::from(*end_s) - start_s;
        Time::Between { key, share: (time_s - start_s) / step_s, step_s }
    }

    fn value<const N: usize>(&self, key: usize) -> [f64; N] {
        self.element(self.value_of(key))
    }

    /// The number of the element that is a key's value.
    fn value_of(&self, key: usize) -> usize {
        match self.interpolation {
            Interpolation::Step | Interpolation::Linear => key,
            Interpolation::CubicSpline => 3 * key + 1,
        }
    }

    fn element<const N: usize>(&self, number: usize) -> [f64; N] {
        std::array::from_fn(|at| self.component(number, N, at))
    }

    fn component(&self, element: usize, width: usize, at: usize) -> f64 {
        self.values.get(element * width + at).copied().map_or(0.0, f64::from)
    }

    fn spline<const N: usize>(&self, key: usize, share: f64, step_s: f64) -> [f64; N] {
        let elements = [1, 2, 3, 4].map(|element| self.element::<N>(3 * key + element));
        std::array::from_fn(|i| hermite(elements.map(|element| element[i]), share, step_s))
    }
}

/// A Hermite spline from a value and its out-tangent to the next in-tangent and value. Tangents are per second, so that
/// they count times the step.
fn hermite([from, out, into, to]: [f64; 4], share: f64, step_s: f64) -> f64 {
    let (squared, cubed) = (share * share, share * share * share);
    (2.0 * cubed - 3.0 * squared + 1.0) * from
        + step_s * (cubed - 2.0 * squared + share) * out
        + (3.0 * squared - 2.0 * cubed) * to
        + step_s * (cubed - squared) * into
}

fn unit(value: [f64; 4]) -> DQuat {
    DVec4::from_array(value).try_normalize().map_or(DQuat::IDENTITY, DQuat::from_vec4)
}

/// Returns the rotation on the short way between two unit quaternions.
fn slerp(from: DQuat, to: DQuat, share: f64) -> DQuat {
    let to = if from.dot(to) < 0.0 { -to } else { to };
    // Exact for small angles too, where the cosine is not.
    let angle = 2.0 * (to - from).length().atan2((to + from).length());
    if angle < STRAIGHT_RAD {
        return (from * (1.0 - share) + to * share).normalize();
    }
    (from * ((1.0 - share) * angle).sin() + to * (share * angle).sin()).normalize()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_1_SQRT_2, PI};

    use super::*;

    fn track(interpolation: Interpolation, times_s: &[f32], values: &[f32]) -> Track {
        let period_s = times_s.last().copied().map_or(0.0, f64::from);
        Track { period_s, interpolation, times_s: times_s.to_vec(), values: values.to_vec() }
    }

    fn at(track: &Track, time_s: f64) -> f64 {
        track.sample::<1>(time_s)[0]
    }

    #[test]
    fn steps_hold_and_lines_run_between_keys() {
        let step = track(Interpolation::Step, &[1.0, 2.0, 4.0], &[10.0, 20.0, 40.0]);
        let line = Track { interpolation: Interpolation::Linear, ..step.clone() };
        // Before the first key, at keys, and between them.
        for (time_s, held, between) in [
            (0.0, 10.0, 10.0),
            (0.5, 10.0, 10.0),
            (1.0, 10.0, 10.0),
            (1.5, 10.0, 15.0),
            (2.0, 20.0, 20.0),
            (3.0, 20.0, 30.0),
        ] {
            assert_eq!((at(&step, time_s), at(&line, time_s)), (held, between), "{time_s}");
        }
        // Rounds of 4 s, in both directions.
        assert_eq!([at(&line, 7.0), at(&line, -1.0), at(&line, 4e6 + 3.0)], [30.0; 3]);
        // The last key lies at the end of the round, where the next one begins; a longer round holds it.
        assert_eq!(at(&line, 4.0), 10.0);
        let longer = Track { period_s: 6.0, ..line };
        assert_eq!([at(&longer, 4.0), at(&longer, 5.9), at(&longer, 6.0)], [40.0, 40.0, 10.0]);
    }

    #[test]
    fn one_key_holds_and_equal_times_jump() {
        for interpolation in [Interpolation::Step, Interpolation::Linear] {
            let one = track(interpolation, &[0.5], &[7.0]);
            assert_eq!([-3.0, 0.0, 0.5, 99.0].map(|time_s| at(&one, time_s)), [7.0; 4]);
        }
        let spline = track(Interpolation::CubicSpline, &[0.5], &[1.0, 7.0, 1.0]);
        assert_eq!([0.0, 0.5, 99.0].map(|time_s| at(&spline, time_s)), [7.0; 3]);
        let jump = track(Interpolation::Linear, &[0.0, 1.0, 1.0, 2.0], &[0.0, 1.0, 5.0, 6.0]);
        assert_eq!([0.5, 1.0, 1.5].map(|time_s| at(&jump, time_s)), [0.5, 5.0, 5.5]);
        let still = Track { period_s: 0.0, ..jump };
        assert_eq!(at(&still, 1.5), 0.0);
    }

    #[test]
    fn splines_follow_the_specifications_formula_with_tangents_per_second() {
        // From 1 to 3 within 2 s; leaves at 4 per second, arrives at −1 per second.
        let spline = track(Interpolation::CubicSpline, &[1.0, 3.0], &[9.0, 1.0, 4.0, -1.0, 3.0, 9.0]);
        assert_eq!(at(&spline, 1.0), 1.0);
        // At the middle: ½·1 + 2·⅛·4 + ½·3 − 2·⅛·(−1) = 3.25.
        assert_eq!(at(&spline, 2.0), 3.25);
        // At a quarter: 27/32·1 + 2·9/64·4 + 5/32·3 − 2·3/64·(−1).
        assert!((at(&spline, 1.5) - (27.0 / 32.0 + 9.0 / 8.0 + 15.0 / 32.0 + 3.0 / 32.0)).abs() < 1e-15);
        let slope = (at(&spline, 1.0 + 1e-6) - at(&spline, 1.0)) / 1e-6;
        assert!((slope - 4.0).abs() < 1e-4, "{slope}");
        let twice = track(Interpolation::CubicSpline, &[1.0, 3.0], &[0.0, 1.0, 0.0, 0.0, 1.0, 0.0]);
        assert!(twice.is_constant(1) && !spline.is_constant(1));
    }

    #[test]
    fn rotations_take_the_short_way_at_a_steady_rate() {
        let about_z = |turn: f64| DQuat::from_rotation_z(turn).as_quat().to_array();
        let turning =
            |from: f64, to: [f32; 4]| track(Interpolation::Linear, &[0.0, 1.0], &[about_z(from), to].concat());
        let quarter = turning(0.0, about_z(PI / 2.0));
        for share in [0.0, 0.25, 0.5, 0.75] {
            let apart = quarter.rotation(share).angle_between(DQuat::from_rotation_z(share * PI / 2.0));
            assert!(apart < 1e-7, "{share}: {apart} rad");
        }
        // The same rotation by the opposite quaternion.
        let opposite = turning(0.0, about_z(PI / 2.0).map(|v| -v));
        assert!(opposite.rotation(0.5).angle_between(quarter.rotation(0.5)) < 1e-7);
        // From −160° to 160° it passes 180°, not 0°.
        let through = turning(-160_f64.to_radians(), about_z(160_f64.to_radians()));
        assert!(through.rotation(0.5).angle_between(DQuat::from_rotation_z(PI)) < 1e-6);
        // Nearly equal ones, where the cosine of the angle rounds to 1.
        let little = turning(0.0, [0.0, 0.0, 1e-10, 1.0]);
        assert!((little.rotation(0.5).z - 0.5e-10).abs() < 1e-16);
        // A quantised quaternion is normalised; one without a length is none.
        let rough = track(Interpolation::Step, &[0.0], &[0.0, 0.0, 0.5, 0.5]);
        assert!((rough.rotation(0.0).z - FRAC_1_SQRT_2).abs() < 1e-15);
        assert_eq!(track(Interpolation::Linear, &[0.0], &[0.0; 4]).rotation(0.0), DQuat::IDENTITY);
        let spline = [[0.0; 4], about_z(0.0), [0.0; 4], [0.0; 4], about_z(PI / 2.0), [0.0; 4]].concat();
        let spline = track(Interpolation::CubicSpline, &[0.0, 1.0], &spline);
        assert!(spline.rotation(0.5).angle_between(DQuat::from_rotation_z(PI / 4.0)) < 1e-7);
    }

    #[test]
    fn what_never_changes_is_constant() {
        let constant = |values: &[f32]| track(Interpolation::Linear, &[0.0, 1.0], values).is_constant(values.len() / 2);
        assert!(constant(&[1.0, 2.0, 1.0, 2.0]) && !constant(&[1.0, 2.0, 1.0, 3.0]));
        // Equal values with tangents swing.
        assert!(!track(Interpolation::CubicSpline, &[0.0, 1.0], &[0.0, 1.0, 1.0, 0.0, 1.0, 0.0]).is_constant(1));
    }

    #[test]
    fn any_time_gives_a_finite_value() {
        let line = track(Interpolation::Linear, &[0.0, 1e-38, 3.4e38], &[0.0, 1.0, 2.0]);
        for time_s in [f64::MAX, -f64::MAX, 1e-300, -1e-300, f64::MIN_POSITIVE, 1e308] {
            assert!(at(&line, time_s).is_finite(), "{time_s}");
        }
    }
}
