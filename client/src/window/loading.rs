//! Getting the scene while the window lives: on a thread of its own, which says how far it is.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{Receiver, TryRecvError, sync_channel},
    },
    time::{Duration, Instant},
};

use gnomon_scene::Scene;

use crate::{
    app::connect::{Connected, Step, get_scene},
    camera_path::CameraPath,
    default_path::default_path,
    error::ClientError,
    occluders::Occluders,
    options::HeadlessOptions,
    render::exposure::Exposure,
};

/// All that a picture needs.
pub(crate) struct Loaded {
    pub(crate) scene: Scene,
    pub(crate) connected: Option<Connected>,
    pub(crate) camera_path: CameraPath,
    pub(crate) exposure: Exposure,
}

/// How far it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Stage {
    Connecting,
    Fetching { have: u64, length: u64, since: Instant },
    Unpacking,
}

/// A scene on its way.
pub(crate) struct Loading {
    stage: Arc<Mutex<Stage>>,
    done: Receiver<Result<Loaded, ClientError>>,
}

impl Loading {
    /// Starts it.
    pub(crate) fn start(
        options: HeadlessOptions,
        largest_mask: (u32, u32),
        camera_path: Option<CameraPath>,
    ) -> Result<Self, ClientError> {
        let stage = Arc::new(Mutex::new(Stage::Connecting));
        let (send, done) = sync_channel(1);
        let told = Arc::clone(&stage);
        std::thread::Builder::new().name("loading".to_owned()).spawn(move || {
            let loaded = load(&options, largest_mask, camera_path, |stage| {
                *told.lock().unwrap_or_else(PoisonError::into_inner) = stage;
            });
            // A window that has been closed meanwhile wants nothing.
            let _ = send.send(loaded);
        })?;
        Ok(Self { stage, done })
    }

    pub(crate) fn stage(&self) -> Stage {
        self.stage.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The result, once it is there.
    pub(crate) fn take(&self) -> Option<Result<Loaded, ClientError>> {
        match self.done.try_recv() {
            Ok(result) => Some(result),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                Some(Err(ClientError::System(std::io::Error::other("the loading thread has stopped"))))
            }
        }
    }
}

fn load(
    options: &HeadlessOptions,
    largest_mask: (u32, u32),
    camera_path: Option<CameraPath>,
    mut tell: impl FnMut(Stage),
) -> Result<Loaded, ClientError> {
    let mut since = None;
    let (scene, connected) = get_scene(options, largest_mask, |step| match step {
        Step::Admitted(welcome) => tracing::info!(backend = welcome.backend, lights = welcome.lights, "admitted"),
        Step::Fetching { have, length } => {
            let since = *since.get_or_insert_with(Instant::now);
            tell(Stage::Fetching { have, length, since });
        }
        Step::Unpacking => tell(Stage::Unpacking),
    })?;
    let occluders = Occluders::largest_of(&scene);
    let camera_path = camera_path.unwrap_or_else(|| default_path(&scene, &occluders));
    let exposure = Exposure::of_scene(&scene, &occluders);
    let exposure = options.exposure_ev.map_or(exposure, |ev| exposure.at_ev(ev));
    Ok(Loaded { scene, connected, camera_path, exposure })
}

impl Stage {
    /// Share that is there, where that is known.
    pub(crate) fn share(&self) -> Option<f32> {
        match self {
            #[expect(clippy::cast_possible_truncation, reason = "for a bar of some hundred pixels")]
            Self::Fetching { have, length, .. } => Some((*have as f64 / (*length).max(1) as f64) as f32),
            Self::Connecting | Self::Unpacking => None,
        }
    }

    /// What is going on, in a line.
    pub(crate) fn text(&self, now: Instant) -> String {
        match self {
            Self::Connecting => "looking for the server".to_owned(),
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

/// How long the rest takes, if it goes on as it did; not known before something has come for a moment.
fn time_left(have: u64, length: u64, took: Duration) -> Option<Duration> {
    let rest = length.saturating_sub(have);
    (have > 0 && took > Duration::from_millis(300)).then(|| {
        let left_s = took.as_secs_f64() * rest as f64 / have as f64;
        // Longer than a day is no forecast.
        Duration::from_secs_f64(left_s.min(86_400.0))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_is_what_the_rest_takes_at_the_speed_so_far() {
        let second = Duration::from_secs(1);
        assert_eq!(time_left(250, 1000, second), Some(3 * second));
        assert_eq!(time_left(1000, 1000, second), Some(Duration::ZERO));
        assert_eq!(time_left(0, 1000, second), None);
        assert_eq!(time_left(1, u64::MAX, second), Some(Duration::from_secs(86_400)));
        assert_eq!(time_left(1, 1000, Duration::from_millis(1)), None);
    }

    #[test]
    fn progress_has_bytes_and_time() {
        let now = Instant::now();
        let stage = Stage::Fetching { have: 1 << 20, length: 4 << 20, since: now };
        assert_eq!(stage.text(now + Duration::from_secs(2)), "scene: 1.0 of 4.0 MiB, 7 s left");
        assert_eq!(stage.share(), Some(0.25));
        assert_eq!(Stage::Connecting.share(), None);
    }
}
