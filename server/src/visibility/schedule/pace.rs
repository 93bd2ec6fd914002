//! Holds a session to the rate that it declared: a token bucket, in masks.
//!
//! Without it, sessions that declare little and ask for much would take the time that others were promised. A mask that
//! must wait costs its client nothing but time: a newer pose replaces the waiting one. A session whose masks had to
//! wait is served in the background for a while (`engine/worker/session.rs`).

use std::time::{Duration, Instant};

use super::capacity::LEAST_HZ;

/// Masks per second that a session may have, in multiples of the rate that it declared. A quarter more, because a
/// screen's rate is not quite its nominal one, and because poses that the network held up arrive faster than they were
/// sent.
pub const TOLERANCE: f64 = 1.25;

/// Masks that a session may have at once after a pause: four that a network held up and delivers together, and two that
/// a client sends early when its frame times vary by half.
pub const BURST: f64 = 6.0;

/// One session's bucket. Pure: time is an argument.
#[derive(Debug)]
pub struct Pace {
    per_second: f64,
    level: f64,
    updated_at: Instant,
}

impl Pace {
    /// A session without a declared rate has its share of [`LEAST_HZ`].
    #[must_use]
    pub fn new(rate_hz: Option<f64>, now: Instant) -> Self {
        let per_second = rate_hz.unwrap_or(LEAST_HZ).max(f64::MIN_POSITIVE) * TOLERANCE;
        Self { per_second, level: BURST, updated_at: now }
    }

    /// Returns how long the next mask must wait; zero if it may begin.
    #[must_use]
    pub fn wait(&self, now: Instant) -> Duration {
        let missing = (1.0 - self.level_at(now)).max(0.0);
        Duration::try_from_secs_f64(missing / self.per_second).unwrap_or(Duration::MAX)
    }

    /// Records that a mask begins.
    pub fn take(&mut self, now: Instant) {
        // May be overdrawn by masks beyond the share, but not for ever.
        self.level = (self.level_at(now) - 1.0).max(0.0);
        self.updated_at = now;
    }

    fn level_at(&self, now: Instant) -> f64 {
        let elapsed = now.saturating_duration_since(self.updated_at);
        self.per_second.mul_add(elapsed.as_secs_f64(), self.level).min(BURST)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Poses at these times, in seconds. Returns the masks that begin, as the engine begins them: at a pose, or when
    /// the newest pose may.
    fn begun(pace: &mut Pace, start: Instant, poses: &[f64]) -> usize {
        let (mut masks, mut waits) = (0, false);
        for (place, pose) in poses.iter().enumerate() {
            let at = start + Duration::from_secs_f64(*pose);
            let next = poses.get(place + 1).map_or(at, |next| start + Duration::from_secs_f64(*next));
            waits |= true;
            let ready = at + pace.wait(at);
            if waits && (ready == at || ready < next) {
                pace.take(ready);
                (masks, waits) = (masks + 1, false);
            }
        }
        masks
    }

    #[test]
    fn a_session_gets_a_little_more_than_it_declared_and_no_more() {
        let start = Instant::now();
        let poses: Vec<f64> = (0..4000).map(|pose| f64::from(pose) * 0.025).collect();
        let masks = begun(&mut Pace::new(Some(1.0), start), start, &poses);
        assert!((125..=132).contains(&masks), "{masks} masks in 100 s for one a second");
        let least = begun(&mut Pace::new(None, start), start, &poses);
        assert_eq!(least, masks, "without a rate it counts as one a second");
        assert_eq!(begun(&mut Pace::new(Some(40.0), start), start, &poses), 4000);
        let idle = Pace::new(Some(1.0), start);
        assert_eq!(idle.wait(start + Duration::from_secs(3600)), Duration::ZERO);
        assert!(idle.level_at(start + Duration::from_secs(3600)) <= BURST, "a pause saves only a burst");
    }

    proptest! {
        /// Frame times of 16.7 ms that vary by 8, and the rest of a stall that arrives in a few milliseconds.
        #[test]
        fn an_honest_client_loses_no_mask(
            jitter_ms in prop::collection::vec(-8.0_f64..8.0, 600),
            stall_at in 0_usize..500,
        ) {
            let start = Instant::now();
            let mut poses: Vec<f64> = (0_u32..).zip(&jitter_ms)
                .map(|(pose, jitter)| (f64::from(pose) * 16.7 + 8.0 + jitter) * 1e-3)
                .collect();
            // The three frames after a stall of 60 ms come at once.
            let (first, late) = (stall_at, poses[stall_at] + 0.06);
            for (place, pose) in poses.iter_mut().enumerate().skip(first).take(4) {
                #[expect(clippy::cast_precision_loss, reason = "at most three")]
                let after = (place - first) as f64;
                *pose = pose.max(late + after * 1e-3);
            }
            poses.sort_by(f64::total_cmp);
            prop_assert_eq!(begun(&mut Pace::new(Some(60.0), start), start, &poses), 600);
        }

        /// However poses arrive, no second has more masks than the rate with its tolerance, and a burst.
        #[test]
        fn no_second_has_more_than_its_rate_and_a_burst(gaps_ms in prop::collection::vec(0.0_f64..60.0, 400)) {
            let start = Instant::now();
            let (mut pace, mut at, mut begun) = (Pace::new(Some(20.0), start), start, Vec::new());
            for gap in gaps_ms {
                at += Duration::from_secs_f64(gap * 1e-3);
                if pace.wait(at).is_zero() {
                    pace.take(at);
                    begun.push(at);
                }
            }
            for (place, from) in begun.iter().enumerate() {
                let within = begun[place..].iter().take_while(|at| **at < *from + Duration::from_secs(1)).count();
                #[expect(clippy::cast_precision_loss, reason = "a few masks")]
                let within = within as f64;
                prop_assert!(within <= 20.0 * TOLERANCE + BURST + 1.0, "{within}");
            }
        }
    }
}
