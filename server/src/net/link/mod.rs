//! Carries one session: a control stream, and a data channel for poses in and packets out.

mod baseline;
mod close_code;
mod closer;
mod counts;
mod data;
mod peer;
mod quic;
mod socket;

pub(crate) use self::{
    baseline::{LabTcpData, LabUdpData},
    close_code::CloseCode,
    closer::Closer,
    counts::TransportCounts,
    data::{DataLink, DataReceiver, DataSender},
    peer::Link,
    quic::QuicData,
    socket::{LastWords, SocketArrival, SocketEnd, socket_pair},
};
