//! What pictures are worth: smooth edges or hard ones, and drafts while the adapter compiles.

use super::{quality::Quality, renderer::FrameRenderer};

impl FrameRenderer {
    /// Sets the quality from the next picture on; low at first.
    pub fn set_quality(&mut self, quality: Quality) {
        self.quality = quality;
        let drawn = if self.draft { Quality::Low } else { quality };
        self.tone.set_quality(drawn);
        self.shade.set_quality(drawn);
    }

    /// Drafts have hard edges and no BLEND surfaces, whatever the quality. They take a third of the pipelines: a client
    /// whose adapter compiles slowly shows one while the rest is compiled.
    pub fn set_draft(&mut self, draft: bool) {
        self.draft = draft;
        self.set_quality(self.quality);
    }

    /// Compiles what the next pictures take, instead of when they need it: for drafts, what those take that have whole
    /// masks of their own views.
    pub fn compile(&mut self) {
        let device = &self.gpu.device;
        self.predict.compile(&self.gpu, &self.scene, self.draft);
        self.shade.compile(device);
        self.tone.compile(device);
        if !self.draft {
            self.blend.compile(&self.scene);
            self.meter.compile(device);
        }
    }
}
