//! Poses in: each newer one becomes the session's only trace request.

mod client_clock;
mod interval;
mod look_ahead;
mod newest;
mod rate;
pub(super) mod receive;
