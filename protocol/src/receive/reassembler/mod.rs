//! The greedy reassembler: packets in, frames out.
//!
//! Data goes straight to its place in one buffer, which is reused for every frame and never grows beyond its limit; a
//! second such buffer holds a frame that ended in part. Frames are delivered in increasing order. A partial frame may
//! be delivered again with more of it, never with less. The [`Policy`] decides which packets are taken.
//!
//! The reassembler trusts the packets, as the dissertation's does: the transport must ensure that only the peer can
//! send them. (A forged frame number near 2³² would make it ignore all that follows.)

mod baseline;
mod slices;
mod stats;

use thiserror::Error;

pub use self::{baseline::IgnoredCause, stats::ReassemblerStats};
use self::{
    baseline::{FramePacket, Verdict, WholeFrame},
    slices::Slices,
};
use crate::{
    fec::{ParityPacket, Recovered, Recovery},
    header::{HeaderError, PacketHeader},
    ids::FrameNumber,
    limits::MAX_FRAME_BYTES,
};

/// Which packets make a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Policy {
    /// All packets of a frame, in order, or none (dissertation §3.2, Figure 2).
    #[default]
    WholeFrame,
    /// Any packets that arrive, in any order, and those restored from [parity](crate::fec): for frames whose packets
    /// can each be decoded alone ([`CodecId::is_sliced`](crate::codec::CodecId::is_sliced)).
    Slices,
}

/// The effect of a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// Nothing was kept.
    Ignored(IgnoredCause),
    /// Its data is in the buffer.
    Stored,
    /// Its data is in the buffer, and the frame is complete: [`Reassembler::frame`] has it until the next packet.
    Complete,
    /// Its data is in the buffer. It ended the previous frame, which has data that was not delivered:
    /// [`Reassembler::frame`] has that frame until the next packet.
    Partial,
}

