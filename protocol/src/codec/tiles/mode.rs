//! What a codec optimises, and whether it predicts from a reference.

use super::reference::Reference;

/// What a codec optimises: bytes or time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::codec) enum Profile {
    Small,
    Fast,
}

/// How blocks are coded.
#[derive(Debug, Clone, Copy)]
pub(in crate::codec) enum Mode<'a> {
    Small,
    Fast,
    /// Predicted from a mask of the same shape.
    Inter(&'a Reference),
}

impl<'a> Mode<'a> {
    pub(in crate::codec) fn new(profile: Profile, reference: Option<&'a Reference>) -> Self {
        match (profile, reference) {
            (Profile::Small, Some(reference)) => Self::Inter(reference),
            (Profile::Small, None) => Self::Small,
            (Profile::Fast, _) => Self::Fast,
        }
    }

    /// Returns true if the coded mask may become a reference.
    pub(in crate::codec) const fn is_reference(self) -> bool {
        !matches!(self, Self::Fast)
    }
}
