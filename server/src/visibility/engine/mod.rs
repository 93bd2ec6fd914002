//! Engines trace for sessions: each engine is one thread that owns one device.

#[cfg(any(test, feature = "faults"))]
mod faults;
mod fleet;
mod handle;
mod open;
mod port;
mod shared;
#[cfg(test)]
mod tests;
mod worker;

#[cfg(any(test, feature = "faults"))]
pub use self::faults::Fault;
pub use self::{
    fleet::Fleet,
    handle::{BackendChoice, Engine, EngineError, EngineOptions, OpenError},
    port::{MaskReceiver, OUTSTANDING_MASKS, RequestSender, SessionPort},
};
