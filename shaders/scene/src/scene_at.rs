use std::sync::Arc;

use crate::Edits;

/// Which state of a scene: a time of its animation, and what has been edited.
///
/// Two are equal if their times have the same bits, and the same is edited.
#[derive(Debug, Clone, Default)]
pub struct SceneAt {
    /// In seconds; any finite number.
    pub time_s: f64,
    pub edits: Arc<Edits>,
}

impl SceneAt {
    /// The same edits in a scene that no time changes.
    #[must_use]
    pub fn at_any_time(self) -> Self {
        Self { time_s: 0.0, ..self }
    }
}

impl PartialEq for SceneAt {
    fn eq(&self, other: &Self) -> bool {
        let same_edits = || Arc::ptr_eq(&self.edits, &other.edits) || self.edits == other.edits;
        self.time_s.to_bits() == other.time_s.to_bits() && same_edits()
    }
}

/// Nothing is edited.
impl From<f64> for SceneAt {
    fn from(time_s: f64) -> Self {
        Self { time_s, edits: Arc::default() }
    }
}

impl From<&SceneAt> for SceneAt {
    fn from(at: &SceneAt) -> Self {
        at.clone()
    }
}
