use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The codecs, with their numbers on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum CodecId {
    /// One u32 a pixel, bit k for light k, uncompressed: the dissertation's starting point (§1.3).
    Words = 0,
    /// The same words, LZ4: the dissertation's own format (§3.5).
    WordsLz4 = 1,
    /// Bit planes in 8×8 tiles, LZ4.
    PlanesLz4 = 2,
    /// Bit planes in 8×8 tiles, context-coded: the fewest bytes, in independent slices.
    TilesSmall = 3,
    /// The same tiles with prefix codes: more bytes, in a tenth of the time.
    TilesFast = 4,
}

#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("no codec is called {0:?}: there are words, words-lz4, planes-lz4, tiles-small and tiles-fast")]
pub struct UnknownCodec(pub String);

impl CodecId {
    pub const ALL: [Self; 5] = [Self::Words, Self::WordsLz4, Self::PlanesLz4, Self::TilesSmall, Self::TilesFast];

    /// Returns the name on command lines and in configuration.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Words => "words",
            Self::WordsLz4 => "words-lz4",
            Self::PlanesLz4 => "planes-lz4",
            Self::TilesSmall => "tiles-small",
            Self::TilesFast => "tiles-fast",
        }
    }

    /// Returns true if each slice names what it covers, fits a datagram and is independent. The other codecs cut the
    /// picture into equal parts.
    #[must_use]
    pub const fn is_sliced(self) -> bool {
        matches!(self, Self::TilesSmall | Self::TilesFast)
    }

    /// Returns true if slices may be coded against a mask that both ends have. That saves bytes, not time.
    #[must_use]
    pub const fn has_references(self) -> bool {
        matches!(self, Self::TilesSmall)
    }

    #[must_use]
    pub const fn number(self) -> u8 {
        self as u8
    }

    #[must_use]
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|codec| codec.number() == number)
    }
}

impl fmt::Display for CodecId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for CodecId {
    type Err = UnknownCodec;

    fn from_str(text: &str) -> Result<Self, UnknownCodec> {
        Self::ALL.into_iter().find(|codec| codec.name() == text).ok_or_else(|| UnknownCodec(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_and_number_means_one_codec() {
        for (codec, name, number) in [
            (CodecId::Words, "words", 0),
            (CodecId::WordsLz4, "words-lz4", 1),
            (CodecId::PlanesLz4, "planes-lz4", 2),
            (CodecId::TilesSmall, "tiles-small", 3),
            (CodecId::TilesFast, "tiles-fast", 4),
        ] {
            assert_eq!(codec.to_string(), name);
            assert_eq!(name.parse(), Ok(codec));
            assert_eq!(codec.number(), number);
            assert_eq!(CodecId::from_number(number), Some(codec));
        }
        assert_eq!(CodecId::from_number(5), None);
        for wrong in ["", "Words", "words_lz4", "planes", "tiles", " words"] {
            assert_eq!(wrong.parse::<CodecId>(), Err(UnknownCodec(wrong.to_owned())));
        }
    }
}
