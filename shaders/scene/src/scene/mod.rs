//! The scene that server and client hold, and its guarantees.

mod alpha;
pub(crate) mod alpha_rules;
pub(crate) mod check;
mod material;
pub(crate) mod normals;
mod summary;
mod types;

pub use alpha::AlphaPicture;
pub use alpha_rules::AlphaChanges;
pub use check::CheckError;
pub use material::{AlphaMode, Clearcoat, Coordinates, Filter, Material, Sheen, Specular, Texture, Transmission, Wrap};
pub use normals::triangle_normal;
pub use summary::Summary;
pub use types::{Aabb, Draw, Image, Light, LightKind, NamedCamera, Scene};
