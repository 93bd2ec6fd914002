//! What web pages ask before they connect: `GET /gnomon.json`, from pages of any origin that may use the server.
//!
//! ```json
//! {"port": 4433, "protocol_version": 6, "scene": "cloister",
//!  "certificate_sha256": {"current": "9f86…", "next": "60303a…"}}
//! ```
//!
//! `port` is that of WebTransport, on the same host. A page gives both hashes to its browser as
//! `serverCertificateHashes`. `certificate_sha256` is null if the browser trusts the certificate's authority. Then the
//! answer comes over HTTPS with the same certificate; without one, over plain HTTP and on loopback only, where a proxy
//! or a tunnel may fetch it.

mod answer;
mod listener;

pub use self::listener::WebError;
pub(crate) use self::{
    answer::Page,
    listener::{Bound, Web},
};
