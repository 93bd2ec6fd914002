//! Counters of one connection, from QUIC.

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct TransportCounts {
    /// QUIC datagram frames.
    pub(crate) datagrams_received: u64,
    /// QUIC datagram frames.
    pub(crate) datagrams_sent: u64,
    pub(crate) udp_received: u64,
    pub(crate) udp_sent: u64,
    /// Packets declared lost.
    pub(crate) quic_lost: u64,
}
