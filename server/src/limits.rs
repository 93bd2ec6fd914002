//! Every bound of the daemon that is not configured, in one place. What a peer may send is in `gnomon_protocol::limits`.
//!
//! What one client can take, and what takes it back:
//!
//! | what | bound | beyond it |
//! |---|---|---|
//! | an address that did not prove itself | a Retry of 108 bytes | nothing more |
//! | handshakes under way | [`MAX_HANDSHAKES`], of one address [`MAX_HANDSHAKES_PER_ADDRESS`], `handshake_timeout_ms` each, [`UNHURRIED_LIMITS`] times that while at most [`MAX_UNHURRIED_HANDSHAKES`] are | refused, `gnomon_refusals_total{cause="handshakes"}`, `"silent"` |
//! | bytes before admission | [`INCOMING_BUFFER_BYTES`] a connection, [`INCOMING_BUFFER_TOTAL_BYTES`] in all | dropped by quinn |
//! | a message | [`MAX_CLIENT_MESSAGE_BYTES`] | the session ends |
//! | messages a second | [`MAX_MESSAGES_PER_SECOND`] | the session ends |
//! | streams | [`MAX_BIDI_STREAMS`], [`MAX_UNI_STREAMS`], [`STREAM_RECEIVE_WINDOW_BYTES`] unread | flow control |
//! | sessions | `max_sessions`, of one address `max_sessions_per_address` | refused, `cause="full"`, `"address"` |
//! | the devices' time, the cores' and the network's, of all | `device_budget_ms`, `cores_budget_ms`, `network_budget_mbit` | refused with the reason, `cause="budget"` |
//! | poses a second | [`MAX_POSES_PER_SECOND`] | dropped, `outcome="over_rate"` |
//! | unread poses | [`DATAGRAM_RECEIVE_BUFFER_BYTES`] | the oldest are dropped, `outcome="unread"` |
//! | bytes a second | [`MAX_CLIENT_BYTES_PER_SECOND`] | its next mask waits |
//! | device time a second | [`MAX_CLIENT_GPU_PER_SECOND`] | its next mask waits |
//! | frames that it does not read | [`SEND_BACKLOG_FRAMES`] | skipped, `outcome="gated"` |
//! | scene bytes in flight, fetches | [`SEND_WINDOW_BYTES`], [`MAX_SCENE_FETCHES`] | back-pressure; the session ends |
//! | silence | [`WRITE_TIMEOUT`], [`SETUP_TIMEOUT`], [`SILENCE_TIMEOUT`], `idle_timeout_ms` | the session ends |

use std::{num::NonZeroUsize, time::Duration};

/// Longest message that a client may send: a token, a name and a few numbers. It bounds memory before admission.
pub const MAX_CLIENT_MESSAGE_BYTES: usize = 4096;

/// Connections that may be between their first packet and their admission. More are refused at once.
pub const MAX_HANDSHAKES: usize = 128;

/// Of those, how many one address may have: whoever floods the server with them leaves half of them to others.
pub const MAX_HANDSHAKES_PER_ADDRESS: usize = MAX_HANDSHAKES / 2;

/// Handshakes under way beside which none is hurried.
pub const MAX_UNHURRIED_HANDSHAKES: usize = MAX_HANDSHAKES / 4;

/// How often `handshake_timeout_ms` an unhurried handshake may take: 20 s hold six tries of a packet, each after twice the time.
pub const UNHURRIED_LIMITS: u32 = 4;

/// Bytes that quinn buffers for one connection, and for all, before it is accepted (defaults: 10 and 100 MiB).
pub const INCOMING_BUFFER_BYTES: u64 = 16 * 1024;

/// See [`INCOMING_BUFFER_BYTES`].
pub const INCOMING_BUFFER_TOTAL_BYTES: u64 = 2 * 1024 * 1024;

/// Received datagrams that wait for a session: some 200 poses. Older ones are dropped.
pub const DATAGRAM_RECEIVE_BUFFER_BYTES: usize = 32 * 1024;

