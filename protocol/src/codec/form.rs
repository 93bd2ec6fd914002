//! The kind of coder that each codec uses.

use super::{baseline, tiles};
use crate::wire::CodecId;

#[derive(Debug, Clone, Copy)]
pub(super) enum Form {
    Rows(baseline::Form),
    Tiles(tiles::Profile),
}

impl Form {
    pub(super) const fn of(codec: CodecId) -> Self {
        match codec {
            CodecId::Words => Self::Rows(baseline::Form::Words),
            CodecId::WordsLz4 => Self::Rows(baseline::Form::WordsLz4),
            CodecId::PlanesLz4 => Self::Rows(baseline::Form::PlanesLz4),
            CodecId::TilesSmall => Self::Tiles(tiles::Profile::Small),
            CodecId::TilesFast => Self::Tiles(tiles::Profile::Fast),
        }
    }
}
