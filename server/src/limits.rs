//! All fixed limits of the server. Limits of messages are in `gnomon_protocol::limits`.
//!
//! Each client's limits, and what happens beyond them:
//!
//! | what | limit | beyond it |
//! |---|---|---|
//! | an unproven address | a Retry of 108 bytes | nothing more |
//! | new connections of an address | [`CONNECTIONS_PER_SECOND`], [`CONNECTION_BURST`] | refused, `cause="rate"` |
//! | handshakes | [`MAX_HANDSHAKES`] ([`MAX_HANDSHAKES_PER_ADDRESS`]) | the oldest goes, `cause="handshakes"` |
//! | connections without a session | [`MAX_WITHOUT_SESSION`] and `…_PER_ADDRESS` | refused, `cause="connections"` |
//! | a handshake | `handshake_timeout_ms`, see [`UNHURRIED_LIMITS`] | refused, `cause="silent"` |
//! | bytes before a handshake | [`INCOMING_BUFFER_BYTES`], [`INCOMING_BUFFER_TOTAL_BYTES`] in all | dropped by quinn |
//! | bytes before admission | [`MAX_BYTES_BEFORE_ADMISSION`] | refused, `cause="broken"` |
//! | a message | [`MAX_CLIENT_MESSAGE_BYTES`] | the session ends |
//! | messages per second | [`MAX_MESSAGES_PER_SECOND`] | the session ends |
//! | edits per second | [`MAX_EDITS_PER_SECOND`] | the session ends |
//! | edits of a message, of a scene | `MAX_EDITS`, `MAX_EDITED` of the protocol | the session ends; refused |
//! | streams | [`MAX_BIDI_STREAMS`], [`MAX_UNI_STREAMS`] | flow control |
//! | unread stream bytes | [`STREAM_RECEIVE_WINDOW_BYTES`], [`RECEIVE_WINDOW_BYTES`] in all | flow control |
//! | sessions | `max_sessions`, `max_sessions_per_address` | refused, `cause="full"`, `"address"` |
//! | device time of all | `device_budget_ms` | refused, `cause="budget"` |
//! | core time of all | `cores_budget_ms` | refused, `cause="budget"` |
//! | bandwidth of all | `network_budget_mbit` | refused, `cause="budget"` |
//! | masks per second | the declared rate, see `visibility/schedule/pace.rs` | its next mask waits |
//! | masks of a session without a rate | what other sessions leave | its next mask waits |
//! | memory of all | `memory_budget_mb` | refused, `cause="budget"` |
//! | scene bytes of all | what masks leave of `network_budget_mbit` | its next chunk waits |
//! | bytes received per second | [`MAX_RECEIVED_BYTES_PER_SECOND`] | the session ends |
//! | poses per second | [`MAX_POSES_PER_SECOND`] | dropped, `outcome="over_rate"` |
//! | unread poses | [`DATAGRAM_RECEIVE_BUFFER_BYTES`] | the oldest are dropped, `outcome="unread"` |
//! | bytes per second | [`MAX_CLIENT_BYTES_PER_SECOND`] | its next mask waits |
//! | device time per second | [`MAX_CLIENT_GPU_PER_SECOND`] | its next mask waits |
//! | unread frames | [`SEND_BACKLOG_FRAMES`] | skipped, `outcome="gated"` |
//! | scene bytes in flight | [`SEND_WINDOW_BYTES`] | back-pressure |
//! | scene fetches | [`MAX_SCENE_FETCHES`] | the session ends |
//! | log lines of one place in the code | [`LOG_BURST`], [`LOG_LINES_PER_SECOND`] | suppressed and counted |
//! | invalid datagrams | [`MAX_BAD_POSES_PER_SECOND`] | the session ends, `cause="violation"` |
//! | poses over their rate | [`MAX_SECONDS_OVER_RATE`] in a row | the session ends, `cause="violation"` |
//! | wrong tokens | [`MAX_FAILED_TOKENS`] per address and minute | refused unseen, `cause="token"` |
//! | a session that an operator ended | [`DISMISSED_FOR`] | not resumed, `cause="dismissed"` |
//! | web connections | [`MAX_WEB_CONNECTIONS`] ([`MAX_WEB_CONNECTIONS_PER_ADDRESS`]) | closed |
//! | a web request, a web connection | [`WEB_TIMEOUT`], [`WEB_CONNECTION_TIMEOUT`] | closed |
//! | silence | [`WRITE_TIMEOUT`], [`SETUP_TIMEOUT`], [`SILENCE_TIMEOUT`], `idle_timeout_ms` | the session ends |

