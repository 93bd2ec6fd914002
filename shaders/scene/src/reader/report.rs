//! What the reader left out, mended or does not draw.

use std::{borrow::Cow, fmt};

use crate::{AlphaChanges, limits::MAX_WARNINGS};

/// What the reader left out or mended, and what is not drawn. Empty for most files.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LoadReport {
    /// Zero-area triangles, dropped.
    pub dropped_triangles: u64,
    /// Zero or broken normals, replaced by the mean of their faces'.
    pub repaired_normals: u64,
    /// Instances of points, lines and primitives without positions, skipped.
    pub skipped_primitives: u64,
    /// Pictures scaled down because they are too large, alone or together.
    pub scaled_pictures: u64,
    /// Materials that are drawn and traced by another alpha mode than the file's.
    pub alpha: AlphaChanges,
    /// Everything else, each once, in the order of discovery. At most [`MAX_WARNINGS`].
    pub warnings: Vec<Warning>,
    /// Occurrences of what found no room in `warnings`.
    pub more: u64,
}

/// Something that a file has and the scene has not, or has otherwise.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Warning {
    pub kind: WarningKind,
    /// The rule that is broken and what was done about it, or the feature.
    pub what: Cow<'static, str>,
    /// The first place where it occurs. Empty for the file as a whole.
    pub place: String,
    /// How often it occurs.
    pub count: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum WarningKind {
    /// The file is invalid in a detail that has an obvious meaning.
    Mended,
    /// A part of the file is broken or beyond a limit, and the rest is whole without it.
    LeftOut,
    /// The file is legal, and Gnomon does not draw this.
    NotDrawn,
    /// Something to know about the scene: nothing is missing.
    Note,
}

impl LoadReport {
    pub(crate) fn mended(&mut self, what: impl Into<Cow<'static, str>>, place: &str) {
        self.add(WarningKind::Mended, what, place, 1);
    }

    pub(crate) fn left_out(&mut self, what: impl Into<Cow<'static, str>>, place: &str) {
        self.add(WarningKind::LeftOut, what, place, 1);
    }

    pub(crate) fn not_drawn(&mut self, what: impl Into<Cow<'static, str>>, place: &str) {
        self.add(WarningKind::NotDrawn, what, place, 1);
    }

    /// Counts `count` occurrences. The first one's place stays.
    pub(crate) fn add(&mut self, kind: WarningKind, what: impl Into<Cow<'static, str>>, place: &str, count: u64) {
        if count == 0 {
            return;
        }
        let what = what.into();
        let room = self.warnings.len() < MAX_WARNINGS;
        match self.warnings.iter_mut().find(|known| known.kind == kind && known.what == what) {
            Some(known) => known.count = known.count.saturating_add(count),
            None if room => {
                self.warnings.push(Warning { kind, what, place: place.to_owned(), count });
            }
            None => self.more = self.more.saturating_add(count),
        }
    }

    /// Returns whether the scene is the file, whole and as it is.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Returns everything to know, the kinds in order.
    #[must_use]
    pub fn all(&self) -> Vec<Warning> {
        let counts = [
            (self.dropped_triangles, WarningKind::LeftOut, "zero-area triangles"),
            (self.repaired_normals, WarningKind::Mended, "zero or broken normals: the mean of their faces'"),
            (self.skipped_primitives, WarningKind::NotDrawn, "points, lines and primitives without positions"),
            (self.scaled_pictures, WarningKind::LeftOut, "detail of pictures that are too large: scaled down"),
            (self.alpha.solid, WarningKind::Note, "BLEND materials without anything to see through: OPAQUE"),
            (self.alpha.with_holes, WarningKind::Note, "BLEND materials with holes: MASK"),
            (self.alpha.transmissive, WarningKind::Note, "materials that let light through: BLEND"),
            (self.more, WarningKind::Note, "further warnings that found no room here"),
        ];
        let counts = counts.into_iter().filter(|(count, ..)| *count > 0);
        let counts = counts.map(|(count, kind, what)| Warning { kind, what: what.into(), place: String::new(), count });
        let mut all: Vec<Warning> = self.warnings.iter().cloned().chain(counts).collect();
        all.sort_by_key(|warning| warning.kind);
        all
    }
}

impl fmt::Display for LoadReport {
    /// A line each.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (number, warning) in self.all().iter().enumerate() {
            if number > 0 {
                f.write_str("\n")?;
            }
            warning.fmt(f)?;
        }
        Ok(())
    }
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = match self.kind {
            WarningKind::Mended => "mended",
            WarningKind::LeftOut => "left out",
            WarningKind::NotDrawn => "not drawn",
            WarningKind::Note => "note",
        };
        write!(f, "{kind}: {}", self.what)?;
        match (self.count, self.place.as_str()) {
            (1, "") => Ok(()),
            (1, place) => write!(f, " ({place})"),
            (count, "") => write!(f, " ({count}×)"),
            (count, place) => write!(f, " ({count}×, first in {place})"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warnings_are_told_once_and_bounded() {
        let mut report = LoadReport::default();
        report.mended("a hole", "mesh 1");
        report.mended("a hole", "mesh 2");
        report.not_drawn("a feature", "");
        assert_eq!(report.to_string(), "mended: a hole (2×, first in mesh 1)\nnot drawn: a feature");
        for number in 0..1000 {
            report.left_out(format!("part {number}"), "mesh 3");
        }
        assert_eq!((report.warnings.len(), report.more), (MAX_WARNINGS, 1002 - MAX_WARNINGS as u64));
        assert!(report.to_string().ends_with("note: further warnings that found no room here (938×)"), "{report}");
    }
}
