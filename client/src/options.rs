//! Options of one run.

use std::{path::PathBuf, time::Duration};

use gnomon_protocol::mask::MaskShape;

use crate::{app::local_server::LocalScene, config::ClientSettings, error::ClientError, link::url::ServerUrl};

/// Above it, nothing answers the hand any more.
const MAX_SEQUENTIAL_LAG: u32 = 100;

/// Source of the scene and its visibility.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Source {
    Server(ServerUrl),
    /// A local file, served by a server of its own on this machine.
    File(LocalScene),
    /// A local file, drawn without visibility: every light reaches everything.
    Offline(LocalScene),
}

/// A headless run, and what it shares with a run in a window.
#[derive(Debug, Clone, PartialEq)]
pub struct HeadlessOptions {
    pub source: Source,
    pub settings: ClientSettings,
    pub record: Option<PathBuf>,
    /// Remember the server for the next window.
    pub remember: bool,
    /// Draw a progress bar where standard error is a terminal.
    pub progress: bool,
}

impl HeadlessOptions {
    #[must_use]
    pub fn new(source: Source) -> Self {
        Self { source, settings: ClientSettings::default(), record: None, remember: false, progress: false }
    }

    /// Checks settings against each other before anything is opened. Their own ranges were checked when they were read.
    ///
    /// # Errors
    /// Names the first conflicting settings, or a size that no mask can have.
    pub fn validate(&self) -> Result<(), ClientError> {
        let settings = &self.settings;
        let wrong = |option, reason| Err(ClientError::Option { option, reason });
        MaskShape::new(settings.size.width, settings.size.height, 1)?;
        if settings.sequential_lag > MAX_SEQUENTIAL_LAG {
            let reason = format!("at most {MAX_SEQUENTIAL_LAG} frames can be drawn late");
            return wrong("sequential-lag", reason);
        }
        if settings.wait && matches!(self.source, Source::Offline(_)) {
            return wrong("wait", "there is no mask to wait for without a server".to_owned());
        }
        Ok(())
    }
}

/// A run in a window. Its size is the window's initial size.
#[derive(Debug, Clone, PartialEq)]
pub struct WindowOptions {
    pub run: HeadlessOptions,
    /// Counted from the start.
    pub exit_after: Option<Duration>,
}
