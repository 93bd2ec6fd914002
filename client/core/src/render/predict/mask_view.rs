use gnomon_protocol::{coverage::Coverage, mask::Mask};
use gnomon_scene::camera::Camera;

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
    /// Time of the scene that it was traced for, in seconds; 0 if everything rests.
    pub scene_time_s: f64,
}

impl MaskView<'_> {
    /// What the mask shows.
    pub(crate) fn viewpoint(&self) -> Viewpoint {
        Viewpoint { camera: *self.traced_for, scene_time_s: self.scene_time_s }
    }
}
