//! Decides which pose is drawn and how much received visibility counts: a state machine that hides the network
//! (dissertation §3.6).
//!
//! | state | drawn from | lit with |
//! |---|---|---|
//! | sequential | the pose that requested the newest mask | that mask, exactly |
//! | concurrent | the newest pose | the newest mask, predicted |
//! | degraded | the newest pose | the client's own prediction, faded in |
//!
//! The weight of received visibility changes by at most one full fade per [`Thresholds::fade_s`].

use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// Sequential while masks arrive.
    Sequential,
    /// Concurrent while masks arrive.
    Concurrent,
    /// Sequential while masks are almost on time, concurrent otherwise.
    #[default]
    Auto,
}

impl fmt::Display for Mode {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Sequential => "sequential",
            Self::Concurrent => "concurrent",
            Self::Auto => "auto",
        })
    }
}

impl FromStr for Mode {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "sequential" => Ok(Self::Sequential),
            "concurrent" => Ok(Self::Concurrent),
            "auto" => Ok(Self::Auto),
            _ => Err(format!("unknown mode {text:?}: use sequential, concurrent or auto")),
        }
    }
}

/// When the state changes. Lags without a unit are in client frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thresholds {
    /// The largest lag that is sequential in [`Mode::Auto`]; 0 disables it. The dissertation has 2. Ours is 0: at a lag
    /// of 1 or 2, prediction by surface is wrong in a few tenths of a per cent of the bits, and in return the newest
    /// input is shown one or two frames earlier.
    pub sequential_lag: u32,
    /// Consecutive frames with such a lag before sequential begins again.
    pub calm_frames: u32,
    /// The largest age of a mask that is predicted over, in s: how far the camera has moved on depends on time, not on
    /// frames. The dissertation has 50 frames, at 60 frames/s 0.8 s. Ours is that of 100: on Sponza without leaves,
    /// prediction is then wrong in 0.48 % of the bits, and at 200 in 0.98 %; the client's own prediction is wrong in
    /// about 0.9 %.
    pub prediction_lag_s: f64,
    /// Duration of a fade from full received visibility to none.
    pub fade_s: f64,
}

/// Lag that is never too late: so late are the masks of a client that draws too slowly for any network.
const SLOW_DRAWING_LAG: u32 = 2;

impl Default for Thresholds {
    fn default() -> Self {
        Self { sequential_lag: 0, calm_frames: 10, prediction_lag_s: 1.7, fade_s: 0.25 }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Draws the newest mask's own frame.
    Sequential,
    /// Draws the newest pose with predicted visibility.
    Concurrent,
    /// Masks are too late or absent: draws the newest pose with the client's own prediction.
    Degraded,
}

/// What changed since the previous frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// This frame's number minus that of the newest mask's frame; `None` if there is no mask.
    pub lag: Option<u32>,
    /// The same in s; 0 if there is no mask.
    pub age_s: f64,
    /// True if the camera jumped since the newest mask's frame, so no visibility can be carried over.
    pub jumped: bool,
    /// Time since the previous frame.
    pub step_s: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decision {
    /// For statistics and logs.
    pub state: State,
    /// Weight of received visibility, 0 to 1.
    pub visibility_share: f32,
}

#[derive(Debug, Clone)]
pub struct ModeMachine {
    mode: Mode,
    thresholds: Thresholds,
    state: State,
    calm_frames: u32,
    share: f64,
}

impl ModeMachine {
    /// Starts degraded: there is no mask yet.
    #[must_use]
    pub fn new(mode: Mode, thresholds: Thresholds) -> Self {
        Self { mode, thresholds, state: State::Degraded, calm_frames: 0, share: 0.0 }
    }

    /// Changes the mode. A fade in progress continues.
    pub fn set_mode(&mut self, mode: Mode) {
        self.mode = mode;
        self.calm_frames = 0;
    }

    /// Lets masks count fully from the next frame on: before a first picture there is nothing to fade from.
    pub fn skip_fade(&mut self) {
        self.share = 1.0;
    }

