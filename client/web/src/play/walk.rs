//! A walk along a path: each frame waits for its own mask, so that pictures do not depend on times.

use gnomon_client_core::{
    frame::stats::StageTimes,
    mask::digest::digest,
    render::{FrameRenderer, RenderError},
};
use gnomon_protocol::ids::FrameNumber;
use gnomon_scene::camera::Camera;
use web_time::Instant;

use super::{Drawn, PATIENCE, Play};

impl Play {
    /// Draws the next frame of a walk as soon as its own mask has come.
    pub(super) fn walk(
        &mut self,
        now: Instant,
        target: impl FnOnce(&mut FrameRenderer, &Camera, f32) -> Result<(), RenderError>,
    ) -> Result<Option<Drawn>, RenderError> {
        let Some(walk) = self.options.walk.as_ref().filter(|_| self.reception.is_some()) else { return Ok(None) };
        let (width, height) = self.frames.renderer.size();
        let (frame, time_s) = (FrameNumber(self.next), walk.time_s(self.next));
        let camera = walk.path.camera(time_s, width, height);
        let arrived = self.next + 1 >= walk.frames;
        match self.awaited_since {
            None => {
                let request = self.frames.request(frame, &camera, time_s, now, true);
                if let (Some(reception), Some(pose)) = (&mut self.reception, &request.pose) {
                    reception.send_pose(frame, pose);
                }
                self.awaited_since = Some(now);
            }
            Some(since) if now.saturating_duration_since(since) > PATIENCE => self.ask_again(now),
            Some(_) => {}
        }
        if !self.has_mask_of(frame.0) {
            return Ok(None);
        }
        let response = self.frames.accept_masks(self.front.iter(), now)?;
        let digest = self.front.back().map(|mask| digest(&mask.mask)).unwrap_or_default();
        let drawing = self.frames.choose(frame, &camera, now);
        self.frames.renderer.set_time(&drawing.scene);
        self.frames.renderer.draw_surfaces(&drawing.camera)?;
        target(&mut self.frames.renderer, &drawing.camera, drawing.decision.visibility_share)?;
        let outcome = (&drawing, 0, response);
        let stats = self.frames.stats(frame, now, outcome, &StageTimes::default(), "live");
        self.next += 1;
        self.awaited_since = None;
        Ok(Some(Drawn { stats, walked: Some((frame.0, digest)), arrived }))
    }

    /// Returns the next frame of the walk, while there is one.
    #[must_use]
    pub fn next_of_walk(&self) -> Option<u32> {
        self.options.walk.as_ref().map(|_| self.next)
    }

    /// Leaves the walk's path to the person, who goes on from its end.
    pub fn end_walk(&mut self) {
        if let Some(walk) = self.options.walk.take() {
            let camera = walk.path.camera(walk.path.duration_s(), 1, 1);
            self.stand(&camera);
            self.frames.stream(!self.gpu.is_software());
        }
    }
}
