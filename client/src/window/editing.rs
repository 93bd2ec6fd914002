//! Editing by hand in the window: what the pointer picks, holds and drags, and the edits that come of it.

use std::sync::Arc;

use glam::DVec2;
use gnomon_client_core::edit::{
    editor::Editor,
    handles::{Gizmo, Handle},
    stage::Posed,
    view::View,
};
use gnomon_scene::{Edit, Edits, Scene, SceneAt, camera::Camera};

/// A pointer that moves farther while its button is down drags, and does not click. In points.
const CLICK: f64 = 4.0;

/// How near to a handle or a lamp's marker the pointer must be, in points.
const REACH: f64 = 9.0;

/// Radius of the handles' rings, in points.
const RADIUS: f64 = 84.0;

/// Between the window's pixels and the picture's, which is as large as it can be and in the middle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Fit {
    window_px: DVec2,
    picture_px: DVec2,
    /// Pixels of the window for one of the picture.
    scale: f64,
}

impl Fit {
    pub(crate) fn new(window: (u32, u32), picture: (u32, u32)) -> Self {
        let size = |(width, height): (u32, u32)| DVec2::new(width.max(1).into(), height.max(1).into());
        let (window_px, picture_px) = (size(window), size(picture));
        Self { window_px, picture_px, scale: (window_px / picture_px).min_element() }
    }

    pub(crate) fn to_picture(self, window: DVec2) -> DVec2 {
        (window - self.window_px * 0.5) / self.scale + self.picture_px * 0.5
    }

    pub(crate) fn to_window(self, picture: DVec2) -> DVec2 {
        (picture - self.picture_px * 0.5) * self.scale + self.window_px * 0.5
    }
}

/// What the next picture shows, and where.
pub(crate) struct Seen {
    pub(crate) view: View,
    pub(crate) posed: Posed,
    /// With all that was edited, from which edits go on: a picture in step with its masks may lack the newest.
    pub(crate) latest: Posed,
    pub(crate) gizmo: Option<Gizmo>,
    pub(crate) fit: Fit,
    /// Pixels of the window for one point.
    pub(crate) per_point: f64,
}

impl Seen {
    /// Returns a pixel of the window in points, in which the overlay counts.
    pub(crate) fn points(&self, window: DVec2) -> egui::Pos2 {
        #[expect(clippy::cast_possible_truncation, reason = "far outside the window it does not matter where")]
        let [x, y] = (window / self.per_point).to_array().map(|side| side.clamp(-1e6, 1e6) as f32);
        egui::Pos2::new(x, y)
    }

    fn reach_px(&self) -> f64 {
        REACH * self.per_point / self.fit.scale
    }
}

/// The scene under a person's hand.
pub(crate) struct Editing {
    pub(crate) editor: Editor,
    pub(crate) seen: Option<Seen>,
    /// In the window's pixels.
    pointer: DVec2,
    /// Where the button went down, while that may become a click.
    pressed: Option<DVec2>,
    /// Edits for the next picture.
    pub(crate) edits: Vec<Edit>,
}

impl Editing {
    pub(crate) fn new(scene: Scene) -> Self {
        Self { editor: Editor::new(scene), seen: None, pointer: DVec2::ZERO, pressed: None, edits: Vec::new() }
    }

    /// Takes what the next picture is of, and drags what is held. `edited` is all that was edited.
    pub(crate) fn look(&mut self, camera: Camera, mut at: SceneAt, edited: Arc<Edits>, fit: Fit, per_point: f64) {
        let view = View::new(camera, self.editor.space());
        let size = |camera: &Camera| (camera.width, camera.height);
        // A drag counts from a pixel of a picture of one size.
        if self.seen.as_ref().is_some_and(|seen| size(&seen.view.camera) != size(&view.camera)) {
            self.let_go();
        }
        self.edits.extend(self.editor.drag_to(&view, fit.to_picture(self.pointer)));
        let mut latest = SceneAt { time_s: at.time_s, edits: edited };
        for edits in [&mut at.edits, &mut latest.edits].map(Arc::make_mut) {
            for edit in &self.edits {
                // What goes beyond the most is not drawn.
                let _ = edits.apply(*edit);
            }
        }
        let (posed, latest) = (self.editor.stage.pose(&at), self.editor.stage.pose(&latest));
        let gizmo = self.editor.gizmo(&view, &posed, RADIUS * per_point / fit.scale);
        self.seen = Some(Seen { view, posed, latest, gizmo, fit, per_point });
    }

