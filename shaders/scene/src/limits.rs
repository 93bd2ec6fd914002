//! Every bound on a scene and its files. All are checked before memory is taken.
//!
//! A scene at all of these bounds takes about 5 GiB while it loads. A file that breaks one takes far less, because
//! counts are summed from the JSON before the first vertex is read.

use glam::{DVec3, Vec2};

/// Largest scene file or file beside it, in bytes.
pub const MAX_FILE_BYTES: u64 = 512 << 20;

/// Largest JSON text, in bytes. Larger geometry belongs in a `.bin` or a `.glb`, not into data URIs.
pub const MAX_JSON_BYTES: u64 = 64 << 20;

/// Largest sum of all buffers, in bytes.
pub const MAX_BUFFER_BYTES: u64 = 512 << 20;

/// Largest lights file, in bytes.
pub const MAX_LIGHTS_FILE_BYTES: u64 = 1 << 20;

pub const MAX_BUFFERS: usize = 1 << 12;
pub const MAX_BUFFER_VIEWS: usize = 1 << 19;
pub const MAX_ACCESSORS: usize = 1 << 19;

/// Most elements of one accessor: the corners of [`MAX_TRIANGLES`].
pub const MAX_ACCESSOR_ELEMENTS: u64 = 3 * MAX_TRIANGLES;

pub const MAX_MESHES: usize = 1 << 17;
pub const MAX_NODES: usize = 1 << 18;

/// Most nodes from a root to a leaf.
pub const MAX_DEPTH: usize = 1024;

/// Most scenes in a file.
pub const MAX_SCENES: usize = 1 << 12;

pub const MAX_MATERIALS: usize = 1 << 14;

/// Most textures, and most samplers.
pub const MAX_TEXTURES: usize = 1 << 14;

pub const MAX_IMAGES: usize = 1 << 12;

/// Most values in one element of the JSON's lists, such as a mesh with all its primitives.
pub const MAX_ELEMENT_VALUES: usize = 1 << 21;

/// Most names in `extensionsRequired`, and in `extensionsUsed`.
pub const MAX_EXTENSIONS: usize = 1 << 8;

/// Most light definitions in a file. At most [`MAX_LIGHTS`] of them may be placed.
pub const MAX_LIGHT_DEFINITIONS: usize = 1 << 12;

/// Most camera definitions in a file. At most [`MAX_CAMERAS`] of them are kept.
pub const MAX_CAMERA_DEFINITIONS: usize = 1 << 12;

pub const MAX_SKINS: usize = 1 << 14;

/// Most material variants (KHR_materials_variants).
pub const MAX_VARIANTS: usize = 1 << 12;

/// Most steps of posing: vertices times the morph targets and sets of joints that move them, once for each instance.
pub const MAX_POSE_STEPS: u64 = 1 << 28;

/// Most animations of a file, and most channels and samplers of one that are read.
pub const MAX_ANIMATIONS: usize = 1 << 14;
pub const MAX_CHANNELS: usize = 1 << 18;

/// Most times and values of all tracks together: 64 MiB.
pub const MAX_TRACK_VALUES: u64 = 1 << 24;

/// Most animated nodes, and most pieces of geometry that move.
pub const MAX_MOVING: u64 = 1 << 16;

/// Most joints of all pieces that follow skins, each counted once for each piece. A piece has at most 65,536.
pub const MAX_JOINTS: u64 = 1 << 18;

/// Most sets of four joints that a vertex follows.
pub const MAX_JOINT_SETS: u32 = 4;

/// Most changes of a vertex by a morph target whose weight moves: 288 MiB.
pub const MAX_DELTAS: u64 = 1 << 23;

/// Most different warnings of one file. Further ones are counted.
pub const MAX_WARNINGS: usize = 64;

/// Most triangles after flattening: shared meshes count once for each instance.
pub const MAX_TRIANGLES: u64 = 1 << 24;

/// Most vertices after flattening.
pub const MAX_VERTICES: u64 = 1 << 24;

/// Most draws: primitives times the instances of their meshes.
pub const MAX_DRAWS: u64 = 1 << 20;

/// Largest encoded image, in bytes.
pub const MAX_IMAGE_BYTES: u64 = 64 << 20;

/// Largest sum of all encoded images, in bytes.
pub const MAX_IMAGES_BYTES: u64 = 256 << 20;

/// Largest width or height of an image: every adapter takes such a texture.
pub const MAX_IMAGE_SIDE_PX: u32 = 8192;

/// Most pixels in all images together: 512 MiB decoded. Images of a file that have more are scaled down.
pub const MAX_IMAGES_PIXELS: u64 = 1 << 27;

/// Largest width or height of an image in a file before it is scaled down.
pub const MAX_SOURCE_IMAGE_SIDE_PX: u32 = 1 << 14;

/// Most pixels of one image in a file before it is scaled down: 512 MiB decoded.
pub const MAX_SOURCE_IMAGE_PIXELS: u64 = 1 << 27;

/// Most pixels in all images of a file before they are scaled down. It bounds the time that decoding takes.
pub const MAX_SOURCE_IMAGES_PIXELS: u64 = 1 << 32;

/// Most memory that decoding one image takes besides its pixels, in bytes.
pub const MAX_IMAGE_SCRATCH_BYTES: u64 = 512 << 20;

/// Most lights of a scene: one bit of a 32-bit visibility word each.
pub const MAX_LIGHTS: usize = 32;

/// Most cameras of a scene.
pub const MAX_CAMERAS: usize = 1 << 8;

/// Farthest that a vertex or a light may lie from the world's origin, in metres, per axis. Poses have the same bound,
/// and squares and products of such distances stay within f32.
pub const MAX_COORDINATE_M: f64 = 1e9;

/// Nodes and lights of a scene that are edited at once.
pub const MAX_EDITED: usize = 1024;

/// Returns whether a position in world space is finite and within [`MAX_COORDINATE_M`].
pub(super) fn in_reach(position: DVec3) -> bool {
    // Each coordinate is compared, because `max_element` ignores NaN.
    position.to_array().iter().all(|coordinate| coordinate.abs() <= MAX_COORDINATE_M)
}

/// Returns whether a texture coordinate is finite and within [`MAX_UV`].
pub(super) fn is_legal_uv(uv: Vec2) -> bool {
    uv.to_array().iter().all(|coordinate| coordinate.abs() <= MAX_UV)
}

/// Largest absolute texture coordinate. Within it, u × width fits an i32; beyond it, an f32 no longer resolves the
/// texels of an 8192-pixel picture.
pub const MAX_UV: f32 = 65536.0;

/// Longest name that a scene keeps, in bytes.
pub const MAX_NAME_BYTES: usize = 256;

/// Largest packed scene, in bytes.
pub const MAX_PACKED_BYTES: u64 = 1 << 30;

/// Largest packed scene before compression, in bytes.
pub const MAX_UNPACKED_BYTES: u64 = 1 << 30;
