//! Client feedback: which masks it has, and how many packets it misses.

use std::time::Instant;

use gnomon_protocol::{
    acknowledgement::Acknowledgement,
    loss::{LossEstimate, LossFeedback},
};
use tokio::sync::watch;

use crate::metrics::ledger::Ledger;

#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Feedback {
    /// The newest mask that the client has.
    pub(super) acknowledged: Option<Acknowledgement>,
    pub(super) losses: LossEstimate,
}

/// Handles a datagram if it is feedback. Returns whether it was.
pub(super) fn receive_feedback(
    datagram: &[u8],
    now: Instant,
    feedback: &watch::Sender<Feedback>,
    ledger: &Ledger,
) -> bool {
    if let Ok(acknowledgement) = Acknowledgement::decode(datagram) {
        ledger.acknowledgements.one();
        feedback.send_if_modified(|feedback| {
            let newer = feedback.acknowledged.is_none_or(|newest| acknowledgement.is_after(&newest));
            if newer {
                feedback.acknowledged = Some(acknowledgement);
            }
            newer
        });
        return true;
    }
    let Ok(losses) = LossFeedback::decode(datagram) else { return false };
    ledger.acknowledgements.one();
    feedback.send_modify(|feedback| feedback.losses.hear(now, losses));
    true
}
