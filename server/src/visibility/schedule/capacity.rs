//! Admission: decides from measured costs whether a device can serve one more session. Pure arithmetic.
//!
//! A device serves its sessions' rates if two things hold. First, they need no more time per second than its budget.
//! Second, the longest part of a frame, which cannot be interrupted, leaves each session time for its own mask before
//! it is due: a simplified test for non-preemptive deadline scheduling (Jeffay, Stanat and Martel 1991).

use std::fmt;

use super::parts::blocking_ms;

/// Planned rate of a session without a requested rate, in masks per second. It takes what the others leave.
pub(crate) const LEAST_HZ: f64 = 1.0;

/// Share of its rate planned for an idle session: most idle sessions do not wake at the same time.
pub(crate) const IDLE_SHARE: f64 = 0.1;

/// A session's need of device time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Need {
    /// Device time of a mask, in milliseconds.
    pub cost_ms: f64,
    /// Masks per second: measured, or declared by a session that is new or idle. `None`: best effort.
    pub rate_hz: Option<f64>,
    /// True if it has requested a mask recently.
    pub active: bool,
}

impl Need {
    /// Device time per second, in milliseconds.
    #[must_use]
    pub fn per_second_ms(&self) -> f64 {
        let share = if self.active { 1.0 } else { IDLE_SHARE };
        self.cost_ms * self.rate_hz.unwrap_or(LEAST_HZ) * share
    }
}

/// Why a device cannot serve another session.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Overload {
    /// The session needs more device time per second than the budget leaves.
    Time { needed_ms: f64, left_ms: f64 },
    /// Even one part of its frame would make another session late. The others tolerate frames of `tolerated_ms`.
    LongFrame { frame_ms: f64, tolerated_ms: f64 },
}

impl fmt::Display for Overload {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Time { needed_ms, left_ms } => {
                let left_ms = left_ms.max(0.0);
                write!(formatter, "it would need {needed_ms:.1} ms of the device per second, and {left_ms:.1} are left")
            }
            Self::LongFrame { frame_ms, tolerated_ms } => write!(
                formatter,
                "a frame would take {frame_ms:.1} ms, and the other sessions tolerate {tolerated_ms:.1}"
            ),
        }
    }
}

/// Admits a new session beside `sessions` on a device with this budget, in milliseconds per second. The first session
/// is always admitted: it cannot make another one late.
///
/// # Errors
/// If the device cannot serve it beside the others.
pub fn admit(sessions: impl IntoIterator<Item = Need>, new: Need, budget_ms: f64) -> Result<(), Overload> {
    let (mut used_ms, mut shortest_ms, mut any) = (0.0, f64::INFINITY, false);
    for session in sessions {
        any = true;
        used_ms += session.per_second_ms();
        if let Some(rate) = session.rate_hz {
            // What its period leaves after its own frame. One that is late alone is not made late by others.
            let left_ms = 1e3 / rate - session.cost_ms;
            shortest_ms = f64::min(shortest_ms, if left_ms > 0.0 { left_ms } else { f64::INFINITY });
        }
    }
    if !any {
        return Ok(());
    }
    let needed_ms = new.per_second_ms();
    if used_ms + needed_ms > budget_ms {
        return Err(Overload::Time { needed_ms, left_ms: budget_ms - used_ms });
    }
    if blocking_ms(new.cost_ms) > shortest_ms {
        return Err(Overload::LongFrame { frame_ms: new.cost_ms, tolerated_ms: shortest_ms });
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
    fn sessions_are_admitted_until_the_budget_is_spent() {
        let light = need(0.2, 10.0);
        let mut sessions = vec![need(4.0, 60.0); 2];
        while admit(sessions.iter().copied(), light, 900.0).is_ok() {
            sessions.push(light);
        }
        // 480 ms for the heavy ones, 2 ms for each other one.
        assert_eq!(sessions.len(), 2 + 210);
        let refused = admit(sessions, light, 900.0).unwrap_err();
        assert!(matches!(refused, Overload::Time { .. }) && refused.to_string().contains("2.0 ms"), "{refused}");
    }

    #[test]
    fn a_frame_that_makes_others_late_is_refused_and_the_first_session_never() {
        let modest = need(1.0, 60.0);
        let greedy = Need { cost_ms: 40.0, rate_hz: None, active: true };
        assert_eq!(admit([], Need { cost_ms: 5000.0, ..greedy }, 900.0), Ok(()));
        assert_eq!(admit([modest], greedy, 900.0), Ok(()), "it can be interrupted");
        // A hundredth of it is longer than a period.
        let refused = admit([modest], Need { cost_ms: 3000.0, ..greedy }, 9000.0).unwrap_err();
        assert!(refused.to_string().contains("3000.0 ms"), "{refused}");
        // A session without a rate is no reason to refuse others.
        assert_eq!(admit([greedy], modest, 900.0), Ok(()));
        // Nor is one whose frame takes longer than its period, as long as there is time.
        assert_eq!(admit([need(30.0, 40.0)], modest, 9000.0), Ok(()));
    }

    #[test]
    fn idle_sessions_leave_most_of_their_time() {
        let idle = Need { active: false, ..need(1.0, 60.0) };
        assert_eq!(admit([idle; 100], need(1.0, 60.0), 900.0), Ok(()));
        assert!(admit([Need { active: true, ..idle }; 100], need(1.0, 60.0), 900.0).is_err());
    }

    proptest! {
        /// Whatever is admitted, in any order, no session after the first overspends the budget.
        #[test]
        fn the_budget_holds(asked in prop::collection::vec((0.01_f64..50.0, 1.0_f64..144.0), 1..200)) {
            let mut admitted: Vec<Need> = Vec::new();
            for (cost, rate) in asked {
                if admit(admitted.iter().copied(), need(cost, rate), 900.0).is_ok() {
                    admitted.push(need(cost, rate));
                }
            }
            let (first, others) = admitted.split_first().unwrap();
            let spent: f64 = others.iter().map(Need::per_second_ms).sum();
            prop_assert!(spent == 0.0 || spent + first.per_second_ms() <= 900.0 + 1e-6);
        }
    }
}
