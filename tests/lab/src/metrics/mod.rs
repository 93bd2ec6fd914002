//! Error metrics: of masks over relevant bits, and of pictures as a viewer sees them.

pub mod bits;
pub mod ffmpeg;
pub mod image;
mod ssim;
pub mod vmaf;

pub use bits::RelevantError;
pub use vmaf::vmaf;
