//! Tokens for the server under attack.

use std::{fs, path::Path};

use anyhow::{Context as _, Result};
use gnomon_server::tokens::{self, Scope};

pub(super) struct Tokens {
    pub(super) good: String,
    pub(super) expired: String,
    pub(super) once: String,
}

impl Tokens {
    pub(super) fn write(folder: &Path) -> Result<Self> {
        let make = |once| tokens::make("", Some(1), &[Scope::Session], once).context("making a token");
        let [(good, good_entry), (expired, expired_entry), (once, once_entry)] =
            [make(false)?, make(false)?, make(true)?];
        let ended = expired_entry
            .lines()
            .map(|line| if line.starts_with("expires") { "expires = 2020-01-01T00:00:00Z" } else { line });
        let ended: Vec<_> = ended.collect();
        fs::write(folder.join("tokens"), format!("{good_entry}{}\n{once_entry}", ended.join("\n")))?;
        Ok(Self { good, expired, once })
    }
}
