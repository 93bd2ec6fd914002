//! Engines trace for sessions: each engine is one thread that owns one device.

mod error;
#[cfg(any(test, feature = "faults"))]
mod faults;
mod fleet;
mod handle;
mod open;
mod options;
mod port;
mod pulse;
mod shared;
#[cfg(test)]
mod tests;
mod tracer;
mod worker;

#[cfg(any(test, feature = "faults"))]
pub use self::faults::Fault;
pub use self::{
    error::{EngineError, OpenError},
    fleet::Fleet,
    handle::Engine,
    options::{BackendChoice, EngineOptions},
    port::{MaskReceiver, OUTSTANDING_MASKS, RequestSender, SessionPort},
};
