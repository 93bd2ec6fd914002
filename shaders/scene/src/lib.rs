//! The scene: flattened triangles, materials, textures and lights, in the space that server and client compute in.
//!
//! [`load`] tells glTF from the packed form; [`reader`] turns glTF into a [`Scene`]; [`pack`] turns a scene into bytes
//! to send, and back. [`moment`] says where everything is at a time, [`edits`] what people have changed. [`camera`]
//! gives each pixel's ray, [`motion`] predicts the camera. [`limits`] holds every bound.
//! Only [`file`], [`testing`] and [`fuzzing`] touch files.

pub mod camera;
mod edits;
mod error;
mod file;
#[doc(hidden)]
pub mod fuzzing;
mod light;
mod lights;
mod lights_file;
pub mod limits;
mod load;
mod load_options;
mod moment;
pub mod motion;
mod pack;
mod picture;
mod reader;
mod scene;
mod scene_at;
#[doc(hidden)]
pub mod testing;

pub use edits::{Edit, EditError, Edits, LightEdit, NodeEdit};
pub use error::SceneError;
pub use load_options::LoadOptions;
pub use moment::{Moment, NodeAt, Placement};
pub use pack::PackError;
pub use reader::{LoadReport, Warning, WarningKind};
pub use scene::{
    Aabb, AlphaChanges, AlphaMode, AlphaPicture, AnimatedCamera, AnimatedLight, AnimatedNode, Animation, CheckError,
    Clearcoat, Coordinates, Delta, Draw, Filter, Image, Influence, Interpolation, Joint, Light, LightKind, Material,
    NamedCamera, OwnVertices, Piece, Place, Scene, Shape, Sheen, Specular, Summary, Target, Texture, Track,
    Transmission, Wrap, triangle_normal,
};
pub use scene_at::SceneAt;
