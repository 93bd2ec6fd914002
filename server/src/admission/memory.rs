//! Memory: what a session may come to need, and what the machine can spare for sessions.
//!
//! The needs are upper bounds, read off the code that holds the buffers. A client chooses its masks' size and decides
//! whether it acknowledges any, so it is the bound that counts and not the usual case.

use std::{
    fs,
    path::{Path, PathBuf},
};

use gnomon_protocol::{
    codec::CodecId,
    limits::{MAX_REFERENCE_BYTES, MAX_REFERENCES, SCENE_CHUNK_BYTES},
    mask::MaskShape,
};

use super::coding::Coding;
use crate::{
    limits::{CONTROL_QUEUE, SEND_BACKLOG_FRAMES, SEND_WINDOW_BYTES},
    visibility::{backend::compute::SLOTS, engine::OUTSTANDING_MASKS},
};

/// A connection, its tasks and its coders' models, without masks and without the scene.
const CONNECTION_BYTES: u64 = 1024 * 1024;

/// Share of the memory that is free at the start. The rest is for growth of other kinds, and for other programs.
const DEFAULT_SHARE: u64 = 2;

/// Enough for a few sessions of 1920×1080, on a machine that seems to have nothing left.
const LEAST_DEFAULT_BYTES: u64 = 256 * 1024 * 1024;

/// Largest file read of the system's.
const MAX_SYSTEM_FILE_BYTES: u64 = 64 * 1024;

/// Bytes of host memory that a session of this shape and coding may come to hold. `scene_bytes` is the size of the
/// packed scene, of which a part may be on its way.
pub(super) fn session_bytes(shape: MaskShape, coding: Coding, scene_bytes: u64) -> u64 {
    let mask = mask_bytes(shape);
    // Those on their way, and one that is encoded.
    let masks = (OUTSTANDING_MASKS as u64 + 1) * mask;
    // `Refresh` has each tile's bits as last sent, and a number for each tile, half as large.
    let refresh = mask * 3 / 2;
    // The encoder's list of blocks is a quarter larger than the mask. Its output, the frame's body and the datagrams
    // that wait are coded: even noise takes no more than the mask, and a frame of that size is rare.
    let encoder = mask * 5 / 4;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small number of frames")]
    let coded = mask * (2 + SEND_BACKLOG_FRAMES.ceil() as u64) / 4;
    // Lists of the mask's words: one of all, and one for each kind.
    let simplifier = if coding.wrong_ppm > 0 { mask * 2 } else { 0 };
    let scene = (SEND_WINDOW_BYTES + (CONTROL_QUEUE * SCENE_CHUNK_BYTES) as u64).min(scene_bytes);
    masks + refresh + encoder + coded + simplifier + reference_bytes(shape, coding.codec) + CONNECTION_BYTES + scene
}

/// Masks kept as references: as many as fit, but always one, and two whose memory waits for reuse.
fn reference_bytes(shape: MaskShape, codec: CodecId) -> u64 {
    if !codec.has_references() {
        return 0;
    }
    // Two words of margin a row.
    let words = u64::from(shape.width().div_ceil(64) + 2) * u64::from(shape.tiles_y()) * 8;
    let one = words * u64::from(shape.lights()) * 8;
    let kept = (MAX_REFERENCE_BYTES as u64 / one.max(1)).clamp(1, MAX_REFERENCES as u64);
    (kept + 2) * one
}

/// Bytes of one device's buffers for masks of this shape. All sessions share them, so the largest shape counts. A part
/// of them is in the host's memory, and all of them are on a software adapter.
pub(super) fn device_bytes(shape: MaskShape) -> u64 {
    // Per pixel between the kernels.
    const SURFACE_BYTES: u64 = 16;
    2 * SLOTS as u64 * mask_bytes(shape) + shape.tiles() as u64 * 64 * SURFACE_BYTES
}

fn mask_bytes(shape: MaskShape) -> u64 {
    shape.words() as u64 * 8
}

/// The budget of a server whose operator has not chosen one: half of what the system has free, within the limits of its
/// control groups. `None` if the system does not say.
pub(crate) fn default_budget_bytes() -> Option<u64> {
    let free = free_bytes(Path::new("/proc"), Path::new("/sys/fs/cgroup"))?;
    Some((free / DEFAULT_SHARE).max(LEAST_DEFAULT_BYTES))
}

/// Free memory of the system or, if that is less, of the tightest control group around this process.
fn free_bytes(proc: &Path, groups: &Path) -> Option<u64> {
    let system = read(&proc.join("meminfo")).and_then(|text| meminfo_bytes(&text, "MemAvailable:"));
    let group = read(&proc.join("self/cgroup")).and_then(|text| group_free_bytes(&text, groups));
    system.into_iter().chain(group).min()
}

fn meminfo_bytes(text: &str, key: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(key))?;
    line.split_whitespace().next()?.parse::<u64>().ok()?.checked_mul(1024)
}

