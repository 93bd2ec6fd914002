//! Splits long frames of sessions that share a device. A frame can be interrupted between parts, so that no session
//! waits for another's whole frame.
//!
//! A part is a band of rows of tiles, sized by the recent cost of the session's masks. Each part adds a little
//! overhead, so a frame is traced whole unless another session would wait much longer than its own mask takes.

use gnomon_protocol::mask::MaskShape;

/// Target cost of a part, in milliseconds: long enough to fill a large device. On an H200, parts of 0.15 ms doubled the
/// time of a greedy client's frames, and parts of 0.5 ms added a sixth (`lab chaos fairness`). Each part waits for its
/// own slowest rays, a quarter of a millisecond where blocks share lists, so parts of 0.5 ms made frames of 1 ms late.
pub const PART_MS: f64 = 1.0;

/// Most parts of a frame. The device timestamps each one.
pub const MAX_PARTS: u32 = 128;

/// A frame is traced whole up to this multiple of the shortest frame's cost.
const WHOLE_RATIO: f64 = 2.0;

/// Cost above which a frame is split, in milliseconds, when the shortest frames of active sessions cost `shortest_ms`.
pub(crate) fn split_above_ms(shortest_ms: f64) -> f64 {
    WHOLE_RATIO * shortest_ms.max(PART_MS)
}

/// Longest time that a frame of this cost blocks other sessions, in milliseconds. Masks of fewer than [`MAX_PARTS`]
/// rows of tiles have fewer parts, but are small.
pub(crate) fn blocking_ms(cost_ms: f64) -> f64 {
    cost_ms.min((cost_ms / f64::from(MAX_PARTS)).max(WHOLE_RATIO * PART_MS))
}

/// Rows of tiles in each part of a frame of this expected cost.
pub(crate) fn rows_per_part(shape: MaskShape, expected_ms: f64) -> u32 {
    let rows = shape.tiles_y();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates, and is bounded below")]
    let wanted = (f64::from(rows) * PART_MS / expected_ms.max(PART_MS)).round() as u32;
    wanted.max(rows.div_ceil(MAX_PARTS)).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_have_the_wanted_cost_and_are_never_too_many() {
        let shape = |width, height| MaskShape::new(width, height, 4).unwrap();
        // 135 rows in 12 ms.
        assert_eq!(rows_per_part(shape(1920, 1080), 12.0), 11);
        assert_eq!(rows_per_part(shape(1920, 1080), 2.0), 68);
        assert_eq!(rows_per_part(shape(1920, 1080), 0.0), 135);
        for expected_ms in [0.0, 1.0, 1e3, f64::INFINITY, f64::NAN] {
            for (width, height) in [(1, 1), (64, 36), (1920, 1080), (16, 4096)] {
                let shape = shape(width, height);
                let rows = rows_per_part(shape, expected_ms);
                assert!(rows >= 1 && shape.tiles_y().div_ceil(rows) <= MAX_PARTS, "{expected_ms} ms: {rows} rows");
            }
        }
    }

    #[test]
    fn only_much_longer_frames_are_split() {
        assert!(split_above_ms(1.0) > 1.9);
        assert!(split_above_ms(0.01) >= 2.0 * PART_MS);
        assert!(split_above_ms(f64::INFINITY).is_infinite(), "no other session is active");
        assert_eq!(blocking_ms(0.2), 0.2);
        assert_eq!(blocking_ms(12.0), 2.0 * PART_MS);
        assert_eq!(blocking_ms(1280.0), 10.0);
    }
}
