//! Counts the datagrams of the shared UDP socket. Less the connections' own counts, these belong to no session.

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

#[derive(Debug, Default)]
pub(crate) struct SocketCounts {
    received: AtomicU64,
    sent: AtomicU64,
    retries: AtomicU64,
}

impl SocketCounts {
    pub(crate) fn received(&self) -> u64 {
        self.received.load(Ordering::Relaxed)
    }

    pub(crate) fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    /// Number of peers that were sent a Retry.
    pub(crate) fn retries(&self) -> u64 {
        self.retries.load(Ordering::Relaxed)
    }

    pub(crate) fn count_retry(&self) {
        self.retries.fetch_add(1, Ordering::Relaxed);
    }
}

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

/// Number of datagrams of `stride` bytes in a buffer: the kernel takes and returns several per call.
const fn datagrams(bytes: usize, stride: usize) -> u64 {
    // A stride of 0 means one datagram.
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
    fn every_datagram_of_a_call_is_counted() {
        for (bytes, stride, expected) in [(0, 0, 1), (900, 0, 1), (900, 900, 1), (2700, 900, 3), (2701, 900, 4)] {
            assert_eq!(datagrams(bytes, stride), expected, "{bytes} {stride}");
        }
    }
}
