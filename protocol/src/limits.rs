//! All bounds on what a peer may send or ask for.

/// Most lights of a mask: one bit each of the dissertation's 32-bit word (§3.1).
pub const MAX_LIGHTS: u32 = 32;

/// Largest width or height of a mask, in pixels.
pub const MAX_SIDE_PX: u32 = 4096;

/// Largest area of a mask: 3840 × 2160 pixels. The tracer keeps 16 bytes a pixel in one storage binding, and
/// 128 MiB is all that software Vulkan binds.
pub const MAX_PIXELS: u32 = 3840 * 2160;

/// Largest datagram, header included, that fits every path without fragmentation under QUIC.
pub const MAX_PACKET_BYTES: usize = 1161;

/// Largest UDP payload over IPv4 (§3.1); only the loopback lab transports send packets this large.
pub const MAX_LAB_PACKET_BYTES: usize = 65_507;

/// Largest number of packets in a frame: the header has 15 bits for it (§3.1, Figure 1).
pub const MAX_FRAME_PACKETS: usize = (1 << 15) - 1;

/// Largest number of slices in a frame.
pub const MAX_FRAME_SLICES: usize = 4096;

/// Largest encoded frame: uncompressed words of the largest mask, and room for the head.
pub const MAX_FRAME_BYTES: usize = MAX_PIXELS as usize * 4 + 64 * 1024;

/// Most masks that either end keeps as references: a quarter second at 60 Hz may be in flight.
pub const MAX_REFERENCES: usize = 16;

/// Most bytes of these references.
pub const MAX_REFERENCE_BYTES: usize = 32 << 20;

/// Most masks that a client keeps to look up what is missing in newer ones.
pub const MAX_LAYERS: usize = 8;

/// Most bytes of these masks, at 8 bytes a pixel. Two are kept in any case.
pub const MAX_LAYER_BYTES: usize = 133 << 20;

/// Most bits of a frame that a client may allow to be wrong, in millionths.
pub const MAX_WRONG_PPM: u16 = 10_000;

/// Largest control message, without its length prefix.
pub const MAX_MESSAGE_BYTES: usize = 128 * 1024;

/// Scene bytes in one control message.
pub const SCENE_CHUNK_BYTES: usize = 64 * 1024;

/// Nodes and lights in one message that a client changes a scene with.
pub const MAX_EDITS: usize = 32;

/// Nodes and lights of a scene that are changed at once.
pub const MAX_EDITED: usize = 1024;

/// States of a scene that either end remembers.
pub const KEPT_REVISIONS: usize = 64;

/// Largest packed scene that a client accepts.
pub const MAX_SCENE_BYTES: u64 = 1 << 30;

/// Longest bearer token.
pub const MAX_TOKEN_BYTES: usize = 512;

/// Longest free text (client name, reason) in a message.
pub const MAX_TEXT_BYTES: usize = 1024;

/// Narrowest and widest vertical field of view that a pose may ask for, in radians (1° to 170°).
pub const YFOV_RANGE_RAD: std::ops::RangeInclusive<f64> = 0.017_453_292_519_943_295..=2.967_059_728_390_360_5;

/// Longest look-ahead that a client may ask for, in milliseconds.
pub const MAX_LOOK_AHEAD_MS: u16 = 1000;

/// Largest distance of a pose from the world's origin on each axis, in metres.
pub const MAX_POSITION_M: f64 = 1e9;
