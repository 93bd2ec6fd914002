//! How a client handles lost packets, and which files record its frames.

use std::{fmt, path::PathBuf, str::FromStr};

use gnomon_protocol::reassembler::Policy;

/// Handling of lost packets in codecs whose packets can be decoded alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Packets {
    /// A lost packet loses its frame, as in the dissertation.
    WholeFrame,
    /// The other packets are shown.
    Slices,
    /// The other packets are shown; the server is told of the loss and sends parity.
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

#[derive(Debug, Clone, Default)]
pub(crate) struct Reception {
    pub(crate) policy: Policy,
    /// Report lost packets to the server.
    pub(crate) reports_losses: bool,
    /// Folder for the body of each complete frame; all frames are then coded without a reference.
    pub(crate) save_masks: Option<PathBuf>,
    /// Log with a line for each delivered mask: frame, packets received or restored, packets restored, packets
    /// missing, digest.
    pub(crate) mask_log: Option<PathBuf>,
}
