//! Every bound on what a peer may send or ask for, in one place.

/// Lights that one visibility mask can carry: one bit of the dissertation's 32-bit word each (§3.1).
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

/// Largest encoded frame: what uncompressed words of the largest mask take, and room for the frame's head.
pub const MAX_FRAME_BYTES: usize = MAX_PIXELS as usize * 4 + 64 * 1024;

/// Masks that either end keeps as references: a quarter second at 60 frames a second may be on its way.
pub const MAX_REFERENCES: usize = 16;

/// Bytes of memory that either end keeps them in.
pub const MAX_REFERENCE_BYTES: usize = 32 << 20;

/// Masks that a client looks things up in, the newest first, where parts of them are missing.
pub const MAX_LAYERS: usize = 8;

/// Bytes of memory that it keeps them in, at 8 bytes a pixel; two are kept in any case.
pub const MAX_LAYER_BYTES: usize = 133 << 20;

/// Most bits of a frame that a client may let be wrong, in parts of a million.
pub const MAX_WRONG_PPM: u16 = 10_000;

/// Largest control message, its length prefix not counted.
pub const MAX_MESSAGE_BYTES: usize = 128 * 1024;

/// Scene bytes in one control message.
pub const SCENE_CHUNK_BYTES: usize = 64 * 1024;

/// Largest packed scene that a client accepts.
pub const MAX_SCENE_BYTES: u64 = 1 << 30;

/// Longest bearer token.
pub const MAX_TOKEN_BYTES: usize = 512;

/// Longest free text (client name, reason) in a message.
pub const MAX_TEXT_BYTES: usize = 1024;

/// Narrowest and widest vertical field of view that a pose may ask for, in radians (1° to 170°).
pub const YFOV_RANGE_RAD: std::ops::RangeInclusive<f64> = 0.017_453_292_519_943_295..=2.967_059_728_390_360_5;

/// Longest time that a client may ask to be looked ahead, in milliseconds.
pub const MAX_LOOK_AHEAD_MS: u16 = 1000;

/// Farthest that a pose may lie from the world's origin, in metres, per axis.
pub const MAX_POSITION_M: f64 = 1e9;