/// What a client may send on its streams before the session has read it.
pub const STREAM_RECEIVE_WINDOW_BYTES: u32 = 64 * 1024;

/// Scene bytes in flight to one client.
pub const SEND_WINDOW_BYTES: u64 = 4 * 1024 * 1024;

/// Streams that a client may open: the control stream, and HTTP/3's own.
pub const MAX_BIDI_STREAMS: u32 = 4;

/// See [`MAX_BIDI_STREAMS`].
pub const MAX_UNI_STREAMS: u32 = 8;

/// Control messages, scene chunks among them, that wait for a session's control stream.
pub const CONTROL_QUEUE: usize = 4;

/// How often a client may ask for the scene in one session; resuming is for new sessions.
pub const MAX_SCENE_FETCHES: u32 = 4;

/// Control messages, over twice the frame rate, that a session answers in a second.
pub const MAX_MESSAGES_PER_SECOND: u64 = 1000;

/// Datagrams, poses most of them, that a client may send in a second; more are dropped. No screen shows so many frames.
pub const MAX_POSES_PER_SECOND: u32 = 2000;

/// Bytes of frames that a client may be sent in a second, and as many again at once: words at 1920×1080, 60 times a second.
pub const MAX_CLIENT_BYTES_PER_SECOND: u64 = 500_000_000;

/// Device time that a client may use in a second, and as much again at once. One client alone may have the whole device: this bounds what
/// it takes from several, and the scheduler shares one.
pub const MAX_CLIENT_GPU_PER_SECOND: Duration = Duration::from_secs(1);

/// Datagrams that may wait to be sent, in frames: beyond this a new frame is skipped.
pub const SEND_BACKLOG_FRAMES: f64 = 1.6;

/// Bytes that may always wait to be sent, so that tiny frames do not skip each other.
pub const SEND_BACKLOG_FLOOR_BYTES: usize = 16 * 1024;

/// Longest time that one write to a control stream may take.
pub const WRITE_TIMEOUT: Duration = Duration::from_secs(30);

/// Longest time between admission and Start: the client fetches the scene and builds its pipelines.
pub const SETUP_TIMEOUT: Duration = Duration::from_secs(600);

/// Longest silence (no pose, no message) of a client that answers nothing but the transport's keep-alives.
pub const SILENCE_TIMEOUT: Duration = Duration::from_secs(60);

/// Time that a peer gets to read a last message before its connection is closed.
pub const LINGER: Duration = Duration::from_millis(500);

/// Time that a frame in flight gets to finish when the session stops.
pub const FINISH_TIMEOUT: Duration = Duration::from_secs(2);

/// Time after which asking a full server again makes sense.
pub const RETRY_AFTER: Duration = Duration::from_secs(5);

/// Largest token file.
pub const MAX_TOKEN_FILE_BYTES: u64 = 1024 * 1024;

/// Largest certificate or key file.
pub const MAX_SMALL_FILE_BYTES: u64 = 256 * 1024;

/// Sessions that the engine has room for beyond the admitted ones: they have ended, and it has not looked yet.
pub const SPARE_SEATS: usize = 16;

/// Most devices that may be configured.
pub const MAX_DEVICES: NonZeroUsize = NonZeroUsize::MIN.saturating_add(63);

/// Most threads of the cpu back end.
pub const MAX_THREADS: NonZeroUsize = NonZeroUsize::MIN.saturating_add(1023);

/// Most sessions that may be configured.
pub const MAX_SESSIONS: usize = 4096;

/// Connections to the admin address that are served at once; others wait.
pub const MAX_ADMIN_CONNECTIONS: usize = 16;

/// Longest time for an admin request and its answer.
pub const ADMIN_TIMEOUT: Duration = Duration::from_secs(5);

/// Of an answer of Agones' sidecar or of a collector, what is read.
pub const MAX_HTTP_ANSWER_BYTES: usize = 64 * 1024;

/// Log lines that wait to be written; more are counted and lost.
pub const MAX_WAITING_LOG_LINES: usize = 8192;

/// Tokens that one file may list.
pub const MAX_TOKENS: usize = 10_000;
