//! Settings of Gnomon's programs. A program declares each setting once, as a field of a struct that derives
//! [`clap::Args`]: name, type, unit, default, help and bounds. This crate gives the setting its other forms:
//!
//! | flag | environment variable | TOML key | also |
//! |---|---|---|---|
//! | `--max-sessions 8` | `GNOMON_MAX_SESSIONS=8` | `max_sessions = 8` | help, man page, completions, checks |
//!
//! Precedence: defaults < TOML < environment < flags. A value from TOML or the environment becomes clap's default
//! value, so one parser and one set of bounds serve every layer. Each layer is parsed alone first: an error names the
//! flag, variable or key that the value came from, even if a higher layer overrides it.

mod declare;
mod error;
mod file;
pub mod files;
mod layer;
mod load;
mod page;
mod switch;
mod terminal;
pub mod variables;

pub use clap_complete::Shell;
pub use declare::{Bounds, command, defaults, one_of};
pub use error::SettingsError;
pub use file::line_of;
pub use load::{Layers, Loaded, Source, parse_toml};
pub use page::{page, problems};
pub use switch::Switch;
pub use terminal::wants_colour;
