use gnomon_protocol::{coverage::Coverage, mask::Mask};
use gnomon_scene::{SceneAt, camera::Camera};

use crate::camera::Viewpoint;

/// A mask and the view that it was traced for.
#[derive(Debug, Clone, Copy)]
pub struct MaskView<'a> {
    pub mask: &'a Mask,
    /// `None` if all tiles have arrived.
    pub coverage: Option<&'a Coverage>,
    /// True if it adds tiles to the newest mask.
    pub more: bool,
    /// Its camera, with the mask's own width, height and field of view.
    pub traced_for: &'a Camera,
    /// The state of the scene that it was traced for. Its time is 0 if nothing moves with time.
    pub scene: &'a SceneAt,
}

impl MaskView<'_> {
    /// What the mask shows.
    pub(crate) fn viewpoint(&self) -> Viewpoint {
        Viewpoint { camera: *self.traced_for, scene: self.scene.clone() }
    }
}
