//! The engine's thread. It opens sessions, gives them turns on the device, and recovers when the device fails.

mod recovery;
mod session;
mod state;
#[cfg(test)]
mod tests;
mod turn;
mod work;

pub(super) use self::state::Worker;
