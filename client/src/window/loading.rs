//! Loads the scene on a separate thread while the window shows the progress.

use std::{
    sync::{
        Arc,
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    time::{Duration, Instant},
};

use parking_lot::Mutex;

use super::background::Background;
use crate::{
    app::connect::{Loaded, Step, load},
    camera_path::CameraPath,
    error::ClientError,
    link::url::ServerUrl,
    options::HeadlessOptions,
    stop::Stop,
};

/// How long a closed window waits for its server to know. Connecting and fetching end at once, unpacking does not.
const LEAVE_TIME: Duration = Duration::from_secs(2);

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Progress {
    Connecting,
    /// A person has to say whether the server with this certificate is trusted.
    FirstVisit {
        sha256: [u8; 32],
    },
    Fetching {
        have: u64,
        length: u64,
        since: Instant,
    },
    Unpacking,
}

pub(crate) struct Loading {
    progress: Arc<Mutex<Progress>>,
    /// Whether a server is trusted on the first visit. Dropping it is a no.
    answer: SyncSender<bool>,
    work: Background<Loaded>,
}

impl Loading {
    /// # Errors
    /// Errors if the system refuses a thread.
    pub(crate) fn start(
        options: HeadlessOptions,
        largest_mask: (u32, u32),
        camera_path: Option<CameraPath>,
        stop: Stop,
    ) -> Result<Self, ClientError> {
        let progress = Arc::new(Mutex::new(Progress::Connecting));
        let shared = Arc::clone(&progress);
        let (answer, answers) = sync_channel(1);
        let work = Background::spawn("loading", move || {
            let mut since = None;
            let step = |step: Step<'_>| match step {
                Step::Admitted(welcome) => {
                    tracing::info!(backend = %welcome.backend, lights = welcome.lights, "admitted");
                }
                Step::Fetching { have, length } => {
                    let since = *since.get_or_insert_with(Instant::now);
                    *shared.lock() = Progress::Fetching { have, length, since };
                }
                Step::Unpacking => *shared.lock() = Progress::Unpacking,
            };
            let trusts = |_: &ServerUrl, sha256: &[u8; 32]| ask(&shared, &answers, *sha256);
            load(&options, largest_mask, camera_path, &stop, step, trusts)
        })?;
        Ok(Self { progress, answer, work })
    }

    /// Answers the question of a first visit.
    pub(crate) fn answer(&self, trusted: bool) {
        // The first answer counts.
        let _ = self.answer.try_send(trusted);
    }

    pub(crate) fn progress(&self) -> Progress {
        self.progress.lock().clone()
    }

    /// Ends loading, whose stop was asked.
    pub(crate) fn leave(self) {
        let Self { answer, work, .. } = self;
        // Nobody answers any more.
        drop(answer);
        work.end_within(LEAVE_TIME);
    }

    /// Returns the result once loading has ended.
    pub(crate) fn poll(&self) -> Option<Result<Loaded, ClientError>> {
        self.work.poll()
    }
}

/// Shows the question, and waits for the answer.
fn ask(progress: &Mutex<Progress>, answers: &Receiver<bool>, sha256: [u8; 32]) -> bool {
    *progress.lock() = Progress::FirstVisit { sha256 };
    let trusted = answers.recv().unwrap_or(false);
    *progress.lock() = Progress::Connecting;
    trusted
}

impl Progress {
    /// Returns the share of the scene that has arrived, if known.
    pub(crate) fn share(&self) -> Option<f32> {
        match self {
            #[expect(clippy::cast_possible_truncation, reason = "for a bar of some hundred pixels")]
            Self::Fetching { have, length, .. } => Some((*have as f64 / (*length).max(1) as f64) as f32),
            Self::Connecting | Self::FirstVisit { .. } | Self::Unpacking => None,
        }
    }

    pub(crate) fn text(&self, now: Instant) -> String {
        match self {
            Self::Connecting | Self::FirstVisit { .. } => "connecting to the server".to_owned(),
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
    fn a_first_visit_waits_for_a_person_and_a_closed_window_is_a_no() {
        for (said, trusted) in [(Some(true), true), (Some(false), false), (None, false)] {
            let progress = Mutex::new(Progress::Connecting);
            let (answer, answers) = sync_channel(1);
            let shared = &progress;
            std::thread::scope(|scope| {
                let asked = scope.spawn(move || ask(shared, &answers, [7; 32]));
                while *progress.lock() != (Progress::FirstVisit { sha256: [7; 32] }) {
                    std::thread::yield_now();
                }
                match said {
                    Some(said) => answer.try_send(said).unwrap(),
                    None => drop(answer),
                }
                assert_eq!(asked.join().unwrap(), trusted);
            });
            assert_eq!(*progress.lock(), Progress::Connecting);
        }
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
