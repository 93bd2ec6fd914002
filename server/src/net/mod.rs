//! The network: accepts peers, presents the server's certificates, and carries sessions.

pub(crate) mod certificate;
pub(crate) mod endpoint;
pub(crate) mod link;
pub(crate) mod page;
pub(crate) mod socket;
