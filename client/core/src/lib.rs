//! The client's core: decides what to draw, from which pose and with which mask, and draws it.
//!
//! No socket, file, thread or clock: time, bytes and masks are arguments, so the crate also builds for browsers.

pub mod camera;
pub mod edit;
pub mod frame;
pub mod input;
pub mod mask;
pub mod occluders;
pub mod predictor;
pub mod render;
