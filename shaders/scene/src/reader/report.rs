//! What the reader left out or mended.

use std::fmt;

/// What the loader left out or mended; all zeros for most files.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LoadReport {
    /// Triangles without an area, dropped.
    pub dropped_triangles: u64,
    /// Normals of length zero, replaced by their faces' mean.
    pub repaired_normals: u64,
    /// Instances of point and line primitives, and of primitives without positions, skipped.
    pub skipped_primitives: u64,
    /// Morph targets, ignored: their weights are 0 at rest.
    pub ignored_morph_targets: u64,
}

impl fmt::Display for LoadReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { dropped_triangles, repaired_normals, skipped_primitives, ignored_morph_targets } = self;
        write!(
            f,
            "zero-area triangles dropped {dropped_triangles}, zero normals replaced {repaired_normals}, point and line \
             primitives skipped {skipped_primitives}, morph targets ignored {ignored_morph_targets}"
        )
    }
}
