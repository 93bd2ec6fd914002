//! Tells the protocols apart that share the port.

use quinn::crypto::rustls::HandshakeData;

use super::certificate::ALPN_WEB;

/// True once the handshake has chosen WebTransport.
pub(crate) fn is_web(connection: &quinn::Connection) -> bool {
    let data = connection.handshake_data().and_then(|data| data.downcast::<HandshakeData>().ok());
    data.and_then(|data| data.protocol).is_some_and(|protocol| protocol == ALPN_WEB)
}
