//! Gnomon's client for browsers.
//!
//! A page (`page/`) owns what a browser has: sockets, caches, canvas, keys and words. A worker runs this crate, which
//! has the rest: [`conversation`] and [`reception`] speak the protocol, bytes in and bytes out; [`play`] walks through
//! the scene with the native client's core and renderer. `client.rs` is what JavaScript sees of them, and the only part
//! that no other target compiles.

#[cfg(target_arch = "wasm32")]
mod client;
pub mod conversation;
#[cfg(target_arch = "wasm32")]
mod decode_times;
pub mod figures;
pub mod keys;
pub mod options;
pub mod pace;
pub mod play;
#[cfg(target_arch = "wasm32")]
mod preparing;
pub mod reception;
pub mod renderer;
pub mod scene_fetch;
#[cfg(target_arch = "wasm32")]
mod screen;
pub mod view;
