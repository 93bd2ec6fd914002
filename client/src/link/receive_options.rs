//! How a client takes its frames: which packets make one, and what becomes of it beside being shown.

use std::{fmt, path::PathBuf, str::FromStr};

use gnomon_protocol::reassembler::Policy;
use serde::Deserialize;

/// What is done about packets that are lost, where each can be read alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Packets {
    /// Their frame is lost with them, as in the dissertation.
    WholeFrame,
    /// The others are shown.
    Slices,
    /// The others are shown, and the server hears of the loss and sends parity.
    #[default]
    Parity,
}

impl Packets {
    const ALL: [Self; 3] = [Self::WholeFrame, Self::Slices, Self::Parity];

    const fn name(self) -> &'static str {
        match self {
            Self::WholeFrame => "whole-frame",
            Self::Slices => "slices",
            Self::Parity => "parity",
        }
    }
}

impl fmt::Display for Packets {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Packets {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|packets| packets.name() == text);
        found.ok_or_else(|| format!("{text:?} is none of whole-frame, slices and parity"))
    }
}

/// How a session takes its frames.
#[derive(Debug, Clone, Default)]
pub(crate) struct Reception {
    /// Which packets make a frame.
    pub(crate) policy: Policy,
    /// Whether the server hears how many packets are missing.
    pub(crate) tells_losses: bool,
    /// Folder that every whole frame's body is written to.
    pub(crate) save_masks: Option<PathBuf>,
    /// File to which a line is added for each time that a mask comes out: its frame, packets that had come or were restored, those
    /// restored, and those missing.
    pub(crate) came: Option<PathBuf>,
}
