//! What a user may wish of a scene.

use std::path::PathBuf;

/// Options of [`Scene::load`](crate::Scene::load).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LoadOptions {
    /// A lights file whose lights *replace* those of the scene.
    pub lights_from: Option<PathBuf>,
    /// Keeps only the first N lights that are on: 1 to 32, and not more than the scene has.
    pub max_lights: Option<u32>,
    /// Gives a scene without lights a sun.
    pub default_light: bool,
    /// Name or number of the scene to show, of a file with several. The file's default if absent.
    pub scene: Option<String>,
    /// Name or number of the animation to show; `all` shows them together, each in rounds of its own, and `off` shows
    /// the pose of the file. `off` if absent.
    pub animation: Option<String>,
    /// Name or number of the material variant to show (KHR_materials_variants). The default materials if absent.
    pub variant: Option<String>,
    /// Names of the nodes that people may move and hide ([`Edits`](crate::Edits)); `all` means every node.
    pub editable: Vec<String>,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            lights_from: None,
            max_lights: None,
            default_light: true,
            scene: None,
            animation: None,
            variant: None,
            editable: Vec::new(),
        }
    }
}
