//! Received masks on their way to the renderer.

pub mod buffer;
