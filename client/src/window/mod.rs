//! The client in a window.
//!
//! It shares every pass with headless runs: poses come from a person ([`play`]), pictures go to a screen ([`screen`]).
//! Everything runs on the thread that owns the window, except for [`loading`], the local [`reference`]'s start, and the
//! network.

mod app;
mod background;
mod events;
mod gamepad;
mod keys;
mod loading;
mod overlay;
mod painter;
mod play;
mod reference;
mod screen;
mod settings;
#[cfg(test)]
mod tests;

pub use app::run_window;