use std::{num::NonZeroUsize, time::Duration};

/// Longest client message: a token, a name and a few numbers. Bounds memory before admission.
pub const MAX_CLIENT_MESSAGE_BYTES: usize = 4096;

/// Connections between first packet and admission. A connection holds about 100 KB then, and at most 300 KB: unread
/// bytes of its streams ([`STREAM_RECEIVE_WINDOW_BYTES`]), unread datagrams ([`DATAGRAM_RECEIVE_BUFFER_BYTES`]), a
/// capsule or frame of HTTP/3 (64 KiB), and quinn's and rustls' own state.
pub const MAX_HANDSHAKES: usize = 512;

/// Share of [`MAX_HANDSHAKES`] for one address, so that a flood from it leaves the rest to others.
pub const MAX_HANDSHAKES_PER_ADDRESS: usize = MAX_HANDSHAKES / 8;

/// Limits of one address hold this many times for an IPv6 /48: its owner has 65,536 of the /64 that count as an
/// address, but a /48 may also be a campus of many peers.
pub const SITE_ADDRESSES: usize = 4;

/// Connections without a session, those included that are closing: until the peer confirms, quinn keeps one for three
/// probe timeouts, which the peer's own round trips and delays set. A closing one holds no more than a handshake.
pub const MAX_WITHOUT_SESSION: usize = 4 * MAX_HANDSHAKES;

/// Share of [`MAX_WITHOUT_SESSION`] for one address.
pub const MAX_WITHOUT_SESSION_PER_ADDRESS: usize = 4 * MAX_HANDSHAKES_PER_ADDRESS;

/// New connections per second of one address. A handshake takes about a millisecond of a core, so an address can take
/// less than a tenth of one.
pub const CONNECTIONS_PER_SECOND: u32 = 64;

/// Connections that one address may open at once: the clients of a large NAT, after a server has restarted.
pub const CONNECTION_BURST: u32 = 256;

/// Networks whose rate of new connections is remembered, in about 60 bytes each.
pub const MAX_RATED_NETWORKS: usize = 8192;

/// Bytes of a peer until it is admitted, packet headers included: a handshake and a Hello, ten times over.
pub const MAX_BYTES_BEFORE_ADMISSION: u64 = 128 * 1024;

/// While at most this many handshakes are under way, each gets [`UNHURRIED_LIMITS`].
pub const MAX_UNHURRIED_HANDSHAKES: usize = MAX_HANDSHAKES / 4;

/// Time limit of an unhurried handshake, in multiples of `handshake_timeout_ms`. Its 20 s allow six tries of a packet,
/// since each try takes twice as long as the last.
pub const UNHURRIED_LIMITS: u32 = 4;

/// Bytes that quinn buffers per connection before it is accepted (default: 10 MiB).
pub const INCOMING_BUFFER_BYTES: u64 = 16 * 1024;

/// As [`INCOMING_BUFFER_BYTES`], for all connections (default: 100 MiB).
pub const INCOMING_BUFFER_TOTAL_BYTES: u64 = 2 * 1024 * 1024;

/// Unread datagrams of a session: about 200 poses. Older ones are dropped.
pub const DATAGRAM_RECEIVE_BUFFER_BYTES: usize = 32 * 1024;

