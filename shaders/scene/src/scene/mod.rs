//! The scene that server and client hold, and its guarantees.

mod alpha;
pub(crate) mod check;
pub(crate) mod normals;
mod summary;
mod types;

pub use alpha::AlphaPicture;
pub use check::CheckError;
pub use normals::triangle_normal;
pub use summary::Summary;
pub use types::{Aabb, AlphaMode, Draw, Image, Light, LightKind, Material, Scene, Texture, Wrap};
