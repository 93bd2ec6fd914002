use gnomon_scene::camera::Camera;

/// A camera, and the time at which it sees the scene: what a picture or a mask shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Viewpoint {
    pub camera: Camera,
    /// Time of the scene, in seconds. 0 if everything rests, for then a camera sees the same at any time.
    pub scene_time_s: f64,
}

impl Viewpoint {
    /// A view of a scene in which everything rests.
    #[must_use]
    pub fn resting(camera: Camera) -> Self {
        Self { camera, scene_time_s: 0.0 }
    }
}
