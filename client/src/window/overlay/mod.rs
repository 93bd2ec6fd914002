//! The overlay: figures, graphs, settings, help, messages about the server, and what a person edits.
//!
//! Every setting also has a key ([`crate::input::keys::HELP`]). The palette is that of Okabe and Ito (2008), which
//! colour-blind people can distinguish; colour is never the only sign.

pub(super) mod edit_panel;
pub(super) mod figures;
pub(super) mod gizmo;
mod graphs;
mod panel;
mod screens;
mod style;

pub(super) use self::{
    panel::{Status, show},
    screens::{failure, first_visit, loading},
    style::set_style,
};
