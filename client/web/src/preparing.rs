//! How far a scene is on its way from bytes to pictures.

use gnomon_client_core::render::FrameRenderer;
use gnomon_scene::Scene;

pub(crate) enum Preparing {
    Unpacked(Box<Scene>),
    /// The adapter compiles.
    Uploaded(Box<(Scene, FrameRenderer)>),
    /// Poses can be sent. How light it is is not known yet.
    Dark(Box<Scene>),
}