/// Why bytes are not a packet of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum PacketError {
    #[error(transparent)]
    Header(#[from] HeaderError),
    /// A field that every frame packet has is a placeholder.
    #[error("packet {sequence} has no {field}")]
    Placeholder { sequence: u32, field: &'static str },
    #[error("packet {0} carries no data")]
    Empty(u32),
    /// Its number of packets, timestamp or first-packet flag disagrees with its frame, which is dropped.
    #[error("packet {sequence} contradicts the other packets of frame {frame}")]
    Contradiction { sequence: u32, frame: FrameNumber },
    /// A parity packet with numbers out of range or unlike those of its frame's packets. The frame goes on.
    #[error("packet {0} is not valid parity of its frame")]
    Parity(u32),
    /// The frame exceeds the limit and is dropped.
    #[error("frame {frame} has more than {limit} bytes")]
    TooLong { frame: FrameNumber, limit: usize },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CompleteFrame<'a> {
    pub frame: FrameNumber,
    /// When its sender made it, in ms since the sender's first frame.
    pub timestamp_ms: u32,
    /// Packets that arrived or were restored.
    pub packets: u16,
    /// Packets restored from parity.
    pub restored: u16,
    /// Packets missing; 0 except under [`Policy::Slices`].
    pub missing: u16,
    /// The bytes that arrived, in order of arrival. Under [`Policy::WholeFrame`], that is packet order.
    pub body: &'a [u8],
    /// Bytes at the start of the body that were delivered before, with the same frame in part.
    pub known_bytes: usize,
}

#[derive(Debug)]
pub struct Reassembler {
    state: State,
    body: Vec<u8>,
    /// Data of a partial frame that has ended.
    ended_body: Vec<u8>,
    out: Option<Out>,
    /// Parity of the current frame.
    recovery: Recovery,
    max_frame_bytes: usize,
    stats: ReassemblerStats,
}

/// A [`CompleteFrame`] without its body.
#[derive(Debug, Clone, Copy)]
struct Out {
    frame: FrameNumber,
    timestamp_ms: u32,
    packets: u16,
    restored: u16,
    missing: u16,
    known_bytes: usize,
    /// True if the body is in `ended_body`.
    ended: bool,
}

impl Out {
    fn of_slices(current: &slices::Current, ended: bool) -> Self {
        Self {
            frame: current.begun_by.frame,
            timestamp_ms: current.begun_by.timestamp_ms,
            packets: current.taken,
            restored: current.restored,
            missing: current.missing(),
            known_bytes: current.given_bytes,
            ended,
        }
    }

    fn of_whole(current: &baseline::Current) -> Self {
        let FramePacket { frame, timestamp_ms, .. } = current.first;
        Self { frame, timestamp_ms, packets: current.taken, restored: 0, missing: 0, known_bytes: 0, ended: false }
    }
}

#[derive(Debug)]
enum State {
    WholeFrame(WholeFrame),
    Slices(Slices),
}

impl Reassembler {
    /// Returns a reassembler for frames of up to [`MAX_FRAME_BYTES`].
    #[must_use]
    pub fn new(policy: Policy) -> Self {
        Self::with_max_frame_bytes(policy, MAX_FRAME_BYTES)
    }

    /// Returns a reassembler for frames of up to `max_frame_bytes`.
    #[must_use]
    pub fn with_max_frame_bytes(policy: Policy, max_frame_bytes: usize) -> Self {
        Self {
            state: match policy {
                Policy::WholeFrame => State::WholeFrame(WholeFrame::new(max_frame_bytes)),
                Policy::Slices => State::Slices(Slices::new(max_frame_bytes)),
            },
            body: Vec::new(),
            ended_body: Vec::new(),
            out: None,
            recovery: Recovery::default(),
            max_frame_bytes,
            stats: ReassemblerStats::default(),
        }
    }

    /// Takes a packet with its header.
    ///
    /// # Errors
    /// Errors if it is not a frame packet or contradicts its frame. It is counted and changes nothing else, except that
    /// a contradictory or too long frame is dropped. The reassembler stays usable.
    pub fn push(&mut self, datagram: &[u8]) -> Result<Progress, PacketError> {
        self.stats.packets += 1;
        self.stats.bytes += datagram.len() as u64;
        self.out = None;
        match &mut self.state {
            State::WholeFrame(state) => state.leave_complete(),
            State::Slices(state) => state.leave_complete(),
        }
        let progress = self.take(datagram);
        match progress {
            Ok(Progress::Stored | Progress::Complete | Progress::Partial) => self.stats.stored += 1,
            Ok(Progress::Ignored(cause)) => *self.ignored(cause) += 1,
            Err(_) => self.stats.malformed += 1,
        }
        self.count_frames();
        progress
    }

    /// Delivers what has arrived of the current frame, which goes on: [`Self::frame`] returns it until the next packet.
    /// Returns false if nothing has arrived since the last delivery, and always under [`Policy::WholeFrame`].
    pub fn deliver_partial(&mut self) -> bool {
        self.out = None;
        let State::Slices(state) = &mut self.state else { return false };
        state.leave_complete();
        self.out = state.deliver_partial().map(|current| Out::of_slices(&current, false));
        self.out.is_some()
    }

    fn count_frames(&mut self) {
        let stats = &mut self.stats;
        match &self.state {
            State::WholeFrame(state) => {
                stats.frames_complete = state.frames_complete;
                stats.frames_incomplete = state.frames_incomplete;
            }
            State::Slices(state) => {
                stats.frames_complete = state.frames_complete;
                stats.frames_partial = state.frames_partial;
                stats.frames_incomplete = state.frames_incomplete;
            }
        }
    }

    /// Returns the frame last delivered, until the next packet. The newer one if a packet delivered two.
    #[must_use]
    pub fn frame(&self) -> Option<CompleteFrame<'_>> {
        let Out { frame, timestamp_ms, packets, restored, missing, known_bytes, ended } = self.out?;
        let body = if ended { &self.ended_body } else { &self.body };
        Some(CompleteFrame { frame, timestamp_ms, packets, restored, missing, body, known_bytes })
    }

    /// Returns the counts so far.
    #[must_use]
    pub const fn stats(&self) -> &ReassemblerStats {
        &self.stats
    }

    /// Returns the bytes of memory in the buffers.
    #[must_use]
    pub const fn buffer_bytes(&self) -> usize {
        self.body.capacity() + self.ended_body.capacity()
    }

    /// Returns the bytes of memory that hold parity.
    #[must_use]
    pub const fn parity_bytes(&self) -> usize {
        self.recovery.memory_bytes()
    }

    fn take(&mut self, datagram: &[u8]) -> Result<Progress, PacketError> {
        let (header, data) = PacketHeader::decode(datagram)?;
        if matches!(self.state, State::Slices(_)) && ParityPacket::is_one(&header) {
            let parity = ParityPacket::parse(&header, data).ok_or(PacketError::Parity(header.sequence))?;
            return self.take_parity(header.sequence, &parity);
        }
        let packet = frame_packet(&header, data)?;
        if data.is_empty() {
            return Err(PacketError::Empty(packet.sequence));
        }
        let verdict = match &mut self.state {
            State::WholeFrame(state) => state.packet(&packet),
            State::Slices(state) => {
                if state.is_newer(packet.frame) {
                    self.out = state.end().map(|ended| Out::of_slices(&ended, true));
                    std::mem::swap(&mut self.body, &mut self.ended_body);
                }
                state.packet(&packet)
            }
        };
        match verdict {
            Verdict::Ignore(cause) => return Ok(Progress::Ignored(cause)),
            Verdict::Contradiction => {
                return Err(PacketError::Contradiction { sequence: packet.sequence, frame: packet.frame });
            }
            Verdict::TooLong => {
                return Err(PacketError::TooLong { frame: packet.frame, limit: self.max_frame_bytes });
            }
            Verdict::Begin => {
                self.body.clear();
                self.recovery.begin();
            }
            Verdict::Append => {}
        }
        self.recovery.came(packet.sequence, self.body.len(), data.len());
        self.append(data);
        self.recover();
        Ok(self.progress())
    }

    fn take_parity(&mut self, sequence: u32, parity: &ParityPacket<'_>) -> Result<Progress, PacketError> {
        let State::Slices(state) = &mut self.state else { return Err(PacketError::Parity(sequence)) };
        if state.is_newer(parity.frame) {
            self.out = state.end().map(|ended| Out::of_slices(&ended, true));
            std::mem::swap(&mut self.body, &mut self.ended_body);
        }
        let first = FramePacket {
            sequence: parity.first_sequence,
            frame: parity.frame,
            packets: parity.packets,
            first: true,
            timestamp_ms: parity.timestamp_ms,
            data_bytes: 0,
        };
        match state.parity(&first) {
            Verdict::Ignore(cause) => return Ok(Progress::Ignored(cause)),
            Verdict::Contradiction | Verdict::TooLong => return Err(PacketError::Parity(sequence)),
            Verdict::Begin => {
                self.body.clear();
                self.recovery.begin();
            }
            Verdict::Append => {}
        }
        match self.recovery.parity(parity) {
            None => return Err(PacketError::Parity(sequence)),
            Some(false) => return Ok(Progress::Ignored(IgnoredCause::Duplicate)),
            Some(true) => {}
        }
        self.recover();
        Ok(self.progress())
    }

    /// Restores the current frame's missing packets, if enough parity has arrived.
    fn recover(&mut self) {
        let State::Slices(state) = &mut self.state else { return };
        let before = self.body.len();
        match self.recovery.recover(&mut self.body, self.max_frame_bytes) {
            Recovered::Nothing => {}
            Recovered::Contradiction => self.stats.parity_contradicted += 1,
            Recovered::All(packets) => {
                state.restored(packets, self.body.len() - before);
                self.stats.restored += u64::from(packets);
            }
        }
    }

    fn progress(&mut self) -> Progress {
        let complete = match &self.state {
            State::WholeFrame(state) => state.complete().as_ref().map(Out::of_whole),
            State::Slices(state) => state.complete().map(|complete| Out::of_slices(&complete, false)),
        };
        let progress = match (complete, self.out) {
            (Some(_), _) => Progress::Complete,
            (None, Some(_)) => Progress::Partial,
            (None, None) => Progress::Stored,
        };
        self.out = complete.or(self.out);
        progress
    }

    /// Appends. The buffer grows by doubling, up to the limit.
    fn append(&mut self, data: &[u8]) {
        let needed = self.body.len() + data.len();
        if needed > self.body.capacity() {
            let target = needed.next_power_of_two().min(self.max_frame_bytes);
            self.body.reserve_exact(target - self.body.len());
        }
        self.body.extend_from_slice(data);
    }

    fn ignored(&mut self, cause: IgnoredCause) -> &mut u64 {
        match cause {
            IgnoredCause::NotFirst => &mut self.stats.ignored_not_first,
            IgnoredCause::Old => &mut self.stats.ignored_old,
            IgnoredCause::Duplicate => &mut self.stats.ignored_duplicate,
            IgnoredCause::OutOfOrder => &mut self.stats.ignored_out_of_order,
            IgnoredCause::Newer => &mut self.stats.ignored_newer,
        }
    }
}

fn frame_packet(header: &PacketHeader, data: &[u8]) -> Result<FramePacket, PacketError> {
    let sequence = header.sequence;
    let missing = |field| PacketError::Placeholder { sequence, field };
    Ok(FramePacket {
        sequence,
        frame: header.frame.ok_or(missing("frame number"))?,
        packets: header.frame_packets.ok_or(missing("number of packets"))?,
        first: header.first,
        timestamp_ms: header.timestamp_ms.ok_or(missing("timestamp"))?,
        data_bytes: data.len(),
    })
}
