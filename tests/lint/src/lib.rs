//! What rustc and clippy do not check in the sources: import circles, long files and long lines.
//!
//! `make lint` and the workspace's tests run it. cargo-modules (`--acyclic`) would do the same and build half of
//! rust-analyzer first.

mod circles;
mod modules;
mod read;
mod sources;
mod uses;

pub use circles::circles;
pub use sources::{Sources, too_long};
