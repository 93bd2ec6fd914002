//! How a client receives its frames: which packets make one, and which files record it.

use std::{fmt, path::PathBuf, str::FromStr};

use gnomon_protocol::reassembler::Policy;

/// What is done about lost packets where each packet can be decoded alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Packets {
    /// They lose their frame, as in the dissertation.
    WholeFrame,
    /// The other packets are shown.
    Slices,
    /// The other packets are shown, and the server learns of the loss and sends parity.
    #[default]
    Parity,
}

impl Packets {
    pub(crate) const ALL: [Self; 3] = [Self::WholeFrame, Self::Slices, Self::Parity];

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

/// How a session receives its frames.
#[derive(Debug, Clone, Default)]
pub(crate) struct Reception {
    pub(crate) policy: Policy,
    /// Report lost packets to the server.
    pub(crate) reports_losses: bool,
    /// Folder for the body of each whole frame. Each is then coded without a reference.
    pub(crate) save_masks: Option<PathBuf>,
    /// File to which each delivered mask adds a line: frame, packets received or restored, packets restored, packets
    /// missing.
    pub(crate) mask_log: Option<PathBuf>,
}
