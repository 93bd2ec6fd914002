//! Editing a scene by hand: what is picked, how a drag moves it, and what is undone.
//!
//! An [`editor::Editor`] keeps what picking needs of a scene ([`stage`]), the chosen node or light, and the
//! [`history`]. It is asked with a [`view`] and the state of the scene that is drawn, and answers with edits for
//! [`FrameLoop::edit`](crate::frame::frame_loop::FrameLoop::edit). There is no window in it: the program around it
//! passes pixels, and draws outlines and [`handles`].

mod change;
mod drag;
pub mod editor;
pub mod handles;
pub mod history;
mod ray;
pub mod stage;
pub mod view;

pub use self::change::with_changes;

use gnomon_scene::Edit;

/// What may be edited.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// Index into [`Animation::nodes`](gnomon_scene::Animation::nodes).
    Node(u32),
    /// Index into [`Scene::lights`](gnomon_scene::Scene::lights).
    Light(u32),
}

impl Target {
    /// Returns what an edit changes.
    #[must_use]
    pub fn of(edit: &Edit) -> Self {
        match edit {
            Edit::Node(node, _) => Self::Node(*node),
            Edit::Light(light, _) => Self::Light(*light),
        }
    }
}
