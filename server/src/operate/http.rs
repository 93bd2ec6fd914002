//! Sends one HTTP request on its own connection: to Agones' sidecar, a telemetry collector, or another server's admin
//! address.

use std::time::Duration;

use http_body_util::{BodyExt as _, Collected, Full, Limited};
use hyper::{Request, StatusCode, body::Bytes, client::conn::http1};
use hyper_util::rt::TokioIo;
use thiserror::Error;
use tokio::{
    net::{TcpStream, ToSocketAddrs},
    time::timeout,
};

use crate::limits::MAX_HTTP_ANSWER_BYTES;

#[derive(Debug, Error)]
pub(crate) enum SendError {
    #[error("cannot connect: {0}")]
    Reach(#[from] std::io::Error),
    #[error("HTTP: {0}")]
    Http(#[from] hyper::Error),
    #[error("bad request: {0}")]
    Request(#[from] hyper::http::Error),
    #[error("HTTP status {0}")]
    Status(StatusCode),
    #[error("no answer in {} s", .0.as_secs_f64())]
    Silent(Duration),
}

/// Errors unless a success status arrives within `limit`.
pub(crate) async fn send(
    address: impl ToSocketAddrs,
    request: Request<Full<Bytes>>,
    limit: Duration,
) -> Result<(), SendError> {
    // Reads and discards the body, so that the connection closes cleanly.
    let (status, _) = exchange(address, request, limit, MAX_HTTP_ANSWER_BYTES).await?;
    if status.is_success() { Ok(()) } else { Err(SendError::Status(status)) }
}

/// Returns the answer's status and body; the body is `None` if it is longer than `most_bytes`, or breaks off. Errors
/// unless a status arrives within `limit`.
pub(crate) async fn exchange(
    address: impl ToSocketAddrs,
    request: Request<Full<Bytes>>,
    limit: Duration,
    most_bytes: usize,
) -> Result<(StatusCode, Option<Bytes>), SendError> {
    let exchange = async {
        let stream = TcpStream::connect(address).await?;
        let (mut sender, connection) = http1::handshake(TokioIo::new(stream)).await?;
        let answer = async {
            let response = sender.send_request(request).await?;
            let status = response.status();
            let body = Limited::new(response.into_body(), most_bytes).collect().await;
            Ok((status, body.ok().map(Collected::to_bytes)))
        };
        // Dropping the connection at the end closes it.
        tokio::pin!(connection);
        tokio::pin!(answer);
        tokio::select! {
            biased;
            answer = &mut answer => answer,
            ended = &mut connection => {
                ended?;
                answer.await
            }
        }
    };
    timeout(limit, exchange).await.map_err(|_| SendError::Silent(limit))?
}

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;

    use tokio::{
        io::{AsyncReadExt as _, AsyncWriteExt as _},
        net::TcpListener,
    };

    use super::*;

    /// Answers one request with these bytes. If there are none, leaves the connection open.
    async fn answering(answer: Vec<u8>) -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        tokio::spawn(async move {
            let (mut stream, _) = listener.accept().await.unwrap();
            let mut request = [0; 1024];
            let bytes = stream.read(&mut request).await.unwrap();
            assert!(request[..bytes].starts_with(b"POST /x HTTP/1.1\r\n"));
            // The client may hang up before it has read everything.
            let _ = stream.write_all(&answer).await;
            if answer.is_empty() {
                std::future::pending::<()>().await;
            }
        });
        address
    }

    async fn post(address: SocketAddr, limit: Duration) -> Result<(), SendError> {
        send(address, Request::post("/x").body(Full::default()).unwrap(), limit).await
    }

    #[tokio::test]
    async fn the_status_decides() {
        let minute = Duration::from_secs(60);
        let answer = |status: &str, body: &[u8]| {
            [format!("HTTP/1.1 {status}\r\nContent-Length: {}\r\n\r\n", body.len()).as_bytes(), body].concat()
        };
        post(answering(answer("200 OK", b"{}")).await, minute).await.unwrap();
        post(answering(answer("204 No Content", b"")).await, minute).await.unwrap();
        // A body longer than what is read, and one shorter than announced.
        post(answering(answer("200 OK", &[b'x'; 1 << 20])).await, minute).await.unwrap();
        post(answering(b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\n{}".to_vec()).await, minute).await.unwrap();
        let refused = post(answering(answer("503 Service Unavailable", b"later")).await, minute).await;
        assert!(matches!(refused, Err(SendError::Status(StatusCode::SERVICE_UNAVAILABLE))), "{refused:?}");
        let babble = post(answering(b"what?\r\n\r\n".to_vec()).await, minute).await;
        assert!(matches!(babble, Err(SendError::Http(_))), "{babble:?}");
    }

    #[tokio::test]
    async fn a_silent_peer_times_out() {
        let limit = Duration::from_millis(50);
        let silent = post(answering(Vec::new()).await, limit).await;
        assert!(matches!(silent, Err(SendError::Silent(given)) if given == limit), "{silent:?}");
        let gone = TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap();
        let nobody = post(gone, Duration::from_secs(60)).await;
        assert!(matches!(nobody, Err(SendError::Reach(_))), "{nobody:?}");
    }
}
