//! What a client pays for smooth pictures.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Quality {
    /// Each pixel is as its centre is: a light reaches it or does not, as its bit says.
    Low,
    /// Edges of shadows and surfaces cross pixels smoothly (`edges.wgsl`, `tone.wgsl`).
    #[default]
    High,
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown quality {0:?}: use low or high")]
pub struct UnknownQuality(pub String);

impl Quality {
    pub const ALL: [Self; 2] = [Self::Low, Self::High];
}

impl fmt::Display for Quality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Low => "low",
            Self::High => "high",
        })
    }
}

impl FromStr for Quality {
    type Err = UnknownQuality;

    fn from_str(text: &str) -> Result<Self, UnknownQuality> {
        let found = Self::ALL.into_iter().find(|quality| quality.to_string() == text);
        found.ok_or_else(|| UnknownQuality(text.to_owned()))
    }
}
