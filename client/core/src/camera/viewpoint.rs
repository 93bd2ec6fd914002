use gnomon_scene::{SceneAt, camera::Camera};

/// A camera, and the state of the scene that it sees: what a picture or a mask shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Viewpoint {
    pub camera: Camera,
    /// Its time is 0 if nothing moves with time, for then a camera sees the same at any time.
    pub scene: SceneAt,
}

impl Viewpoint {
    /// A view of a scene in which everything rests.
    #[must_use]
    pub fn resting(camera: Camera) -> Self {
        Self { camera, scene: SceneAt::default() }
    }
}
