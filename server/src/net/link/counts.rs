//! Counters of one connection, from QUIC.

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct TransportCounts {
    pub(crate) datagrams_received: u64,
    pub(crate) datagrams_sent: u64,
    pub(crate) udp_received: u64,
    pub(crate) udp_sent: u64,
    pub(crate) quic_lost: u64,
}
