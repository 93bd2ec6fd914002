//! Editing the scene that plays: whether a person may, what they see while they do, and where their edits go.

use std::{sync::Arc, time::Instant};

use gnomon_client_core::mask::world::WorldError;
use gnomon_scene::SceneAt;

use super::{editing::Fit, play::Play, settings::Settings};
use crate::mode::State;

impl Play {
    /// Why the scene cannot be edited. `None` if it can.
    pub(super) fn not_editable(&self) -> Option<String> {
        let may_edit = self.driver.frames.matcher.world.may_edit() && self.editing.is_some();
        (!may_edit).then(|| WorldError::NotAllowed.to_string())
    }

    /// What the next picture shows of the scene: at this time, unless the server's clock gives another.
    pub(super) fn scene_at(&self, scene_time_s: f64) -> SceneAt {
        let world = &self.driver.frames.matcher.world;
        let time_s = world.scene_time_s(Instant::now()).unwrap_or(scene_time_s);
        SceneAt { time_s, edits: Arc::clone(world.drawn()) }
    }

    /// Looks at what the next picture shows, if the person edits; says why not, if that is so.
    pub(super) fn look(&mut self, settings: &mut Settings, window: (u32, u32), per_point: f32) {
        if settings.edit
            && let Some(why) = self.not_editable()
        {
            settings.edit = false;
            self.message = Some(why);
        }
        let (scene_time_s, fit) = (self.scene_time_s(), Fit::new(window, self.size()));
        let mut camera = self.camera(scene_time_s);
        let mut at = self.scene_at(scene_time_s);
        let edited = Arc::clone(&at.edits);
        // A picture in step with its masks is of an earlier view.
        if let Some(last) = self.driver.last.as_ref().filter(|last| last.decision.state == State::Sequential) {
            (camera, at) = (last.camera, last.scene.clone());
        }
        let Some(editing) = &mut self.editing else { return };
        if settings.edit {
            editing.look(camera, at, edited, fit, per_point.into());
        } else {
            editing.leave();
        }
    }

    /// Passes on what the person has edited since the last picture.
    pub(super) fn send_edits(&mut self) {
        let Some(editing) = &mut self.editing else { return };
        let edits = std::mem::take(&mut editing.edits);
        if let Err(error) = self.driver.frames.edit(&edits) {
            editing.leave();
            self.message = Some(error.to_string());
        }
    }
}