/// Unread bytes of one stream, and, before admission, of all streams of a connection.
pub const STREAM_RECEIVE_WINDOW_BYTES: u32 = 64 * 1024;

/// Unread bytes of all streams of a session.
pub const RECEIVE_WINDOW_BYTES: u32 = 4 * STREAM_RECEIVE_WINDOW_BYTES;

/// Scene bytes in flight to one client.
pub const SEND_WINDOW_BYTES: u64 = 4 * 1024 * 1024;

/// Streams of a client: the control stream, and HTTP/3's own.
pub const MAX_BIDI_STREAMS: u32 = 4;

pub const MAX_UNI_STREAMS: u32 = 8;

/// Queued control messages of a session, including scene chunks.
pub const CONTROL_QUEUE: usize = 4;

/// Scene fetches per session. An interrupted download resumes in a new session.
pub const MAX_SCENE_FETCHES: u32 = 4;

/// Control messages per second: more than twice the frame rate.
pub const MAX_MESSAGES_PER_SECOND: u64 = 1000;

/// Messages per second that change the scene: twice those of a client that is dragged without end.
pub const MAX_EDITS_PER_SECOND: u64 = 250;

/// Invalid datagrams per second of a client. QUIC delivers none damaged, so an honest client sends none.
pub const MAX_BAD_POSES_PER_SECOND: u64 = 200;

/// Seconds in a row in which a client may exceed [`MAX_POSES_PER_SECOND`]. A network that held datagrams up delivers
/// them within one.
pub const MAX_SECONDS_OVER_RATE: u32 = 5;

/// Datagrams per second of a client, mostly poses. No screen shows as many frames.
pub const MAX_POSES_PER_SECOND: u32 = 2000;

/// Highest rate that a session may declare, in masks per second. No screen shows more; higher ones count as this.
pub const MAX_RATE_HZ: u16 = 500;

/// Bytes per second from a client, packet headers included: several times those of
/// [`MAX_POSES_PER_SECOND`].
pub const MAX_RECEIVED_BYTES_PER_SECOND: u64 = 2 * 1024 * 1024;

/// A client may send this part of what it receives, besides [`MAX_RECEIVED_BYTES_PER_SECOND`]: acknowledgements.
pub const ACKNOWLEDGED_SHARE: u64 = 8;

/// Frame bytes per second of a client, and the size of a burst: enough for words at 1920×1080 and 60 frames/s.
pub const MAX_CLIENT_BYTES_PER_SECOND: u64 = 500_000_000;

/// Device time per second of a client, and the size of a burst. One client may use a whole device, shared by the
/// scheduler. This limits its use of several.
pub const MAX_CLIENT_GPU_PER_SECOND: Duration = Duration::from_secs(1);

/// Queued datagrams, in frames, beyond which a new frame is skipped.
pub const SEND_BACKLOG_FRAMES: f64 = 1.6;

/// Bytes that may always be queued, so that tiny frames do not skip each other.
pub const SEND_BACKLOG_FLOOR_BYTES: usize = 16 * 1024;

/// Limit for one write to a control stream.
pub const WRITE_TIMEOUT: Duration = Duration::from_secs(30);

/// Limit from admission to Start, while the client fetches the scene and builds its pipelines.
pub const SETUP_TIMEOUT: Duration = Duration::from_secs(600);

/// Limit without poses or messages, for a client that answers only the transport's keep-alives.
pub const SILENCE_TIMEOUT: Duration = Duration::from_secs(60);

/// Time for a peer to read a last message before its connection is closed.
pub const LINGER: Duration = Duration::from_millis(500);

/// Time for a WebTransport peer to learn why its session closes, before its connection does: two round trips of
/// 800 ms, and some patience.
pub const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

/// Time for frames in flight when a session stops.
pub const FINISH_TIMEOUT: Duration = Duration::from_secs(2);

