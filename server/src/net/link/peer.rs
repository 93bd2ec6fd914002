//! A connected peer.

use std::net::SocketAddr;

use gnomon_protocol::message::{ClientMessage, ServerMessage};
use gnomon_transport::control::{ControlReader, ControlWriter};
use tokio::io::{AsyncRead, AsyncWrite};

use super::data::DataLink;
use crate::limits::{MAX_CLIENT_MESSAGE_BYTES, WRITE_TIMEOUT};

pub(crate) struct Link {
    /// Name of the transport, for logs.
    pub(crate) carrier: &'static str,
    /// Address on arrival; QUIC peers may migrate.
    pub(crate) peer: SocketAddr,
    pub(crate) reader: ControlReader<ClientMessage>,
    pub(crate) writer: ControlWriter<ServerMessage>,
    pub(crate) data: DataLink,
}

impl Link {
    pub(crate) fn new(
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
