//! The client in a window.
//!
//! Poses come from a person ([`play`]), and pictures go to a screen ([`screen`]); all passes are those of headless
//! runs. Everything runs on the window's thread, except for [`loading`], starting the local [`reference`], and the
//! network.

mod app;
mod background;
mod editing;
mod events;
mod gamepad;
mod keys;
mod loading;
mod overlay;
mod painter;
mod play;
mod play_editing;
mod reference;
mod screen;
mod settings;
#[cfg(test)]
mod tests;

pub use app::run_window;