/// Delay suggested to refused clients.
pub const RETRY_AFTER: Duration = Duration::from_secs(5);

/// Wrong tokens of one address in [`FAILED_TOKENS_WINDOW`]; more block it until the window ends. A person who mistypes
/// a token stays below.
pub const MAX_FAILED_TOKENS: u32 = 10;

pub const FAILED_TOKENS_WINDOW: Duration = Duration::from_secs(60);

/// Addresses remembered for their wrong tokens; more forget the oldest.
pub const MAX_FAILED_ADDRESSES: usize = 4096;

/// Wrong tokens are logged at most this often, as a count.
pub const FAILED_TOKENS_LOGGED_EVERY: Duration = Duration::from_secs(10);

/// How long the client of a session that an operator ended is asked to stay away.
pub const DISMISSED_FOR: Duration = Duration::from_secs(60);

/// Ended sessions remembered for [`DISMISSED_FOR`]; more forget the oldest.
pub const MAX_DISMISSED: usize = 1024;

pub const MAX_TOKEN_FILE_BYTES: u64 = 1024 * 1024;

/// Largest certificate or key file.
pub const MAX_SMALL_FILE_BYTES: u64 = 256 * 1024;

/// Room in the engine for ended sessions that it has not released yet.
pub const SPARE_ENGINE_SESSIONS: usize = 16;

pub const MAX_DEVICES: NonZeroUsize = NonZeroUsize::MIN.saturating_add(63);

/// Most threads of the cpu back end.
pub const MAX_THREADS: NonZeroUsize = NonZeroUsize::MIN.saturating_add(1023);

pub const MAX_SESSIONS: usize = 4096;

/// Connections to the admin address at once, of at most 16 KiB each. One more ends the oldest that has asked nothing.
pub const MAX_ADMIN_CONNECTIONS: usize = 128;

/// How long a connection to the admin address may take for its request while others need its place.
pub const ADMIN_GRACE: Duration = Duration::from_millis(50);

/// Limit for an admin request and its answer.
pub const ADMIN_TIMEOUT: Duration = Duration::from_secs(5);

/// Connections to the web address at once, of at most 16 KiB each beside the files, which all share; others are closed.
pub const MAX_WEB_CONNECTIONS: usize = 256;

/// Share of [`MAX_WEB_CONNECTIONS`] for one address. Loopback is exempt, as a local proxy makes all pages share it.
pub const MAX_WEB_CONNECTIONS_PER_ADDRESS: usize = 8;

/// Limit for a handshake with the web address, and for each request's head.
pub const WEB_TIMEOUT: Duration = Duration::from_secs(5);

/// Limit for a connection to the web address: the page takes a slow phone half of it.
pub const WEB_CONNECTION_TIMEOUT: Duration = Duration::from_secs(60);

/// WebSockets that wait to be greeted, which takes a moment; more are answered with status 503.
pub const MAX_WAITING_SOCKETS: usize = 64;

/// Bytes that the system takes of a WebSocket's frames before it sends them. More would be older when they arrive.
pub const SOCKET_SEND_BUFFER_BYTES: usize = 64 * 1024;

/// Files of the page.
pub const MAX_PAGE_FILES: usize = 32;

/// Largest file of the page.
pub const MAX_PAGE_FILE_BYTES: u64 = 16 * 1024 * 1024;

/// Most bytes read of an answer from Agones' sidecar or a collector.
pub const MAX_HTTP_ANSWER_BYTES: usize = 64 * 1024;

/// Queued log lines; more are counted and dropped.
pub const MAX_WAITING_LOG_LINES: usize = 8192;

/// Lines that one place in the code may log per second, at level info and above, since peers make the server log.
pub const LOG_LINES_PER_SECOND: f64 = 10.0;

/// Lines that one place in the code may log at once.
pub const LOG_BURST: f64 = 200.0;

pub const MAX_TOKENS: usize = 10_000;
