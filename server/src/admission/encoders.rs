//! Shares the cores among encoders: one encoder a core, and those of sessions without a rate on half of the cores.

use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// All sessions' permits to encode.
#[derive(Debug, Clone)]
pub(crate) struct Encoders {
    cores: Arc<Semaphore>,
    /// For sessions without a rate, so that few of them wait before a session with one.
    background: Arc<Semaphore>,
}

/// One session's view of [`Encoders`].
#[derive(Debug, Clone)]
pub(crate) struct EncoderQueue {
    encoders: Encoders,
    in_background: bool,
}

/// Permits to encode one frame.
#[derive(Debug)]
pub(crate) struct EncoderPermit {
    _core: OwnedSemaphorePermit,
    _background: Option<OwnedSemaphorePermit>,
}

impl Encoders {
    pub(crate) fn new(cores: usize) -> Self {
        Self { cores: Arc::new(Semaphore::new(cores)), background: Arc::new(Semaphore::new((cores / 2).max(1))) }
    }

    pub(crate) fn of(&self, in_background: bool) -> EncoderQueue {
        EncoderQueue { encoders: self.clone(), in_background }
    }
}

impl EncoderQueue {
    /// Waits for a core. `None` if the server has stopped.
    pub(crate) async fn acquire(&self) -> Option<EncoderPermit> {
        let Encoders { cores, background } = &self.encoders;
        let background =
            if self.in_background { Some(Arc::clone(background).acquire_owned().await.ok()?) } else { None };
        let core = Arc::clone(cores).acquire_owned().await.ok()?;
        Some(EncoderPermit { _core: core, _background: background })
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tokio::time::timeout;

    use super::*;

    #[tokio::test]
    async fn sessions_without_a_rate_leave_half_of_the_cores() {
        let encoders = Encoders::new(4);
        let (greedy, modest) = (encoders.of(true), encoders.of(false));
        let busy = [greedy.acquire().await.unwrap(), greedy.acquire().await.unwrap()];
        assert!(timeout(Duration::from_millis(20), greedy.acquire()).await.is_err());
        let others = [modest.acquire().await.unwrap(), modest.acquire().await.unwrap()];
        assert!(timeout(Duration::from_millis(20), modest.acquire()).await.is_err());
        drop(busy);
        modest.acquire().await.unwrap();
        drop(others);
        // With one core they take turns.
        let one = Encoders::new(1);
        drop(one.of(true).acquire().await.unwrap());
        one.of(false).acquire().await.unwrap();
    }
}
