//! The prediction pass: from masks traced for other views to the visibility of every pixel of the current view.
//!
//! [`mask_words`] converts received bit planes to one word a pixel, and [`layers`] keeps the newest masks.
//! [`depth_history`] has the depth of their views, or [`depth_pass`] draws it again. [`shadow_map`] covers what they
//! did not see. [`pass`] runs them all, counts those pixels and writes two words a pixel (`wgsl/shading/predict.wgsl`),
//! which the shading passes read.

mod bindings;
pub(crate) mod depth_history;
pub(crate) mod depth_pass;
mod eraser;
mod kernels;
mod layers;
mod mask_view;
mod mask_words;
mod moved;
mod pass;
mod pieces;
mod seen;
pub(crate) mod shadow_map;
pub(crate) mod shadow_views;
mod swept;
#[cfg(test)]
mod tests;
mod texels;
mod touched;

pub use mask_view::MaskView;
pub(crate) use pass::PredictPass;
pub(crate) use seen::Seen;
