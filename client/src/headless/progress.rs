//! Progress bars on standard error; indicatif hides them if that is no terminal.

use indicatif::{ProgressBar, ProgressStyle};
use parking_lot::Mutex;

/// One bar at a time: the scene's bytes, then the frames.
#[derive(Debug)]
pub(crate) struct Progress {
    enabled: bool,
    bar: Mutex<Option<(Stage, ProgressBar)>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    Fetching,
    Drawing,
}

impl Progress {
    pub(crate) fn new(enabled: bool) -> Self {
        Self { enabled, bar: Mutex::new(None) }
    }

    pub(crate) fn fetching(&self, have: u64, length: u64) {
        self.show(Stage::Fetching, have, length);
    }

    pub(crate) fn drawing(&self, done: u32, frames: u32) {
        self.show(Stage::Drawing, done.into(), frames.into());
    }

    pub(crate) fn finish(&self) {
        if let Some((_, bar)) = self.bar.lock().take() {
            bar.finish_and_clear();
        }
    }

    fn show(&self, stage: Stage, done: u64, length: u64) {
        if !self.enabled {
            return;
        }
        let mut bar = self.bar.lock();
        if bar.as_ref().is_none_or(|(shown, _)| *shown != stage) {
            if let Some((_, old)) = bar.take() {
                old.finish_and_clear();
            }
            *bar = Some((stage, new_bar(stage, length)));
        }
        if let Some((_, bar)) = &*bar {
            bar.set_position(done);
        }
    }
}

fn new_bar(stage: Stage, length: u64) -> ProgressBar {
    let template = match stage {
        Stage::Fetching => "scene  {wide_bar} {bytes}/{total_bytes} ({bytes_per_sec})",
        Stage::Drawing => "frames {wide_bar} {pos}/{len} ({per_sec}, {eta} left)",
    };
    let bar = ProgressBar::new(length);
    // A broken template must not end the run.
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}
