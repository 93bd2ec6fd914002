//! The scene: flattened triangles, materials, textures and lights, in the space that both ends compute in.
//!
//! Positions are f32, relative to [`Scene::origin_m`], which is f64. Everything that does not move is flattened: node
//! transforms are applied, shared meshes are repeated, strips and fans are lists, mirrored nodes keep their front faces.

pub mod camera;
mod error;
mod file;
#[doc(hidden)]
pub mod fuzzing;
mod light;
mod lights_file;
pub mod limits;
mod load;
pub mod motion;
mod pack;
mod picture;
mod reader;
mod scene;
#[doc(hidden)]
pub mod testing;

pub use error::SceneError;
pub use load::LoadOptions;
pub use pack::PackError;
pub use reader::LoadReport;
pub use scene::{
    Aabb, AlphaMode, AlphaPicture, CheckError, Draw, Image, Light, LightKind, Material, Scene, Summary, Texture, Wrap,
    triangle_normal,
};
