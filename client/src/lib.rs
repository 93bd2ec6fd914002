//! Gnomon's thin client: rasterises its own frames and shades them with visibility traced at the edge.
//!
//! A frame's path: [`camera_path`] → pose out (`link/send.rs`) → G-buffer ([`render`]) → mask in (`link/receive.rs`) →
//! `link/mask_buffer.rs` → shading → picture and statistics ([`headless`]). `frame_driver.rs` connects these.
//!
//! In a [`window`], poses come from a person ([`input`]) and pictures go to the screen, with an overlay.

pub mod app;
pub mod camera_path;
pub mod cli;
pub mod config;
pub mod environment;
pub mod error;
mod frame_driver;
#[doc(hidden)]
pub mod fuzzing;
pub mod headless;
pub mod link;
pub mod options;
pub mod record;
pub mod stop;
pub mod target;
#[cfg(feature = "window")]
pub mod window;

pub use error::ClientError;
pub use gnomon_client_core::{
    camera::{Viewpoint, default_path},
    frame::{guard, mode},
    input,
    mask::pose_history,
    occluders, predictor, render,
};
pub use headless::{
    run::{run_headless, run_headless_until},
    stats::Summary,
};
pub use options::{HeadlessOptions, Source};
