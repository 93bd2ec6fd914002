//! What a frame is drawn from and lit with: [`frame_loop`] decides with the help of the others.

pub mod frame_loop;
pub mod guard;
pub mod mode;
pub mod stats;
