//! The page for browsers, and what pages ask before they connect.
//!
//! `GET /` is the page, if the server has one ([`files`]). `GET /gnomon.json` answers pages of any origin that may use
//! the server:
//!
//! ```json
//! {"port": 4433, "protocol_version": 6, "scene": "cloister",
//!  "certificate_sha256": {"current": "9f86…", "next": "60303a…"}, "origins": ["https://edge.example"]}
//! ```
//!
//! `port` is that of WebTransport, on the same host. A page gives both hashes to its browser as
//! `serverCertificateHashes`. `certificate_sha256` is null if the browser trusts the certificate's authority. Then the
//! answer comes over HTTPS with the same certificate; without one, over plain HTTP and on loopback only, where a proxy
//! or a tunnel may fetch it. `origins` is null if pages of all origins may connect.

mod answer;
#[cfg(feature = "page")]
mod built_in;
mod files;
mod headers;
mod listener;
mod socket;

pub use self::listener::WebError;
pub(crate) use self::{
    answer::Page,
    files::Files,
    listener::{Bound, Web},
};
