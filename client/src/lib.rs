//! Gnomon's thin client: rasterises its own frames and shades them with visibility that is traced at the edge.
//!
//! One frame's way: [`camera_path`] → pose out (`net/send.rs`) → G-buffer ([`render`]) → mask in (`net/receive.rs`) →
//! [`mask_buffer`] → shading → picture ([`pictures`]) and statistics ([`stats`]). `frame_loop.rs` is where they meet.
//!
//! In a [`window`], poses come from what a person does ([`input`]) and pictures go to the screen, with an overlay; the rest is the same.

pub mod camera_path;
pub mod cli;
pub mod config;
mod connect;
pub mod default_path;
pub mod error;
mod frame_loop;
pub mod guard;
pub mod headless;
pub mod input;
mod live;
pub mod local_server;
pub mod mask_buffer;
pub mod mode;
pub mod net;
pub mod occluders;
pub mod options;
mod overlay;
pub mod pictures;
pub mod pose_history;
pub mod predictor;
pub mod probe;
mod progress;
pub mod record;
pub mod render;
pub mod scene_cache;
pub mod servers;
pub mod settings;
pub mod stats;
pub mod window;

pub use error::ClientError;
pub use headless::{HeadlessOptions, Source, run_headless};
pub use stats::Summary;
