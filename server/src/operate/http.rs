//! A request to a program beside this one, over a connection of its own: what Agones' sidecar and a telemetry collector are told.

use std::time::Duration;

use http_body_util::{BodyExt as _, Full, Limited};
use hyper::{Request, StatusCode, body::Bytes, client::conn::http1};
use hyper_util::rt::TokioIo;
use thiserror::Error;
use tokio::{
    net::{TcpStream, ToSocketAddrs},
    time::timeout,
};

use crate::limits::MAX_HTTP_ANSWER_BYTES;

/// Why a request did not do what it should.
#[derive(Debug, Error)]
pub(crate) enum TellError {
    #[error("it cannot be reached: {0}")]
    Reach(#[from] std::io::Error),
    #[error("HTTP: {0}")]
    Http(#[from] hyper::Error),
    #[error("no request can be made for it: {0}")]
    Request(#[from] hyper::http::Error),
    #[error("it said {0}")]
    Status(StatusCode),
    #[error("no answer in {} s", .0.as_secs_f64())]
    Silent(Duration),
}

/// Sends the request and waits for an answer that says that all is well.
///
/// # Errors
/// When nobody is there, or says anything else, or it takes longer than `patience`.
pub(crate) async fn tell(
    address: impl ToSocketAddrs,
    request: Request<Full<Bytes>>,
    patience: Duration,
) -> Result<(), TellError> {
    let exchange = async {
        let stream = TcpStream::connect(address).await?;
        let (mut sender, connection) = http1::handshake(TokioIo::new(stream)).await?;
        let answer = async {
            let response = sender.send_request(request).await?;
            let status = response.status();
            // What it says is not needed, but a connection is only done when it is read.
            let _ = Limited::new(response.into_body(), MAX_HTTP_ANSWER_BYTES).collect().await;
            if status.is_success() { Ok(()) } else { Err(TellError::Status(status)) }
        };
        // Both ends here: the connection is dropped with the answer in hand.
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
    timeout(patience, exchange).await.map_err(|_| TellError::Silent(patience))?
}

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;

    use tokio::{
        io::{AsyncReadExt as _, AsyncWriteExt as _},
        net::TcpListener,
    };

    use super::*;

    /// An address at which a single request gets these bytes for an answer; none at all leaves the connection open.
    async fn answering(answer: Vec<u8>) -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        tokio::spawn(async move {
            let (mut stream, _) = listener.accept().await.unwrap();
            let mut asked = [0; 1024];
            let bytes = stream.read(&mut asked).await.unwrap();
            assert!(asked[..bytes].starts_with(b"POST /x HTTP/1.1\r\n"));
            // Who is told too much may hang up before all is said.
            let _ = stream.write_all(&answer).await;
            if answer.is_empty() {
                std::future::pending::<()>().await;
            }
        });
        address
    }

    async fn told(address: SocketAddr, patience: Duration) -> Result<(), TellError> {
        tell(address, Request::post("/x").body(Full::default()).unwrap(), patience).await
    }

    #[tokio::test]
    async fn an_answer_counts_by_its_status() {
        let minute = Duration::from_secs(60);
        let answer = |status: &str, body: &[u8]| {
            [format!("HTTP/1.1 {status}\r\nContent-Length: {}\r\n\r\n", body.len()).as_bytes(), body].concat()
        };
        told(answering(answer("200 OK", b"{}")).await, minute).await.unwrap();
        told(answering(answer("204 No Content", b"")).await, minute).await.unwrap();
        // More than is read, and less than was promised.
        told(answering(answer("200 OK", &[b'x'; 1 << 20])).await, minute).await.unwrap();
        told(answering(b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\n{}".to_vec()).await, minute).await.unwrap();
        let refused = told(answering(answer("503 Service Unavailable", b"later")).await, minute).await;
        assert!(matches!(refused, Err(TellError::Status(StatusCode::SERVICE_UNAVAILABLE))), "{refused:?}");
        let babble = told(answering(b"what?\r\n\r\n".to_vec()).await, minute).await;
        assert!(matches!(babble, Err(TellError::Http(_))), "{babble:?}");
    }

    #[tokio::test]
    async fn nobody_is_waited_for_for_ever() {
        let patience = Duration::from_millis(50);
        let silent = told(answering(Vec::new()).await, patience).await;
        assert!(matches!(silent, Err(TellError::Silent(given)) if given == patience), "{silent:?}");
        let gone = TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap();
        let nobody = told(gone, Duration::from_secs(60)).await;
        assert!(matches!(nobody, Err(TellError::Reach(_))), "{nobody:?}");
    }
}
