//! The ways to predict visibility from a mask that was traced for another view.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Predictor {
    /// No prediction: each pixel takes its own bit of the newest mask, whatever view that was traced for.
    None,
    /// The dissertation's (§3.6): the nearest sample; points outside the mask's picture are unknown.
    Dissertation(Unknown),
    /// By surface: a sample counts if its point lies on the pixel's surface. Shadow edges are placed between samples;
    /// points that no sample saw are looked up in the client's shadow maps.
    #[default]
    Surface,
}

/// What the dissertation's predictor does with unknown points (its Figure 12).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Unknown {
    /// Every light reaches them.
    #[default]
    Lit,
    /// No light reaches them.
    Shadow,
    /// They take the bit that the mask has at their own pixel.
    Copy,
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown predictor {0:?}: use none, dissertation, dissertation-shadow, dissertation-copy or surface")]
pub struct UnknownPredictor(pub String);

impl Predictor {
    pub const ALL: [(&'static str, Self); 5] = [
        ("none", Self::None),
        ("dissertation", Self::Dissertation(Unknown::Lit)),
        ("dissertation-shadow", Self::Dissertation(Unknown::Shadow)),
        ("dissertation-copy", Self::Dissertation(Unknown::Copy)),
        ("surface", Self::Surface),
    ];
}

impl Predictor {
    /// The values of `predictor` and `unknown` in `predict.wgsl`.
    pub(crate) fn shader_constants(self) -> (u32, u32) {
        match self {
            Self::None => (0, 0),
            Self::Dissertation(Unknown::Lit) => (1, 0),
            Self::Dissertation(Unknown::Shadow) => (1, 1),
            Self::Dissertation(Unknown::Copy) => (1, 2),
            Self::Surface => (2, 0),
        }
    }
}

impl fmt::Display for Predictor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = Self::ALL.iter().find(|(_, predictor)| predictor == self).map_or("", |(name, _)| name);
        f.write_str(name)
    }
}

impl FromStr for Predictor {
    type Err = UnknownPredictor;

    fn from_str(text: &str) -> Result<Self, UnknownPredictor> {
        let found = Self::ALL.iter().find(|(name, _)| *name == text);
        found.map(|(_, predictor)| *predictor).ok_or_else(|| UnknownPredictor(text.to_owned()))
    }
}

impl TryFrom<String> for Predictor {
    type Error = UnknownPredictor;

    fn try_from(text: String) -> Result<Self, UnknownPredictor> {
        text.parse()
    }
}

impl From<Predictor> for String {
    fn from(predictor: Predictor) -> Self {
        predictor.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip() {
        for (name, predictor) in Predictor::ALL {
            assert_eq!(name.parse(), Ok(predictor));
            assert_eq!(predictor.to_string(), name);
        }
        assert!("surfaces".parse::<Predictor>().unwrap_err().to_string().contains("dissertation-copy"));
    }
}
