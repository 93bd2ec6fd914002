//! The prediction pass: from masks that were traced for other views to the visibility of every pixel of this one.
//!
//! [`mask_words`] turns received bit planes into one word a pixel, and [`layers`] keeps the newest masks.
//! [`depth_history`] knows what their views saw, or [`depth_pass`] draws it again. [`shadow_map`] fills in what they
//! did not see, and [`known`] counts how much that was. [`pass`] runs them all and writes two words a pixel
//! (`wgsl/shading/predict.wgsl`), which the shading passes read.

mod bindings;
pub(crate) mod depth_history;
pub(crate) mod depth_pass;
mod known;
mod layers;
mod mask_view;
mod mask_words;
mod pass;
pub(crate) mod shadow_map;
#[cfg(test)]
mod tests;

pub use mask_view::MaskView;
pub(crate) use pass::PredictPass;
