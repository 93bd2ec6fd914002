//! The scene that server and client hold, and its guarantees.

mod aabb;
mod alpha;
pub(crate) mod alpha_rules;
mod animation;
pub(crate) mod check;
mod check_animation;
pub(crate) mod check_shape;
mod material;
pub(crate) mod normals;
mod summary;
mod types;

pub use aabb::Aabb;
pub use alpha::AlphaPicture;
pub use alpha_rules::AlphaChanges;
pub(crate) use animation::blended;
pub use animation::{
    AnimatedCamera, AnimatedLight, AnimatedNode, Animation, Delta, Influence, Interpolation, Joint, OwnVertices, Piece,
    Place, Shape, Target, Track,
};
pub use check::CheckError;
pub use material::{AlphaMode, Clearcoat, Coordinates, Filter, Material, Sheen, Specular, Texture, Transmission, Wrap};
pub use normals::triangle_normal;
pub use summary::Summary;
pub use types::{Draw, Image, Light, LightKind, NamedCamera, Scene};
