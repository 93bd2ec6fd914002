//! What stands over the picture: figures, graphs, settings, help, and messages about the server.
//!
//! Everything here also has a key ([`crate::input::keys::HELP`]). The colours are those of Okabe and Ito (2008), which
//! colour-blind people can tell apart, and colour is never the only sign.

pub(super) mod figures;
mod graphs;
mod panel;
mod screens;
mod style;

pub(super) use self::{
    panel::{Status, show},
    screens::{failure, loading},
    style::set_style,
};
