//! How many parity packets a frame gets.
//!
//! Losses come in bursts. The channel is modelled with two states (Gilbert): all packets arrive in the good one, and
//! none in the bad one. The client measures its two parameters: the share of packets lost, and the mean length of a
//! burst. They give the probability that k of N packets are lost, and so the share of packets that stays lost with m
//! parity packets: all k where k > m.

/// Most parity packets of a frame.
const MOST: usize = u8::MAX as usize;

/// Loss that may remain: this share of the packets, or a twentieth of the measured loss if that is more.
const LEAST_RESIDUAL: f64 = 0.0004;

/// Loss of a channel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LossModel {
    /// Share of packets lost, 0 to 1.
    pub loss: f64,
    /// Mean number of consecutive packets lost, at least 1.
    pub run: f64,
}

/// Most parity packets for a frame of `packets`, whatever the loss: twice the frame, and a few more because a burst can
/// hit the whole of a small one.
fn most_parity(packets: usize) -> usize {
    (packets * 2 + 4).min(MOST)
}

/// Returns the fewest parity packets that keep the remaining loss of a frame of `packets` within its limit.
#[must_use]
pub fn parity_packets(model: LossModel, packets: usize) -> u8 {
    let loss = model.loss.clamp(0.0, 0.5);
    if loss == 0.0 || loss.is_nan() || packets == 0 {
        return 0;
    }
    let allowed = (loss / 20.0).max(LEAST_RESIDUAL);
    // Independent losses have a mean run of 1 / (1 − loss).
    let run = model.run.clamp(1.0 / (1.0 - loss), 1000.0);
    let (leave, enter) = (1.0 / run, loss / (run * (1.0 - loss)));
    let most = most_parity(packets);
    // Probability that k packets were lost so far, with the last one arrived (good) or lost (bad).
    let (mut good, mut bad) = ([0.0; MOST + 1], [0.0; MOST + 2]);
    (good[0], bad[1]) = (1.0 - loss, loss);
    let mut sent = 1;
    for parity in 0..=most {
        while sent < packets + parity {
            // Adds one packet. k descends, because each k reads the old k − 1.
            for lost in (0..=most).rev() {
                let (was_good, was_bad) = (good[lost], bad[lost]);
                bad[lost + 1] = was_good * enter + was_bad * (1.0 - leave);
                good[lost] = was_good * (1.0 - enter) + was_bad * leave;
            }
            bad[0] = 0.0;
            sent += 1;
        }
        #[expect(clippy::cast_precision_loss, reason = "at most 767 packets")]
        let mended = (0..=parity).map(|lost| lost as f64 * (good[lost] + bad[lost])).sum::<f64>() / sent as f64;
        if loss - mended <= allowed {
            return u8::try_from(parity).unwrap_or(u8::MAX);
        }
    }
    u8::try_from(most).unwrap_or(u8::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parity(loss: f64, run: f64, packets: usize) -> u8 {
        parity_packets(LossModel { loss, run }, packets)
    }

    #[test]
    fn parity_is_zero_without_loss_and_grows_with_it() {
        assert_eq!(parity(0.0, 1.0, 20), 0);
        assert_eq!(parity(-1.0, f64::NAN, 20), 0);
        for packets in [1, 2, 10, 20, 100, 500] {
            let shares = [0.001, 0.01, 0.03, 0.05, 0.2].map(|loss| parity(loss, 1.0, packets));
            assert!(shares.is_sorted() && shares[0] >= 1, "{packets}: {shares:?}");
            assert!(usize::from(shares[4]) <= most_parity(packets));
            assert!(parity(0.01, 8.0, packets) >= parity(0.01, 1.0, packets), "{packets}");
        }
        // Larger frames need a smaller share.
        assert!(parity(0.01, 1.0, 100) < 10 * parity(0.01, 1.0, 10));
    }

    #[test]
    fn any_measurement_is_accepted() {
        for loss in [f64::NAN, f64::INFINITY, -f64::INFINITY, 1.0, 1e-300] {
            for run in [f64::NAN, f64::INFINITY, 0.0, -1.0, 1e300] {
                for packets in [0, 1, 512] {
                    assert!(usize::from(parity(loss, run, packets)) <= most_parity(packets), "{loss} {run} {packets}");
                }
            }
        }
    }

    #[test]
    fn the_remaining_loss_is_the_allowed_one() {
        let mut state = 1_u64;
        let mut unit = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            f64::from(u32::try_from(state >> 32).unwrap()) / f64::from(u32::MAX)
        };
        for (loss, run, packets) in [(0.01, 1.0, 10), (0.05, 1.0, 20), (0.03, 3.0, 40)] {
            let count = usize::from(parity(loss, run, packets)) + packets;
            let (mut bad, mut remaining, mut all) = (false, 0, 0);
            let run = f64::max(run, 1.0 / (1.0 - loss));
            for _ in 0..40_000 {
                let mut lost = 0;
                for _ in 0..count {
                    bad = unit() < if bad { 1.0 - 1.0 / run } else { loss / (run * (1.0 - loss)) };
                    lost += usize::from(bad);
                }
                all += count;
                remaining += if lost > count - packets { lost } else { 0 };
            }
            #[expect(clippy::cast_precision_loss, reason = "millions")]
            let residual = remaining as f64 / all as f64;
            assert!(residual < 1.3 * (loss / 20.0).max(LEAST_RESIDUAL), "{loss} {run} {packets}: {residual}");
        }
    }
}
