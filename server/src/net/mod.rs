//! The network: endpoints that accept peers, the links that carry a session, and the conversation on its control stream.

pub(crate) mod certificate;
pub(crate) mod endpoint;
pub(crate) mod link;
pub(crate) mod socket;
