//! What the reader left out or repaired.

use std::fmt;

use crate::AlphaChanges;

/// Counts of what the reader left out or repaired. All zeros for most files.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LoadReport {
    /// Zero-area triangles, dropped.
    pub dropped_triangles: u64,
    /// Zero normals, replaced by the mean of their faces'.
    pub repaired_normals: u64,
    /// Instances of points, lines and primitives without positions, skipped.
    pub skipped_primitives: u64,
    /// Morph targets with weight 0, ignored.
    pub ignored_morph_targets: u64,
    /// Pictures scaled down because they are too large, alone or together.
    pub scaled_pictures: u64,
    /// Materials that are drawn and traced by another alpha mode than the file's.
    pub alpha: AlphaChanges,
}

impl fmt::Display for LoadReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            dropped_triangles,
            repaired_normals,
            skipped_primitives,
            ignored_morph_targets,
            scaled_pictures,
            alpha,
        } = self;
        write!(
            f,
            "zero-area triangles dropped {dropped_triangles}, zero normals replaced {repaired_normals}, point and line \
             primitives skipped {skipped_primitives}, morph targets ignored {ignored_morph_targets}, pictures scaled \
             down {scaled_pictures}, {alpha}"
        )
    }
}