    /// Advances by one frame.
    pub fn step(&mut self, seen: Observation) -> Decision {
        let Thresholds { sequential_lag, calm_frames, prediction_lag_s, fade_s } = self.thresholds;
        let calm = seen.lag.is_some_and(|lag| lag <= sequential_lag);
        self.calm_frames = if calm { self.calm_frames.saturating_add(1) } else { 0 };
        // The dissertation's 2 frames also apply after a jump: wait for a new mask, but with a limit.
        let waits_for_jump = seen.jumped && sequential_lag > 0 && seen.lag.is_some_and(|lag| lag <= 6 * sequential_lag);
        self.state = match (seen.lag, self.mode) {
            (None, _) => State::Degraded,
            (Some(lag), _) if lag > SLOW_DRAWING_LAG && seen.age_s > prediction_lag_s => State::Degraded,
            (Some(_), Mode::Sequential) => State::Sequential,
            (Some(_), Mode::Concurrent) => State::Concurrent,
            (Some(_), Mode::Auto) if waits_for_jump => State::Sequential,
            (Some(_), Mode::Auto) => match self.state {
                State::Sequential if calm => State::Sequential,
                _ if sequential_lag > 0 && self.calm_frames >= calm_frames => State::Sequential,
                _ => State::Concurrent,
            },
        };
        let wanted = if self.state == State::Degraded { 0.0 } else { 1.0 };
        let most = if fade_s > 0.0 { (seen.step_s / fade_s).clamp(0.0, 1.0) } else { 1.0 };
        self.share += (wanted - self.share).clamp(-most, most);
        #[expect(clippy::cast_possible_truncation, reason = "a share; its digits do not matter")]
        let visibility_share = self.share as f32;
        Decision { state: self.state, visibility_share }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_S: f64 = 1.0 / 60.0;

    fn seen(lag: Option<u32>, jumped: bool) -> Observation {
        Observation { lag, age_s: lag.map_or(0.0, |lag| f64::from(lag) * STEP_S), jumped, step_s: STEP_S }
    }

    fn dissertation() -> Thresholds {
        Thresholds { sequential_lag: 2, prediction_lag_s: 50.5 * STEP_S, ..Thresholds::default() }
    }

    #[test]
    fn states_follow_the_table() {
        use State::{Concurrent, Degraded, Sequential};
        // Lag, jump, number of such frames, state after them.
        let automatic: &[(Option<u32>, bool, u32, State)] = &[
            (None, false, 100, Degraded),
            (Some(2), false, 1, Concurrent),
            (Some(2), false, 8, Concurrent),
            (Some(2), false, 1, Sequential),
            (Some(0), false, 100, Sequential),
            (Some(3), false, 1, Concurrent),
            (Some(2), false, 9, Concurrent),
            (Some(3), false, 1, Concurrent),
            (Some(1), false, 9, Concurrent),
            (Some(1), false, 1, Sequential),
            (Some(50), false, 1, Concurrent),
            (Some(51), false, 1, Degraded),
            (Some(500), false, 50, Degraded),
            (Some(50), false, 1, Concurrent),
            (Some(10), false, 1, Concurrent),
            (Some(10), true, 1, Sequential),
            (Some(12), true, 1, Sequential),
            (Some(13), true, 1, Concurrent),
            (Some(4), false, 1, Concurrent),
            (None, false, 1, Degraded),
        ];
        let ours: &[(Option<u32>, bool, u32, State)] = &[
            (Some(0), false, 100, Concurrent),
            (Some(2), true, 1, Concurrent),
            (Some(101), false, 1, Concurrent),
            (Some(103), false, 1, Degraded),
            (Some(1), false, 1, Concurrent),
        ];
        let sequential: &[(Option<u32>, bool, u32, State)] =
            &[(Some(40), false, 1, Sequential), (Some(51), false, 1, Degraded), (Some(0), false, 1, Sequential)];
        let concurrent: &[(Option<u32>, bool, u32, State)] =
            &[(Some(0), true, 99, Concurrent), (Some(51), false, 1, Degraded), (Some(50), false, 1, Concurrent)];
        for (mode, thresholds, rows) in [
            (Mode::Auto, dissertation(), automatic),
            (Mode::Auto, Thresholds::default(), ours),
            (Mode::Sequential, dissertation(), sequential),
            (Mode::Concurrent, dissertation(), concurrent),
        ] {
            let mut machine = ModeMachine::new(mode, thresholds);
            for (row, (lag, jumped, frames, state)) in rows.iter().enumerate() {
                let mut found = Degraded;
                for _ in 0..*frames {
                    found = machine.step(seen(*lag, *jumped)).state;
                }
                assert_eq!(found, *state, "{mode:?}, row {row}");
            }
        }
    }

    #[test]
    fn masks_are_too_late_by_their_time_and_not_by_their_frames() {
        for (lag, age_s, state) in [
            // A thousand frames a second, 0.4 s late.
            (400, 0.4, State::Concurrent),
            (1700, 1.7, State::Concurrent),
            (1701, 1.701, State::Degraded),
            (3, 1.8, State::Degraded),
            // A frame every four seconds: no mask can be newer.
            (2, 8.0, State::Concurrent),
        ] {
            let mut machine = ModeMachine::new(Mode::Auto, Thresholds::default());
            let decision = machine.step(Observation { lag: Some(lag), age_s, jumped: false, step_s: STEP_S });
            assert_eq!(decision.state, state, "{lag} frames, {age_s} s");
        }
    }

    #[test]
    fn the_share_fades_without_jumps() {
        let mut machine = ModeMachine::new(Mode::Auto, Thresholds::default());
        let mut shares = vec![0.0];
        let lags =
            (0..30).map(|_| Some(3)).chain((103..172).map(Some)).chain((0..30).map(|_| Some(4))).chain([None; 30]);
        for lag in lags {
            shares.push(machine.step(seen(lag, false)).visibility_share);
        }
        let most = STEP_S / 0.25 + 1e-6;
        assert!(shares.windows(2).all(|pair| f64::from(pair[1] - pair[0]).abs() <= most), "{shares:?}");
        assert_eq!((shares[30], shares[99], shares[129], shares[159]), (1.0, 0.0, 1.0, 0.0));
        // The first mask after an outage counts at once, though not fully.
        assert!(shares[100] > 0.0);
    }

    #[test]
    fn a_fade_of_zero_duration_switches_at_once() {
        let mut machine = ModeMachine::new(Mode::Auto, Thresholds { fade_s: 0.0, ..Thresholds::default() });
        assert_eq!(machine.step(seen(Some(1), false)).visibility_share, 1.0);
        assert_eq!(machine.step(seen(None, false)).visibility_share, 0.0);
    }
}
