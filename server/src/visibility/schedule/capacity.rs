//! Whether a device bears one more session: pure arithmetic over what its sessions cost.
//!
//! A device serves its sessions' rates when the time that they need in a second is within its budget, and when the longest part of a
//! frame, which cannot be interrupted, leaves each of them time for its own before that is due (the test for non-preemptive deadline
//! scheduling of Jeffay, Stanat and Martel 1991, made simple).

use std::fmt;

use super::parts::stretch_ms;

/// Masks a second that a session is planned with which did not say how many it wants: it takes what others leave.
const LEAST_HZ: f64 = 1.0;

/// Share of its rate that an idle session is planned with: most do not wake at once.
const IDLE_SHARE: f64 = 0.1;

/// What a session needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Need {
    /// Device time of a mask, in milliseconds.
    pub cost_ms: f64,
    /// Masks a second that were asked for; none where it takes what it gets.
    pub rate_hz: Option<f64>,
    /// Whether it has asked for a mask of late.
    pub active: bool,
}

impl Need {
    /// Device time in a second, in milliseconds.
    #[must_use]
    pub fn per_second_ms(&self) -> f64 {
        let share = if self.active { 1.0 } else { IDLE_SHARE };
        self.cost_ms * self.rate_hz.unwrap_or(LEAST_HZ) * share
    }
}

/// Why a device does not bear a session more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TooMuch {
    /// There is not enough time.
    Time {
        /// What the session would need in a second, in milliseconds.
        needed_ms: f64,
        /// What is left of the budget.
        left_ms: f64,
    },
    /// Its frames are so long that even a part of one would make another session late.
    LongFrame {
        /// What a frame takes, in milliseconds.
        frame_ms: f64,
        /// What the other sessions bear.
        bearable_ms: f64,
    },
}

impl fmt::Display for TooMuch {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Time { needed_ms, left_ms } => {
                let left_ms = left_ms.max(0.0);
                write!(formatter, "it would need {needed_ms:.1} ms of the device a second, and {left_ms:.1} are left")
            }
            Self::LongFrame { frame_ms, bearable_ms } => {
                let bearable_ms = bearable_ms.max(0.0);
                write!(formatter, "a frame would take {frame_ms:.1} ms, and the other sessions bear {bearable_ms:.1}")
            }
        }
    }
}

/// Whether a device with these sessions and this budget, in milliseconds a second, bears a new one. The first session is always
/// borne: there is nobody whose rate it could break.
///
/// # Errors
/// With what is too much.
pub fn judge(sessions: impl IntoIterator<Item = Need>, new: Need, budget_ms: f64) -> Result<(), TooMuch> {
    let (mut used_ms, mut shortest_ms, mut any) = (0.0, f64::INFINITY, false);
    for session in sessions {
        any = true;
        used_ms += session.per_second_ms();
        if let Some(rate) = session.rate_hz {
            // What is left of its period when its own frame is traced.
            shortest_ms = f64::min(shortest_ms, 1e3 / rate - session.cost_ms);
        }
    }
    if !any {
        return Ok(());
    }
    let needed_ms = new.per_second_ms();
    if used_ms + needed_ms > budget_ms {
        return Err(TooMuch::Time { needed_ms, left_ms: budget_ms - used_ms });
    }
    if stretch_ms(new.cost_ms) > shortest_ms {
        return Err(TooMuch::LongFrame { frame_ms: new.cost_ms, bearable_ms: shortest_ms });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn need(cost_ms: f64, rate_hz: f64) -> Need {
        Need { cost_ms, rate_hz: Some(rate_hz), active: true }
    }

    #[test]
    fn sessions_are_borne_until_the_budget_is_spent() {
        let light = need(0.2, 10.0);
        let mut sessions = vec![need(4.0, 60.0); 2];
        while judge(sessions.iter().copied(), light, 900.0).is_ok() {
            sessions.push(light);
        }
        // 480 ms for the heavy ones, 2 ms for each of the others.
        assert_eq!(sessions.len(), 2 + 210);
        let refused = judge(sessions, light, 900.0).unwrap_err();
        assert!(matches!(refused, TooMuch::Time { .. }) && refused.to_string().contains("2.0 ms"), "{refused}");
    }

    #[test]
    fn a_frame_that_makes_others_late_is_refused_and_the_first_session_never() {
        let modest = need(1.0, 60.0);
        let greedy = Need { cost_ms: 40.0, rate_hz: None, active: true };
        assert_eq!(judge([], Need { cost_ms: 5000.0, ..greedy }, 900.0), Ok(()));
        assert_eq!(judge([modest], greedy, 900.0), Ok(()), "it can be interrupted");
        // The hundredth part of it is longer than a period.
        let refused = judge([modest], Need { cost_ms: 3000.0, ..greedy }, 9000.0).unwrap_err();
        assert!(refused.to_string().contains("3000.0 ms"), "{refused}");
        // Who takes what it gets is no reason to refuse others.
        assert_eq!(judge([greedy], modest, 900.0), Ok(()));
    }

    #[test]
    fn idle_sessions_leave_most_of_their_time() {
        let idle = Need { active: false, ..need(1.0, 60.0) };
        assert_eq!(judge([idle; 100], need(1.0, 60.0), 900.0), Ok(()));
        assert!(judge([Need { active: true, ..idle }; 100], need(1.0, 60.0), 900.0).is_err());
    }

    proptest! {
        /// Whatever is admitted, in any order: after the first one the budget is never overspent by another.
        #[test]
        fn the_budget_holds(asked in prop::collection::vec((0.01_f64..50.0, 1.0_f64..144.0), 1..200)) {
            let mut admitted: Vec<Need> = Vec::new();
            for (cost, rate) in asked {
                if judge(admitted.iter().copied(), need(cost, rate), 900.0).is_ok() {
                    admitted.push(need(cost, rate));
                }
            }
            let (first, others) = admitted.split_first().unwrap();
            let spent: f64 = others.iter().map(Need::per_second_ms).sum();
            prop_assert!(spent == 0.0 || spent + first.per_second_ms() <= 900.0 + 1e-6);
        }
    }
}
