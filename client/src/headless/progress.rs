//! Progress bars on standard error, when a person looks on: indicatif draws none where that is no terminal.

use std::sync::Mutex;
use std::sync::PoisonError;

use indicatif::{ProgressBar, ProgressStyle};

/// At most one bar: the scene's bytes, then the frames.
#[derive(Debug)]
pub(crate) struct Progress {
    wanted: bool,
    bar: Mutex<Option<(Stage, ProgressBar)>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    Fetching,
    Drawing,
}

impl Progress {
    pub(crate) fn new(wanted: bool) -> Self {
        Self { wanted, bar: Mutex::new(None) }
    }

    /// So many of the scene's bytes have come.
    pub(crate) fn fetching(&self, have: u64, length: u64) {
        self.show(Stage::Fetching, have, length);
    }

    /// So many frames are drawn.
    pub(crate) fn drawing(&self, done: u32, frames: u32) {
        self.show(Stage::Drawing, done.into(), frames.into());
    }

    /// Takes the bar away.
    pub(crate) fn finish(&self) {
        if let Some((_, bar)) = self.bar.lock().unwrap_or_else(PoisonError::into_inner).take() {
            bar.finish_and_clear();
        }
    }

    fn show(&self, stage: Stage, done: u64, length: u64) {
        if !self.wanted {
            return;
        }
        let mut bar = self.bar.lock().unwrap_or_else(PoisonError::into_inner);
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
    // A template that does not parse would cost the bar's looks, not the run.
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}
