//! The UDP socket of all sessions, which counts what passes: with the connections' own counts this tells what belonged to none of them.

use std::{
    io::{self, IoSliceMut},
    net::SocketAddr,
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    task::{Context, Poll, ready},
};

use quinn::{
    AsyncUdpSocket, UdpPoller,
    udp::{RecvMeta, Transmit},
};

/// UDP datagrams, whatever is in them.
#[derive(Debug, Default)]
pub(crate) struct SocketCounts {
    received: AtomicU64,
    sent: AtomicU64,
    retries: AtomicU64,
}

impl SocketCounts {
    /// Datagrams that the kernel has handed over.
    pub(crate) fn received(&self) -> u64 {
        self.received.load(Ordering::Relaxed)
    }

    /// Datagrams that the kernel has taken.
    pub(crate) fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    /// Peers that were asked to prove their address.
    pub(crate) fn retries(&self) -> u64 {
        self.retries.load(Ordering::Relaxed)
    }

    /// Counts one of those.
    pub(crate) fn retried(&self) {
        self.retries.fetch_add(1, Ordering::Relaxed);
    }
}

/// A socket that counts.
#[derive(Debug)]
pub(crate) struct CountingSocket {
    inner: Arc<dyn AsyncUdpSocket>,
    counts: Arc<SocketCounts>,
}

impl CountingSocket {
    pub(crate) fn new(inner: Arc<dyn AsyncUdpSocket>, counts: Arc<SocketCounts>) -> Self {
        Self { inner, counts }
    }
}

/// Datagrams of `stride` bytes that `bytes` hold: the kernel hands over and takes several at once.
const fn datagrams(bytes: usize, stride: usize) -> u64 {
    // One call carries some 64 KiB at most.
    if stride == 0 { 1 } else { bytes.div_ceil(stride) as u64 }
}

impl AsyncUdpSocket for CountingSocket {
    fn create_io_poller(self: Arc<Self>) -> Pin<Box<dyn UdpPoller>> {
        Arc::clone(&self.inner).create_io_poller()
    }

    fn try_send(&self, transmit: &Transmit<'_>) -> io::Result<()> {
        self.inner.try_send(transmit)?;
        let count = datagrams(transmit.contents.len(), transmit.segment_size.unwrap_or(0));
        self.counts.sent.fetch_add(count, Ordering::Relaxed);
        Ok(())
    }

    fn poll_recv(
        &self,
        context: &mut Context<'_>,
        buffers: &mut [IoSliceMut<'_>],
        meta: &mut [RecvMeta],
    ) -> Poll<io::Result<usize>> {
        let filled = ready!(self.inner.poll_recv(context, buffers, meta))?;
        let count = meta.iter().take(filled).map(|meta| datagrams(meta.len, meta.stride)).sum();
        self.counts.received.fetch_add(count, Ordering::Relaxed);
        Poll::Ready(Ok(filled))
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.inner.local_addr()
    }

    fn max_transmit_segments(&self) -> usize {
        self.inner.max_transmit_segments()
    }

    fn max_receive_segments(&self) -> usize {
        self.inner.max_receive_segments()
    }

    fn may_fragment(&self) -> bool {
        self.inner.may_fragment()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_of_several_datagrams_counts_them_all() {
        for (bytes, stride, expected) in [(0, 0, 1), (900, 0, 1), (900, 900, 1), (2700, 900, 3), (2701, 900, 4)] {
            assert_eq!(datagrams(bytes, stride), expected, "{bytes} {stride}");
        }
    }
}
