//! Why an engine does not start, and why it refuses a session.

use std::{io, time::Duration};

use thiserror::Error;

use super::shared::WAITING_SESSIONS;
use crate::visibility::{backend::BackendError, schedule::capacity::Overload};

#[derive(Debug, Error)]
pub enum EngineError {
    #[error(transparent)]
    Backend(#[from] BackendError),
    #[error("cannot start the engine's thread: {0}")]
    Thread(io::Error),
    #[error("the device has not answered in {} s: look at its driver, or trace elsewhere with --backend", .0.as_secs())]
    NoAnswer(Duration),
    /// The thread ended before the back end was ready.
    #[error("the engine's thread died while it prepared the scene")]
    Died,
}

#[derive(Debug, Error)]
pub enum OpenError {
    #[error("all {0} sessions are taken")]
    Full(usize),
    /// The device has too little time for another session.
    #[error("{0}")]
    Overload(Overload),
    /// The engine's queue of new sessions is full.
    #[error("{WAITING_SESSIONS} sessions are already waiting to open")]
    Busy,
    /// The mask must have a plane for each light of the scene.
    #[error("a mask with {found} lights for a scene with {expected}")]
    Lights { expected: usize, found: u32 },
    /// The device cannot hold a mask of this size.
    #[error(transparent)]
    Picture(#[from] BackendError),
    /// The engine has ended, for this reason.
    #[error("the engine has stopped: {0}")]
    Stopped(String),
}
