//! All connections, from a peer's first packet until the transport has forgotten it: who may have one, and its end.
//!
//! Dropping a [`quinn::Connection`] closes nothing while a library's task keeps a clone. So each connection has one
//! owner, its [`Guard`], which closes it; and it is counted until quinn's own task for it has ended, not until ours
//! has.

mod guard;
mod place;
mod rates;
mod runtime;
mod table;

pub(crate) use self::{
    guard::{Expelled, Guard},
    place::{Connections, Place, Tenure},
    runtime::{TenureRuntime, accept_for},
    table::{Stage, Turned},
};
