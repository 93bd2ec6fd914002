//! The data channel of a session: poses in and packets out.

use std::{io, time::Duration};

use bytes::Bytes;

use gnomon_transport::baseline::{PacketReader, PacketWriter};

use super::{
    baseline::{LabTcpData, LabUdpData, LabUdpReceiver, LabUdpSender},
    closer::Closer,
    quic::QuicData,
    socket::{SocketData, SocketReceiver, SocketSender},
};

/// The data channel before Start.
pub(crate) enum DataLink {
    Quic(QuicData),
    LabUdp(LabUdpData),
    LabTcp(LabTcpData),
    Socket(SocketData),
}

impl DataLink {
    /// The session's data port on lab links.
    pub(crate) const fn port(&self) -> Option<u16> {
        match self {
            Self::Quic(_) | Self::Socket(_) => None,
            Self::LabUdp(data) => Some(data.port()),
            Self::LabTcp(data) => Some(data.port()),
        }
    }

    /// Opens both directions. Errors if the client does not connect within `limit`, on `lab-tcp`.
    pub(crate) async fn open(self, limit: Duration) -> io::Result<(DataReceiver, DataSender)> {
        match self {
            Self::Quic(data) => Ok((DataReceiver::Quic(data.clone()), DataSender::Quic(data))),
            Self::LabUdp(data) => {
                let (receiver, sender) = data.split();
                Ok((DataReceiver::LabUdp(receiver), DataSender::LabUdp(sender)))
            }
            Self::LabTcp(data) => {
                let (receiver, sender) = data.accept(limit).await?;
                Ok((DataReceiver::LabTcp(receiver), DataSender::LabTcp(sender)))
            }
            Self::Socket(data) => {
                let (receiver, sender) = data.split();
                Ok((DataReceiver::Socket(receiver), DataSender::Socket(sender)))
            }
        }
    }

    pub(crate) fn closer(&self) -> Closer {
        match self {
            Self::Quic(data) => Closer::quic(data.clone()),
            Self::LabUdp(_) | Self::LabTcp(_) => Closer::none(),
            Self::Socket(data) => Closer::socket(data.last_words()),
        }
    }
}

pub(crate) enum DataReceiver {
    Quic(QuicData),
    LabUdp(LabUdpReceiver),
    LabTcp(PacketReader),
    Socket(SocketReceiver),
}

impl DataReceiver {
    /// Errors if the link is lost.
    pub(crate) async fn receive(&mut self) -> io::Result<Bytes> {
        match self {
            Self::Quic(data) => data.receive().await,
            Self::LabUdp(receiver) => receiver.receive().await,
            Self::LabTcp(receiver) => receiver.receive().await,
            Self::Socket(receiver) => receiver.receive().await,
        }
    }
}

pub(crate) enum DataSender {
    Quic(QuicData),
    LabUdp(LabUdpSender),
    LabTcp(PacketWriter),
    Socket(SocketSender),
}

impl DataSender {
    /// The largest packet, including its header.
    pub(crate) fn max_packet_bytes(&self) -> usize {
        match self {
            Self::Quic(data) => data.max_packet_bytes(),
            Self::LabUdp(_) | Self::LabTcp(_) => gnomon_protocol::limits::MAX_LAB_PACKET_BYTES,
            Self::Socket(_) => gnomon_protocol::limits::MAX_PACKET_BYTES,
        }
    }

    /// The frame gate: returns whether a frame may be sent now without queueing behind an earlier one.
    pub(crate) fn has_room(&self, packets: usize, bytes: usize) -> bool {
        match self {
            Self::Quic(data) => data.has_room(packets, bytes),
            // `send` blocks until the kernel has the last byte, so nothing queues.
            Self::LabUdp(_) | Self::LabTcp(_) => true,
            Self::Socket(sender) => sender.has_room(),
        }
    }

    /// Byte budget of a frame if the next one follows after `interval`. `None` if frames wait for the system instead.
    pub(crate) fn frame_budget(&self, interval: Duration) -> Option<usize> {
        match self {
            Self::Quic(data) => Some(data.frame_budget(interval)),
            Self::LabUdp(_) | Self::LabTcp(_) | Self::Socket(_) => None,
        }
    }

    /// Sets whether frames are being reduced to what the path can carry.
    pub(crate) fn hold_back(&self, held_back: bool) {
        if let Self::Quic(data) = self {
            data.hold_back(held_back);
        }
    }

    /// Errors if the link is lost.
    pub(crate) async fn send(&mut self, packet: Bytes) -> io::Result<()> {
        match self {
            Self::Quic(data) => data.send(packet),
            Self::LabUdp(sender) => sender.send(&packet).await,
            Self::LabTcp(sender) => sender.send(&packet).await,
            Self::Socket(sender) => sender.send(&packet),
        }
    }

    /// Sends the packets that `send` has buffered. Errors if the link is lost.
    pub(crate) async fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Quic(_) | Self::LabUdp(_) => Ok(()),
            Self::LabTcp(sender) => sender.flush().await,
            Self::Socket(sender) => sender.flush(),
        }
    }
}
