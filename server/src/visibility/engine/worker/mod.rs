//! The engine's thread. It takes up sessions, gives them the device in turn, and recovers when the device fails.

mod recovery;
mod session;
mod state;
#[cfg(test)]
mod tests;
mod turn;
mod work;

pub(super) use self::state::Worker;
