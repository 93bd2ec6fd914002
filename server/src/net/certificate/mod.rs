//! TLS identity: a permanent certificate, and for browsers short-lived ones where that is self-signed.
//!
//! The permanent one belongs to the operator (`cert_file`, `key_file`): clients and browsers trust its authority. Or
//! else it is self-signed. Clients pin a self-signed one by its SHA-256 in the server's URL, as SSH pins a host key. So
//! it is made once, never expires, and stays in `identity.pem`; delete the file to get another. A successor can be
//! announced in the URL before it is used: `next_cert_file`, or `spare.pem` beside `identity.pem`. SIGHUP reloads the
//! files for later handshakes; sessions keep their keys.
//!
//! A browser accepts a pinned certificate (`serverCertificateHashes`) only if it is valid for at most 14 days and has a
//! P-256 key. So beside a self-signed certificate, a handshake that offers `h3` gets one of `browser`'s, valid for 13
//! days and renewed after half of that. Web pages ask the server for the hashes, see `crate::web`.

mod browser;
pub mod commands;
mod error;
mod folder;
mod pem;
mod permanent;
mod resolver;

pub use self::error::CertificateError;
pub(crate) use self::resolver::{ALPN_WEB, Certificates};
