//! The receive task: feeds datagrams to the [`FrameReceiver`], and passes on its masks and feedback.

use std::{convert::Infallible, sync::Arc, time::Instant};

use gnomon_protocol::{
    acknowledgement::Acknowledgement,
    loss::LossFeedback,
    reassembler::Progress,
    receive::{Arrival, FrameReceiver, Requests},
};
use gnomon_transport::root_cause;
use parking_lot::Mutex;
use tokio::sync::watch;

pub(crate) use gnomon_protocol::receive::ReceiverCounters as Received;

use super::{
    connection::DataReceiver,
    mask_buffer::MaskWriter,
    mask_files::{FileFailure, MaskFiles},
};

/// Counters that the receive task writes and any thread reads.
pub(crate) type Counters = Arc<Mutex<Received>>;

/// Requests recorded by the renderer and read by the receive task.
#[derive(Debug, Clone, Default)]
pub(crate) struct Requested(Arc<Mutex<Requests>>);

impl Requested {
    pub(crate) fn change(&self, change: impl FnOnce(&mut Requests)) {
        change(&mut self.0.lock());
    }

    fn get(&self) -> Requests {
        *self.0.lock()
    }
}

pub(crate) struct ReceiveTask {
    pub(crate) datagrams: DataReceiver,
    pub(crate) receiver: FrameReceiver,
    pub(crate) writer: MaskWriter,
    pub(crate) requested: Requested,
    pub(crate) counters: Counters,
    pub(crate) acknowledge: watch::Sender<Option<Acknowledgement>>,
    pub(crate) report_losses: watch::Sender<Option<LossFeedback>>,
    pub(crate) files: Option<MaskFiles>,
    pub(crate) failure: FileFailure,
}

impl ReceiveTask {
    /// Receives until the connection is gone. Returns the reason and the mask writer, still open, because the control
    /// stream may have a better reason.
    pub(crate) async fn run(mut self) -> (String, MaskWriter) {
        match self.receive().await {
            Ok(never) => match never {},
            Err(reason) => (reason, self.writer),
        }
    }

    async fn receive(&mut self) -> Result<Infallible, String> {
        loop {
            match within(self.receiver.deadline(), self.datagrams.receive()).await {
                Ok(datagram) => {
                    let datagram = datagram.map_err(|error| format!("connection lost: {}", root_cause(&error)))?;
                    self.receiver.set_requests(self.requested.get());
                    match self.receiver.push(&datagram, Instant::now()) {
                        Ok(Arrival::Packet(Progress::Ignored(cause))) => tracing::trace!(?cause, "packet ignored"),
                        Ok(Arrival::Packet(_)) => {}
                        Ok(Arrival::Unrequested(frame)) => {
                            tracing::debug!(%frame, "dropped a packet of a frame that was not requested yet");
                        }
                        Err(error) => tracing::debug!(%error, "bad packet"),
                    }
                }
                Err(_) => self.receiver.handle_timeout(Instant::now()),
            }
            let has_frame = self.poll_frame()?;
            if let Some(acknowledgement) = self.receiver.poll_acknowledgement() {
                self.acknowledge.send_replace(Some(acknowledgement));
            }
            if let Some(feedback) = self.receiver.poll_loss_feedback() {
                self.report_losses.send_replace(Some(feedback));
            }
            *self.counters.lock() = self.receiver.counters();
            if self.receiver.poll_loss() {
                self.writer.lose();
            }
            if has_frame {
                self.writer.publish();
            }
        }
    }

    /// Decodes the next finished frame, if any, into the back buffer. Returns whether there was one.
    fn poll_frame(&mut self) -> Result<bool, String> {
        let back = self.writer.back();
        let frame = match self.receiver.poll_frame(&mut back.mask, &mut back.coverage) {
            Ok(Some(frame)) => frame,
            Ok(None) => return Ok(false),
            Err(error) => {
                tracing::warn!(frame = error.frame.0, reason = %error.reason, "dropped an invalid frame");
                return Ok(false);
            }
        };
        if let Some(files) = &mut self.files {
            files.write(&frame, &back.mask).map_err(|error| {
                let reason = error.to_string();
                self.failure.lock().get_or_insert(error);
                reason
            })?;
        }
        back.frame = frame.frame;
        back.traced_for = frame.traced_for;
        back.payload_bytes = frame.body.len();
        back.packets = frame.packets;
        back.received_at = frame.received_at;
        Ok(true)
    }
}

/// Awaits `receive` until the deadline.
async fn within<T>(
    deadline: Option<Instant>,
    receive: impl Future<Output = T>,
) -> Result<T, tokio::time::error::Elapsed> {
    match deadline {
        Some(deadline) => tokio::time::timeout_at(deadline.into(), receive).await,
        None => Ok(receive.await),
    }
}
