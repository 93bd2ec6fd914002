//! Gnomon's thin client: rasterises its own frames and shades them with visibility that is traced at the edge.
//!
//! One frame's way: [`camera_path`] → pose out (`net/send.rs`) → G-buffer ([`render`]) → mask in (`net/receive.rs`) →
//! [`mask_buffer`] → shading → picture ([`pictures`]) and statistics ([`stats`]). `frame_loop.rs` is where they meet.
//!
//! In a [`window`], poses come from what a person does ([`input`]) and pictures go to the screen, with an overlay; the rest is the same.

pub mod cli;
pub mod config;
mod connect;
pub mod error;
mod frame_loop;
pub mod headless;
mod live;
pub mod local_server;
pub mod net;
pub mod options;
mod overlay;
pub mod pictures;
pub mod probe;
mod progress;
pub mod record;
pub mod scene_cache;
pub mod servers;
pub mod settings;
pub mod stats;
pub mod window;

pub use error::ClientError;
pub use gnomon_client_core::{
    camera::{default_path, path as camera_path},
    frame::{guard, mode, pose_history},
    input,
    mask::buffer as mask_buffer,
    occluders, predictor, render,
};
pub use headless::{HeadlessOptions, Source, run_headless};
pub use stats::Summary;
