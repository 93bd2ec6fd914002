//! Loads the scene on a separate thread while the window shows the progress.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use parking_lot::Mutex;

use super::background::Background;
use crate::{
    app::connect::{Loaded, Step, load},
    camera_path::CameraPath,
    error::ClientError,
    options::HeadlessOptions,
};

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Progress {
    Connecting,
    Fetching { have: u64, length: u64, since: Instant },
    Unpacking,
}

pub(crate) struct Loading {
    progress: Arc<Mutex<Progress>>,
    work: Background<Loaded>,
}

impl Loading {
    /// # Errors
    /// Errors if the system refuses a thread.
    pub(crate) fn start(
        options: HeadlessOptions,
        largest_mask: (u32, u32),
        camera_path: Option<CameraPath>,
    ) -> Result<Self, ClientError> {
        let progress = Arc::new(Mutex::new(Progress::Connecting));
        let shared = Arc::clone(&progress);
        let work = Background::spawn("loading", move || {
            let mut since = None;
            load(&options, largest_mask, camera_path, |step| match step {
                Step::Admitted(welcome) => {
                    tracing::info!(backend = welcome.backend, lights = welcome.lights, "admitted");
                }
                Step::Fetching { have, length } => {
                    let since = *since.get_or_insert_with(Instant::now);
                    *shared.lock() = Progress::Fetching { have, length, since };
                }
                Step::Unpacking => *shared.lock() = Progress::Unpacking,
            })
        })?;
        Ok(Self { progress, work })
    }

    pub(crate) fn progress(&self) -> Progress {
        self.progress.lock().clone()
    }

    /// Returns the result once loading has ended.
    pub(crate) fn poll(&self) -> Option<Result<Loaded, ClientError>> {
        self.work.poll()
    }
}

impl Progress {
    /// Returns the share of the scene that has arrived, if known.
    pub(crate) fn share(&self) -> Option<f32> {
        match self {
            #[expect(clippy::cast_possible_truncation, reason = "for a bar of some hundred pixels")]
            Self::Fetching { have, length, .. } => Some((*have as f64 / (*length).max(1) as f64) as f32),
            Self::Connecting | Self::Unpacking => None,
        }
    }

    pub(crate) fn text(&self, now: Instant) -> String {
        match self {
            Self::Connecting => "connecting to the server".to_owned(),
            Self::Unpacking => "unpacking the scene".to_owned(),
            Self::Fetching { have, length, since } => {
                let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
                let left = time_left(*have, *length, now.saturating_duration_since(*since))
                    .map_or(String::new(), |left| format!(", {} s left", left.as_secs() + 1));
                format!("scene: {:.1} of {:.1} MiB{left}", mib(*have), mib(*length))
            }
        }
    }
}

/// Returns the time left at the average speed so far. `None` before any bytes arrived.
fn time_left(have: u64, length: u64, took: Duration) -> Option<Duration> {
    let rest = length.saturating_sub(have);
    (have > 0 && took > Duration::from_millis(300)).then(|| {
        let left_s = took.as_secs_f64() * rest as f64 / have as f64;
        // Capped at a day.
        Duration::from_secs_f64(left_s.min(86_400.0))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_left_follows_from_the_speed_so_far() {
        let second = Duration::from_secs(1);
        assert_eq!(time_left(250, 1000, second), Some(3 * second));
        assert_eq!(time_left(1000, 1000, second), Some(Duration::ZERO));
        assert_eq!(time_left(0, 1000, second), None);
        assert_eq!(time_left(1, u64::MAX, second), Some(Duration::from_secs(86_400)));
        assert_eq!(time_left(1, 1000, Duration::from_millis(1)), None);
    }

    #[test]
    fn progress_shows_bytes_and_time() {
        let now = Instant::now();
        let progress = Progress::Fetching { have: 1 << 20, length: 4 << 20, since: now };
        assert_eq!(progress.text(now + Duration::from_secs(2)), "scene: 1.0 of 4.0 MiB, 7 s left");
        assert_eq!(progress.share(), Some(0.25));
        assert_eq!(Progress::Connecting.share(), None);
    }
}
