//! Permissions of a token.

use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Scope {
    Session,
    /// Changes the scene in its sessions, for a token with the scope session.
    Edit,
    /// Reads `/metrics` and `/sessions`, and ends sessions.
    Admin,
}
