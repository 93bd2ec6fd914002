//! How wrong a result is: masks over the bits that matter, pictures by what a viewer sees.

pub mod bits;
pub mod image;
mod ssim;
pub mod vmaf;

pub use bits::RelevantError;
pub use vmaf::vmaf;
