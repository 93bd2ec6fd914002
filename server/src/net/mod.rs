//! The network: accepts peers, presents the server's certificates, and carries sessions.

mod alpn;
pub(crate) mod certificate;
pub(crate) mod connections;
pub(crate) mod endpoint;
pub(crate) mod link;
pub(crate) mod network;
pub(crate) mod page;
pub(crate) mod socket;
