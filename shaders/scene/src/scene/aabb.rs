//! Boxes around geometry.

use glam::Vec3;
use serde::{Deserialize, Serialize};

/// An axis-aligned box, in metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Aabb {
    pub min: Vec3,
    pub max: Vec3,
}

impl Aabb {
    /// Returns the bounds of positions. All zeros if there are none.
    #[must_use]
    pub fn around<'a>(positions: impl IntoIterator<Item = &'a Vec3>) -> Self {
        let mut positions = positions.into_iter();
        let Some(first) = positions.next() else { return Self { min: Vec3::ZERO, max: Vec3::ZERO } };
        let (min, max) =
            positions.fold((*first, *first), |(min, max), position| (min.min(*position), max.max(*position)));
        Self { min, max }
    }
}