    /// Moves the pointer to a pixel of the window.
    pub(crate) fn pointer_at(&mut self, x: f64, y: f64) {
        self.pointer = DVec2::new(x, y);
        let most = CLICK * self.seen.as_ref().map_or(1.0, |seen| seen.per_point);
        self.pressed = self.pressed.filter(|from| from.distance(self.pointer) <= most);
    }

    /// The pointer's button goes down. Returns whether it holds a handle now, or is over a panel, which `covered` tells
    /// of a place in points.
    pub(crate) fn press(&mut self, covered: impl FnOnce(egui::Pos2) -> bool) -> bool {
        let Some(seen) = &self.seen else { return false };
        if covered(seen.points(self.pointer)) {
            return true;
        }
        let px = (seen.fit.to_picture(self.pointer), seen.reach_px());
        let holds = seen.gizmo.as_ref().is_some_and(|gizmo| self.editor.grab(&seen.view, &seen.latest, gizmo, px));
        self.pressed = (!holds).then_some(self.pointer);
        holds
    }

    /// The button is released: a drag ends, or a click chooses what is there.
    pub(crate) fn release(&mut self) {
        let (Some(seen), pressed) = (&self.seen, self.pressed.take()) else { return };
        if self.editor.holds().is_some() {
            self.edits.extend(self.editor.drag_to(&seen.view, seen.fit.to_picture(self.pointer)));
            self.editor.settle();
        } else if let Some(from) = pressed {
            let picked = self.editor.pick(&seen.view, &seen.posed, seen.fit.to_picture(from), seen.reach_px());
            self.editor.select(picked);
        }
    }

    /// The window has lost the pointer: nothing is held or clicked any more.
    pub(crate) fn let_go(&mut self) {
        self.pressed = None;
        self.editor.settle();
    }

    /// The handle that is held, or under the pointer.
    pub(crate) fn active(&self) -> Option<Handle> {
        let seen = self.seen.as_ref()?;
        let under = || seen.gizmo.as_ref()?.at(seen.fit.to_picture(self.pointer), seen.reach_px());
        self.editor.holds().or_else(under)
    }

    pub(crate) fn undo(&mut self) {
        self.edits.extend(self.editor.undo());
    }

    pub(crate) fn redo(&mut self) {
        self.edits.extend(self.editor.redo());
    }

    /// Gives up a drag. Returns whether there was one.
    pub(crate) fn cancel(&mut self) -> bool {
        let held = self.editor.holds().is_some();
        self.edits.extend(self.editor.cancel());
        held
    }

    /// Ends editing for now. What was done can still be undone later.
    pub(crate) fn leave(&mut self) {
        self.let_go();
        self.editor.select(None);
        self.seen = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_in_the_middle_of_the_window() {
        for (window, picture, corner) in [
            ((1280, 720), (1280, 720), DVec2::ZERO),
            ((1360, 720), (1280, 720), DVec2::new(40.0, 0.0)),
            ((640, 720), (1280, 720), DVec2::new(0.0, 180.0)),
        ] {
            let fit = Fit::new(window, picture);
            assert_eq!(fit.to_window(DVec2::ZERO), corner);
            assert_eq!(fit.to_picture(fit.to_window(DVec2::new(32.0, 64.0))), DVec2::new(32.0, 64.0));
        }
    }
}
