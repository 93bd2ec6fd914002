//! What carries one session: a control stream, and a way for poses in and packets out.

mod lab;
mod quic;

use std::{io, net::SocketAddr, time::Duration};

use bytes::Bytes;
pub(crate) use lab::{LabTcpData, LabUdpData};
pub(crate) use quic::QuicData;

use gnomon_protocol::message::{ClientMessage, ServerMessage};
use gnomon_transport::{
    baseline::{PacketReader, PacketWriter},
    control::{ControlReader, ControlWriter},
};
use tokio::io::{AsyncRead, AsyncWrite};

use crate::limits::{MAX_CLIENT_MESSAGE_BYTES, WRITE_TIMEOUT};

/// A peer that is connected but not yet admitted.
pub(crate) struct Link {
    /// What carries it, for the logs.
    pub(crate) carrier: &'static str,
    /// Where the peer was when it came.
    pub(crate) peer: SocketAddr,
    /// What the client says.
    pub(crate) reader: ControlReader<ClientMessage>,
    /// What the server says.
    pub(crate) writer: ControlWriter<ServerMessage>,
    /// Poses and packets.
    pub(crate) data: DataLink,
}

impl Link {
    pub(super) fn new(
        carrier: &'static str,
        peer: SocketAddr,
        receive: impl AsyncRead + Send + Unpin + 'static,
        send: impl AsyncWrite + Send + Unpin + 'static,
        data: DataLink,
    ) -> Self {
        let reader = ControlReader::new(receive, MAX_CLIENT_MESSAGE_BYTES);
        let writer = ControlWriter::new(send, WRITE_TIMEOUT);
        Self { carrier, peer, reader, writer, data }
    }
}

/// Poses and packets, before they flow.
pub(crate) enum DataLink {
    /// QUIC datagrams beside the control stream.
    Quic(QuicData),
    /// A UDP socket of its own.
    LabUdp(LabUdpData),
    /// A TCP connection of its own.
    LabTcp(LabTcpData),
}

impl DataLink {
    /// The session's own data port, on lab links.
    pub(crate) const fn port(&self) -> Option<u16> {
        match self {
            Self::Quic(_) => None,
            Self::LabUdp(data) => Some(data.port()),
            Self::LabTcp(data) => Some(data.port()),
        }
    }

    /// Opens both directions; on `lab-tcp` it waits for the client to connect.
    ///
    /// # Errors
    /// When the client does not connect in time.
    pub(crate) async fn open(self, patience: Duration) -> io::Result<(DataReceiver, DataSender)> {
        match self {
            Self::Quic(data) => Ok((DataReceiver::Quic(data.clone()), DataSender::Quic(data))),
            Self::LabUdp(data) => {
                let (receiver, sender) = data.split();
                Ok((DataReceiver::LabUdp(receiver), DataSender::LabUdp(sender)))
            }
            Self::LabTcp(data) => {
                let (receiver, sender) = data.accept(patience).await?;
                Ok((DataReceiver::LabTcp(receiver), DataSender::LabTcp(sender)))
            }
        }
    }

    /// A handle that ends the connection.
    pub(crate) fn closer(&self) -> Closer {
        match self {
            Self::Quic(data) => Closer(Some(data.clone())),
            Self::LabUdp(_) | Self::LabTcp(_) => Closer(None),
        }
    }
}

/// Ends a link's connection, and knows what it has carried. Lab links end when their sockets are dropped.
#[derive(Clone)]
pub(crate) struct Closer(Option<QuicData>);

impl Closer {
    /// Ends the connection now. What was written but not yet received is lost.
    pub(crate) fn close(&self, code: CloseCode, reason: &str) {
        if let Some(data) = &self.0 {
            data.close(code, reason);
        }
    }

    /// Of no link.
    #[cfg(test)]
    pub(crate) const fn none() -> Self {
        Self(None)
    }

    /// What the transport has counted; `None` on lab links, whose sockets belong to their tasks.
    pub(crate) fn wire(&self) -> Option<Wire> {
        self.0.as_ref().map(QuicData::wire)
    }
}

/// What a transport has counted for one link.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Wire {
    /// Datagrams of ours that came in.
    pub(crate) datagrams_received: u64,
    /// Datagrams of ours that went out.
    pub(crate) datagrams_sent: u64,
    /// UDP datagrams that came in, whatever was in them.
    pub(crate) udp_received: u64,
    /// UDP datagrams that went out.
    pub(crate) udp_sent: u64,
    /// Packets that were declared lost.
    pub(crate) quic_lost: u64,
}

/// Application error codes of closed connections.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub(crate) enum CloseCode {
    /// The session ended as it should.
    Done = 0,
    /// The client was not admitted.
    Refused = 1,
    /// The client broke the protocol.
    Violation = 2,
    /// The server failed.
    Internal = 3,
}

/// Where poses come from.
pub(crate) enum DataReceiver {
    Quic(QuicData),
    LabUdp(lab::LabUdpReceiver),
    LabTcp(PacketReader),
}

impl DataReceiver {
    /// The next packet.
    ///
    /// # Errors
    /// When the link is gone.
    pub(crate) async fn receive(&mut self) -> io::Result<Bytes> {
        match self {
            Self::Quic(data) => data.receive().await,
            Self::LabUdp(receiver) => receiver.receive().await,
            Self::LabTcp(receiver) => receiver.receive().await,
        }
    }
}

/// Where packets go.
pub(crate) enum DataSender {
    Quic(QuicData),
    LabUdp(lab::LabUdpSender),
    LabTcp(PacketWriter),
}

impl DataSender {
    /// The largest packet, header included.
    pub(crate) fn max_packet_bytes(&self) -> usize {
        match self {
            Self::Quic(data) => data.max_packet_bytes(),
            Self::LabUdp(_) | Self::LabTcp(_) => gnomon_protocol::limits::MAX_LAB_PACKET_BYTES,
        }
    }

    /// The frame gate: whether a frame may be sent now, or would queue up behind an earlier one.
    pub(crate) fn has_room(&self, packets: usize, bytes: usize) -> bool {
        match self {
            Self::Quic(data) => data.has_room(packets, bytes),
            // These wait in `send` until the last byte is with the kernel, so nothing queues up behind them.
            Self::LabUdp(_) | Self::LabTcp(_) => true,
        }
    }

    /// Bytes that a frame may have when the next one follows after `interval`; `None` where a sender waits instead.
    pub(crate) fn frame_budget(&self, interval: Duration) -> Option<usize> {
        match self {
            Self::Quic(data) => Some(data.frame_budget(interval)),
            Self::LabUdp(_) | Self::LabTcp(_) => None,
        }
    }

    /// Says whether frames would be larger if the path bore it.
    pub(crate) fn hold_back(&self, held_back: bool) {
        if let Self::Quic(data) = self {
            data.hold_back(held_back);
        }
    }

    /// Sends one packet.
    ///
    /// # Errors
    /// When the link is gone.
    pub(crate) async fn send(&mut self, packet: Bytes) -> io::Result<()> {
        match self {
            Self::Quic(data) => data.send(packet),
            Self::LabUdp(sender) => sender.send(&packet).await,
            Self::LabTcp(sender) => sender.send(&packet).await,
        }
    }

    /// Sends what `send` has gathered.
    ///
    /// # Errors
    /// When the link is gone.
    pub(crate) async fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Quic(_) | Self::LabUdp(_) => Ok(()),
            Self::LabTcp(sender) => sender.flush().await,
        }
    }
}
