//! What a client says beside its poses: which masks it has, and how many packets it misses.

use std::time::Instant;

use gnomon_protocol::{
    acknowledgement::Acknowledgement,
    loss::{LossEstimate, LossFeedback},
};
use tokio::sync::watch;

use crate::metrics::ledger::Ledger;

/// The newest of both.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Heard {
    /// The newest mask that it has.
    pub(super) acknowledged: Option<Acknowledgement>,
    /// What its packets fare like.
    pub(super) losses: LossEstimate,
}

/// Takes a datagram that says something of masks or packets, and tells whether it is one.
pub(super) fn hear(datagram: &[u8], now: Instant, heard: &watch::Sender<Heard>, ledger: &Ledger) -> bool {
    if let Ok(acknowledgement) = Acknowledgement::decode(datagram) {
        ledger.acknowledgements.one();
        heard.send_if_modified(|heard| {
            let newer = heard.acknowledged.is_none_or(|newest| acknowledgement.is_after(&newest));
            if newer {
                heard.acknowledged = Some(acknowledgement);
            }
            newer
        });
        return true;
    }
    let Ok(feedback) = LossFeedback::decode(datagram) else { return false };
    ledger.acknowledgements.one();
    heard.send_modify(|heard| heard.losses.hear(now, feedback));
    true
}