/// `text` is `/proc/self/cgroup`: `0::PATH` (version 2), or a line `N:…,memory,…:PATH` (version 1).
fn group_free_bytes(text: &str, groups: &Path) -> Option<u64> {
    let mut tightest = None;
    for line in text.lines() {
        let mut fields = line.splitn(3, ':');
        let (Some(_), Some(controllers), Some(path)) = (fields.next(), fields.next(), fields.next()) else { continue };
        let (root, limit, used) = if controllers.is_empty() {
            (groups.to_owned(), "memory.max", "memory.current")
        } else if controllers.split(',').any(|name| name == "memory") {
            (groups.join("memory"), "memory.limit_in_bytes", "memory.usage_in_bytes")
        } else {
            continue;
        };
        // Every group around this one has a limit of its own. In a container the path may lead outside of what is seen
        // here: then only the root is read.
        let mut group: PathBuf = root.join(path.trim_start_matches('/'));
        loop {
            tightest = tightest.into_iter().chain(group_left_bytes(&group, limit, used)).min();
            if group == root || !group.starts_with(&root) || !group.pop() {
                break;
            }
        }
    }
    tightest
}

fn group_left_bytes(group: &Path, limit: &str, used: &str) -> Option<u64> {
    // "max" is no limit, and no number.
    let limit: u64 = read(&group.join(limit))?.trim().parse().ok()?;
    let used: u64 = read(&group.join(used))?.trim().parse().ok()?;
    // Cached files count as used, but give way.
    let cached = read(&group.join("memory.stat")).and_then(|text| {
        let line = text.lines().find_map(|line| line.strip_prefix("inactive_file "))?;
        line.trim().parse::<u64>().ok()
    });
    Some(limit.saturating_sub(used.saturating_sub(cached.unwrap_or(0))))
}

fn read(path: &Path) -> Option<String> {
    use std::io::Read as _;
    let mut text = String::new();
    fs::File::open(path).ok()?.take(MAX_SYSTEM_FILE_BYTES).read_to_string(&mut text).ok()?;
    Some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MIB: u64 = 1024 * 1024;

    fn need_mib(width: u32, height: u32, lights: u32, codec: CodecId) -> u64 {
        let shape = MaskShape::new(width, height, lights).unwrap();
        session_bytes(shape, Coding { codec, wrong_ppm: 0 }, 100 * MIB) / MIB
    }

    #[test]
    fn needs_grow_with_the_masks_and_with_what_the_codec_keeps() {
        // A mask of 3840×2160 and 32 lights has 31.6 MiB.
        let largest = need_mib(3840, 2160, 32, CodecId::PlanesLz4);
        assert!((200..=260).contains(&largest), "{largest}");
        let with_references = need_mib(3840, 2160, 32, CodecId::TilesSmall);
        assert!((largest + 90..=largest + 110).contains(&with_references), "{with_references}");
        assert!(need_mib(1920, 1080, 4, CodecId::TilesSmall) <= 40);
        assert!(need_mib(64, 36, 1, CodecId::TilesSmall) <= 6);
        // References are bounded in bytes, and so in number.
        let shape = MaskShape::new(1920, 1080, 8).unwrap();
        let references = reference_bytes(shape, CodecId::TilesSmall);
        assert!(references <= MAX_REFERENCE_BYTES as u64 + 3 * 2 * MIB + MIB, "{references}");
    }

    #[test]
    fn the_tightest_limit_counts() {
        let folder = tempfile::tempdir().unwrap();
        let (proc, groups) = (folder.path().join("proc"), folder.path().join("groups"));
        let write = |path: &Path, text: &str| {
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        assert_eq!(free_bytes(&proc, &groups), None, "another system");
        write(&proc.join("meminfo"), "MemTotal: 9 kB\nMemAvailable:   8000 kB\n");
        assert_eq!(free_bytes(&proc, &groups), Some(8000 * 1024));
        // Version 2: a limit further up, of which a part is cached files.
        write(&proc.join("self/cgroup"), "0::/pods/one\n");
        write(&groups.join("pods/one/memory.max"), "max\n");
        write(&groups.join("pods/one/memory.current"), "1000\n");
        assert_eq!(free_bytes(&proc, &groups), Some(8000 * 1024), "no limit");
        write(&groups.join("pods/memory.max"), "5000000\n");
        write(&groups.join("pods/memory.current"), "3000000\n");
        assert_eq!(free_bytes(&proc, &groups), Some(2_000_000));
        write(&groups.join("pods/memory.stat"), "anon 7\ninactive_file 500000\n");
        assert_eq!(free_bytes(&proc, &groups), Some(2_500_000));
        // Version 1, with a path that is not to be seen here.
        write(&proc.join("self/cgroup"), "3:cpu:/x\n2:memory,hugetlb:/docker/7\n");
        write(&groups.join("memory/memory.limit_in_bytes"), "700\n");
        write(&groups.join("memory/memory.usage_in_bytes"), "900\n");
        assert_eq!(free_bytes(&proc, &groups), Some(0));
        write(&proc.join("self/cgroup"), "garbage\n::\n0::../../..\n\u{0}");
        assert_eq!(free_bytes(&proc, &groups), Some(8000 * 1024));
    }

    #[test]
    fn this_system_has_a_budget() {
        assert!(default_budget_bytes().unwrap() >= LEAST_DEFAULT_BYTES);
    }
}
