//! The renderer: G-buffer → predicted visibility → shading → blended surfaces → tone mapping.
//!
//! It draws into any texture view and uses no files, windows or network. `renderer.rs` runs the passes, one file each.
//! [`predict`] carries visibility over from the views that masks were traced for.

mod blend;
mod counts;
pub mod debug_view;
mod draft;
#[cfg(test)]
mod edge_tests;
pub mod environment;
mod error;
pub mod exposure;
mod gbuffer;
mod material;
#[cfg(test)]
mod material_tests;
mod meter;
mod movers;
mod pipeline;
pub mod predict;
pub mod present;
mod put_off;
pub mod quality;
pub mod readback;
mod renderer;
mod scene_upload;
mod shade;
pub mod stages;
pub mod survey;
pub mod targets;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
#[cfg(test)]
mod tests;
mod texture;
mod time;
pub mod tone;
mod vertex;
pub mod work;

pub use error::RenderError;
pub use renderer::{FrameRenderer, PixelVisibility};
pub use targets::PICTURE_FORMAT;
