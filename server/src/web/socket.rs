//! Sessions over WebSockets, at `/session` of the web address.
//!
//! Each message is binary: a byte that says what it is, and that. 0: bytes of the control stream. 1, from the page: one
//! datagram; to the page: the packets of a frame, each after its length.

use std::net::SocketAddr;

use bytes::{BufMut as _, Bytes, BytesMut};
use futures_util::{SinkExt as _, StreamExt as _};
use http_body_util::Full;
use hyper::{
    Method, Request, Response, StatusCode,
    header::{CONNECTION, HeaderMap, HeaderValue, ORIGIN, SEC_WEBSOCKET_ACCEPT, SEC_WEBSOCKET_KEY, UPGRADE},
};
use hyper_util::rt::TokioIo;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    sync::mpsc,
    time::timeout,
};
use tokio_tungstenite::{
    WebSocketStream,
    tungstenite::{
        Message,
        handshake::derive_accept_key,
        protocol::{CloseFrame, Role, WebSocketConfig},
    },
};

use crate::{
    limits::{LINGER, MAX_CLIENT_MESSAGE_BYTES},
    net::link::{LastWords, SocketArrival, SocketEnd, socket_pair},
    origins::Origins,
};

pub(super) const PATH: &str = "/session";

const CONTROL: u8 = 0;
const DATA: u8 = 1;

/// Control bytes of one message to a page.
const CONTROL_MESSAGE_BYTES: usize = 32 * 1024;

/// Longest message of a page: what it says in one go on the control stream, or a datagram.
const MAX_MESSAGE_BYTES: usize = 2 * MAX_CLIENT_MESSAGE_BYTES;

/// Where new sessions go.
pub(crate) type Arrivals = mpsc::Sender<SocketArrival>;

/// Returns whether the request wants to become a WebSocket.
pub(super) fn is_wanted<B>(request: &Request<B>) -> bool {
    let names = |name, wanted: &str| {
        let listed = request.headers().get(name).and_then(|value: &HeaderValue| value.to_str().ok());
        listed.is_some_and(|listed| listed.split(',').any(|word| word.trim().eq_ignore_ascii_case(wanted)))
    };
    let path = request.uri().path() == PATH && *request.method() == Method::GET;
    path && names(UPGRADE, "websocket") && names(CONNECTION, "upgrade")
}

/// Answers such a request. A page of an origin that is not listed gets status 403.
pub(super) fn upgrade(
    mut request: Request<hyper::body::Incoming>,
    peer: SocketAddr,
    origins: Option<&Origins>,
    arrivals: &Arrivals,
) -> Response<Full<Bytes>> {
    let headers = request.headers();
    let origin = headers.get(ORIGIN).map_or(&b""[..], |origin| origin.as_bytes());
    if origins.is_some_and(|origins| !origins.allow(origin)) {
        return refused(StatusCode::FORBIDDEN, "the page's origin is not listed\n");
    }
    let version = headers.get("sec-websocket-version").is_some_and(|version| version == "13");
    let Some(key) = headers.get(SEC_WEBSOCKET_KEY).filter(|_| version) else {
        return refused(StatusCode::BAD_REQUEST, "not a WebSocket of version 13\n");
    };
    let accept = HeaderValue::try_from(derive_accept_key(key.as_bytes()));
    let (control, data, end) = socket_pair();
    if arrivals.try_send(SocketArrival { peer, control, data }).is_err() {
        return refused(StatusCode::SERVICE_UNAVAILABLE, "the server is busy, or stops\n");
    }
    let upgraded = hyper::upgrade::on(&mut request);
    tokio::spawn(async move {
        // A peer that goes meanwhile drops its end, which ends the session.
        if let Ok(stream) = upgraded.await {
            let config = WebSocketConfig::default()
                .max_message_size(Some(MAX_MESSAGE_BYTES))
                .max_frame_size(Some(MAX_MESSAGE_BYTES))
                .write_buffer_size(0);
            carry(WebSocketStream::from_raw_socket(TokioIo::new(stream), Role::Server, Some(config)).await, end).await;
        }
    });
    let mut answer = refused(StatusCode::SWITCHING_PROTOCOLS, "");
    let headers: &mut HeaderMap = answer.headers_mut();
    headers.insert(UPGRADE, HeaderValue::from_static("websocket"));
    headers.insert(CONNECTION, HeaderValue::from_static("upgrade"));
    if let Ok(accept) = accept {
        headers.insert(SEC_WEBSOCKET_ACCEPT, accept);
    }
    answer
}

fn refused(code: StatusCode, text: &'static str) -> Response<Full<Bytes>> {
    let mut answer = Response::new(Full::new(Bytes::from_static(text.as_bytes())));
    *answer.status_mut() = code;
    answer
}

/// Longest reason that a WebSocket's close may give, in bytes.
const MAX_REASON_BYTES: usize = 123;

fn farewell(last_words: &LastWords) -> Option<CloseFrame> {
    let (code, reason) = last_words.get()?;
    let reason = &reason[..reason.floor_char_boundary(MAX_REASON_BYTES)];
    Some(CloseFrame { code: code.websocket().into(), reason: reason.into() })
}

/// Carries a session until either side ends it.
async fn carry<S>(socket: WebSocketStream<S>, end: SocketEnd)
where
    S: tokio::io::AsyncRead + tokio::io::AsyncWrite + Unpin,
{
    let SocketEnd { control, poses, mut frames, busy, last_words } = end;
    let (mut from_session, mut to_session) = tokio::io::split(control);
    let (mut to_page, mut from_page) = socket.split();
    let reading = async {
        while let Some(Ok(message)) = from_page.next().await {
            let bytes = match message {
                Message::Binary(bytes) => bytes,
                Message::Ping(_) | Message::Pong(_) => continue,
                Message::Text(_) | Message::Close(_) | Message::Frame(_) => return,
            };
            match bytes.first() {
                Some(&CONTROL) => {
                    if to_session.write_all(&bytes[1..]).await.is_err() {
                        return;
                    }
                }
                // The newest pose counts: one that finds no room is dropped.
                Some(&DATA) => drop(poses.try_send(bytes.slice(1..))),
                _ => return,
            }
        }
    };
    let writing = async {
        loop {
            let mut message = BytesMut::with_capacity(1 + CONTROL_MESSAGE_BYTES);
            message.put_u8(CONTROL);
            tokio::select! {
                biased;
                read = from_session.read_buf(&mut message) => match read {
                    Ok(1..) => if to_page.send(Message::Binary(message.freeze())).await.is_err() {
                        return;
                    },
                    // The session has ended, and has said why.
                    Ok(0) | Err(_) => {
                        let _ = timeout(LINGER, to_page.send(Message::Close(farewell(&last_words)))).await;
                        return;
                    }
                },
                Some(frame) = frames.recv() => {
                    let mut message = BytesMut::with_capacity(1 + frame.len());
                    message.put_u8(DATA);
                    message.extend_from_slice(&frame);
                    if to_page.send(Message::Binary(message.freeze())).await.is_err() {
                        return;
                    }
                    busy.written();
                }
            }
        }
    };
    tokio::select! {
        () = reading => {}
        () = writing => {}
    }
}
