//! How many parity packets a frame gets.
//!
//! Losses come in runs. The channel is taken for one of two states (Gilbert's): in the good one all packets come, in
//! the bad one none. Two figures that the client can measure say all of it: the share of packets lost, and how long a
//! run of losses is on average. From them follows how likely it is that k of N packets are lost, and so what share of a
//! frame's packets is lost in spite of m parity packets: where k > m, all k of them.

/// Most parity packets that a frame can have.
const MOST: usize = u8::MAX as usize;

/// What remains lost is at most this share of the packets, or a twentieth of the loss if that is more.
const LEAST_RESIDUAL: f64 = 0.0004;

/// A channel's losses.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LossModel {
    /// Share of the packets that is lost, 0 to 1.
    pub loss: f64,
    /// Mean number of packets that are lost one after the other, at least 1.
    pub run: f64,
}

/// Most parity packets for a frame of `packets`, whatever the loss: twice the frame, and a little for small ones, which
/// a run of losses hits whole.
fn most_parity(packets: usize) -> usize {
    (packets * 2 + 4).min(MOST)
}

/// Parity packets for a frame of `packets`: the fewest that leave no more lost than is allowed.
#[must_use]
pub fn parity_packets(model: LossModel, packets: usize) -> u8 {
    let loss = model.loss.clamp(0.0, 0.5);
    if loss == 0.0 || loss.is_nan() || packets == 0 {
        return 0;
    }
    let allowed = (loss / 20.0).max(LEAST_RESIDUAL);
    // Losses each for itself are runs of 1 / (1 − loss).
    let run = model.run.clamp(1.0 / (1.0 - loss), 1000.0);
    let (leave, enter) = (1.0 / run, loss / (run * (1.0 - loss)));
    let most = most_parity(packets);
    // Probability that k packets were lost so far, the last one not, or the last one as well.
    let (mut good, mut bad) = ([0.0; MOST + 1], [0.0; MOST + 2]);
    (good[0], bad[1]) = (1.0 - loss, loss);
    let mut sent = 1;
    for parity in 0..=most {
        while sent < packets + parity {
            // One packet more, from the most losses to none: each k reads what k − 1 was.
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
    fn there_is_none_without_loss_and_more_with_more_of_it() {
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
    fn no_measurement_breaks_it() {
        for loss in [f64::NAN, f64::INFINITY, -f64::INFINITY, 1.0, 1e-300] {
            for run in [f64::NAN, f64::INFINITY, 0.0, -1.0, 1e300] {
                for packets in [0, 1, 512] {
                    assert!(usize::from(parity(loss, run, packets)) <= most_parity(packets), "{loss} {run} {packets}");
                }
            }
        }
    }

    /// The same channel, played: what remains lost is what was allowed.
    #[test]
    fn what_remains_lost_is_what_was_allowed() {
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
