//! Work on a separate thread, whose result the window polls.

use std::{
    io,
    sync::mpsc::{Receiver, TryRecvError, sync_channel},
    time::Duration,
};

use crate::error::ClientError;

pub(super) struct Background<T>(Receiver<Result<T, ClientError>>);

impl<T: Send + 'static> Background<T> {
    /// # Errors
    /// Errors if the system refuses a thread.
    pub(super) fn spawn(
        name: &str,
        work: impl FnOnce() -> Result<T, ClientError> + Send + 'static,
    ) -> Result<Self, ClientError> {
        let (send, result) = sync_channel(1);
        std::thread::Builder::new().name(name.to_owned()).spawn(move || {
            // If the window was closed meanwhile, the receiver is gone.
            let _ = send.send(work());
        })?;
        Ok(Self(result))
    }

    /// Waits for the end of the work, but not longer than `limit`. The result is dropped here.
    pub(super) fn end_within(self, limit: Duration) {
        drop(self.0.recv_timeout(limit));
    }

    /// Returns the result once the work has ended.
    pub(super) fn poll(&self) -> Option<Result<T, ClientError>> {
        match self.0.try_recv() {
            Ok(result) => Some(result),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                Some(Err(ClientError::System(io::Error::other("a background thread has panicked"))))
            }
        }
    }
}
