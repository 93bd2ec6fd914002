//! How a frame is cut where other sessions share its device: a frame that has begun can be interrupted between two parts, so that
//! nobody waits for the whole of somebody else's.
//!
//! A part is a band of rows of tiles, sized by what the session's masks have cost of late. Cutting costs a little time for each part, so
//! a frame is traced whole where that makes nobody wait much longer than its own mask takes.

use gnomon_protocol::mask::MaskShape;

/// What a part is expected to take, in milliseconds of the device: long enough to fill a large one. On an H200 parts of 0.15 ms made a
/// greedy client's frames take twice as long as whole ones, and these a sixth longer (`lab chaos fairness`).
pub const PART_MS: f64 = 0.5;

/// Parts of a frame at most. The device notes the times of each.
pub const MAX_PARTS: u32 = 128;

/// A frame that takes no more than so many times as long as another session's is traced whole.
const LONGER: f64 = 2.0;

/// The longest time that a frame may be expected to take and is traced whole, in milliseconds, where the shortest frames of the sessions
/// that are active take so long.
pub(crate) fn longest_whole_ms(shortest_ms: f64) -> f64 {
    LONGER * shortest_ms.max(PART_MS)
}

/// For how long a frame of this cost keeps the device from others, in milliseconds. A mask of fewer rows of tiles than [`MAX_PARTS`] has
/// fewer parts, and is small.
pub(crate) fn stretch_ms(cost_ms: f64) -> f64 {
    cost_ms.min((cost_ms / f64::from(MAX_PARTS)).max(LONGER * PART_MS))
}

/// Rows of tiles of a part, for a frame that is expected to cost so much.
pub(crate) fn rows_a_part(shape: MaskShape, expected_ms: f64) -> u32 {
    let rows = shape.tiles_y();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates, and is bounded below")]
    let wanted = (f64::from(rows) * PART_MS / expected_ms.max(PART_MS)).round() as u32;
    wanted.max(rows.div_ceil(MAX_PARTS)).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_as_long_as_they_should_be_and_never_too_many() {
        let shape = |width, height| MaskShape::new(width, height, 4).unwrap();
        // 135 rows of 12 ms.
        assert_eq!(rows_a_part(shape(1920, 1080), 12.0), 6);
        assert_eq!(rows_a_part(shape(1920, 1080), 1.0), 68);
        assert_eq!(rows_a_part(shape(1920, 1080), 0.0), 135);
        for expected_ms in [0.0, 1.0, 1e3, f64::INFINITY, f64::NAN] {
            for (width, height) in [(1, 1), (64, 36), (1920, 1080), (16, 4096)] {
                let shape = shape(width, height);
                let rows = rows_a_part(shape, expected_ms);
                assert!(rows >= 1 && shape.tiles_y().div_ceil(rows) <= MAX_PARTS, "{expected_ms} ms: {rows} rows");
            }
        }
    }

    #[test]
    fn equals_are_traced_whole() {
        assert!(longest_whole_ms(1.0) > 1.9);
        assert!(longest_whole_ms(0.01) >= 2.0 * PART_MS);
        assert!(longest_whole_ms(f64::INFINITY).is_infinite(), "nobody else is there");
        assert_eq!(stretch_ms(0.2), 0.2);
        assert_eq!(stretch_ms(12.0), 2.0 * PART_MS);
        assert_eq!(stretch_ms(1280.0), 10.0);
    }
}
