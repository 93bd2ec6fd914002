//! The client's camera: the only thing that it sends for every frame.
//!
//! The dissertation sends three vectors of three f32 (§3.5, 36 bytes). Ours are f64, so that a scene may be far from
//! its origin. A pose also has the field of view, the scene's time, the mask's size, the look-ahead and the scene's
//! revision: 86 bytes, little-endian, in the order of the fields.

use thiserror::Error;

use crate::{
    header::{HEADER_BYTES, HeaderError, PacketHeader},
    ids::FrameNumber,
    limits::{MAX_LOOK_AHEAD_MS, MAX_POSITION_M, MAX_SIDE_PX, YFOV_RANGE_RAD},
};

pub const POSE_BYTES: usize = 86;

/// Bytes of a pose packet: header and pose.
pub const POSE_PACKET_BYTES: usize = HEADER_BYTES + POSE_BYTES;

/// A camera, and the mask that the client wants for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Position in world space, in metres.
    pub position_m: [f64; 3],
    /// Rotation from camera to world space: a unit quaternion (x, y, z, w). The camera looks along its −Z, +Y is up.
    pub orientation: [f64; 4],
    /// Full vertical field of view, in radians.
    pub yfov_rad: f64,
    /// Time of the scene's animation, in seconds.
    pub scene_time_s: f64,
    /// Time that the client has spent since its first frame, in milliseconds; wraps.
    pub client_time_ms: u32,
    /// Width and height of the mask, in pixels. For a guard band it is larger than the picture. Both have the same
    /// field of view per pixel, so `yfov_rad` is the mask's.
    pub mask_px: [u16; 2],
    /// Estimated time from `client_time_ms` until the mask is shown, in milliseconds. The server traces for the pose
    /// that it predicts for then, and puts it into the frame's head. 0 requests exactly this pose.
    pub look_ahead_ms: u16,
    /// Newest state of the scene that the client knew ([`Edited::revision`](crate::message::Edited)). The server traces
    /// its newest, and puts a pose with that into the frame's head if it is another one.
    pub revision: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum PoseError {
    #[error("a pose has {POSE_BYTES} bytes, not {0}")]
    Length(usize),
    /// A field is not finite, or outside `limits`.
    #[error("pose field {0} is not finite or out of range")]
    Range(&'static str),
    #[error("orientation has length {0}, not 1")]
    NotUnit(f64),
}

impl Pose {
    /// Checks every field against [`crate::limits`].
    ///
    /// # Errors
    /// If a field is not finite or out of range, or the quaternion's length is off by more than 1e-3.
    pub fn validate(&self) -> Result<(), PoseError> {
        if !self.position_m.iter().all(|v| v.abs() <= MAX_POSITION_M) {
            return Err(PoseError::Range("position_m"));
        }
        if !YFOV_RANGE_RAD.contains(&self.yfov_rad) {
            return Err(PoseError::Range("yfov_rad"));
        }
        if !self.scene_time_s.is_finite() {
            return Err(PoseError::Range("scene_time_s"));
        }
        if !self.mask_px.iter().all(|side| (1..=MAX_SIDE_PX).contains(&u32::from(*side))) {
            return Err(PoseError::Range("mask_px"));
        }
        if self.look_ahead_ms > MAX_LOOK_AHEAD_MS {
            return Err(PoseError::Range("look_ahead_ms"));
        }
        let length = self.orientation.iter().map(|v| v * v).sum::<f64>().sqrt();
        // A NaN fails this comparison as well.
        if (length - 1.0).abs() <= 1e-3 { Ok(()) } else { Err(PoseError::NotUnit(length)) }
    }

    #[must_use]
    pub fn encode(&self) -> [u8; POSE_BYTES] {
        let [px, py, pz] = self.position_m;
        let [ox, oy, oz, ow] = self.orientation;
        let mut bytes = [0; POSE_BYTES];
        for (place, value) in
            bytes.chunks_exact_mut(8).zip([px, py, pz, ox, oy, oz, ow, self.yfov_rad, self.scene_time_s])
        {
            place.copy_from_slice(&value.to_le_bytes());
        }
        bytes[72..76].copy_from_slice(&self.client_time_ms.to_le_bytes());
        let [width, height] = self.mask_px;
        for (place, value) in bytes[76..82].chunks_exact_mut(2).zip([width, height, self.look_ahead_ms]) {
            place.copy_from_slice(&value.to_le_bytes());
        }
        bytes[82..].copy_from_slice(&self.revision.to_le_bytes());
        bytes
    }

    ///
    /// # Errors
    /// If the length is wrong or a field fails [`Self::validate`].
    pub fn decode(bytes: &[u8]) -> Result<Self, PoseError> {
        let bytes: &[u8; POSE_BYTES] = bytes.try_into().map_err(|_| PoseError::Length(bytes.len()))?;
        let mut values = [0.0; 9];
        for (value, place) in values.iter_mut().zip(bytes.chunks_exact(8)) {
            let mut raw = [0; 8];
            raw.copy_from_slice(place);
            *value = f64::from_le_bytes(raw);
        }
        let [px, py, pz, ox, oy, oz, ow, yfov_rad, scene_time_s] = values;
        let client_time_ms = u32::from_le_bytes([bytes[72], bytes[73], bytes[74], bytes[75]]);
        let short = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let pose = Self {
            position_m: [px, py, pz],
            orientation: [ox, oy, oz, ow],
            yfov_rad,
            scene_time_s,
            client_time_ms,
            mask_px: [short(76), short(78)],
            look_ahead_ms: short(80),
            revision: u32::from_le_bytes([bytes[82], bytes[83], bytes[84], bytes[85]]),
        };
        pose.validate().map(|()| pose)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum PosePacketError {
    #[error(transparent)]
    Header(#[from] HeaderError),
    #[error("pose packet {0} has no frame number")]
    NoFrame(u32),
    /// The header has a number of packets, a timestamp or the first-packet flag.
    #[error("packet {0} is not a pose packet: its header has fields of a visibility frame")]
    Visibility(u32),
    #[error(transparent)]
    Pose(#[from] PoseError),
}

/// Returns the pose packet of the client's frame `frame`: a header with placeholders in the fields of visibility
/// packets (§3.1), then the pose. `frame` must not be `u32::MAX`, the placeholder.
#[must_use]
pub fn encode_pose_packet(sequence: u32, frame: FrameNumber, pose: &Pose) -> [u8; POSE_PACKET_BYTES] {
    let header = PacketHeader {
        sequence,
        frame: Some(frame),
        #[expect(clippy::cast_possible_truncation, reason = "86")]
        data_bytes: POSE_BYTES as u16,
        frame_packets: None,
        first: false,
        timestamp_ms: None,
    };
    let mut packet = [0; POSE_PACKET_BYTES];
    packet[..HEADER_BYTES].copy_from_slice(&header.encode());
    packet[HEADER_BYTES..].copy_from_slice(&pose.encode());
    packet
}

/// Returns the sequence number, frame and pose of a pose packet.
///
/// # Errors
/// If the bytes are no packet, or a visibility packet, or the pose is invalid.
pub fn decode_pose_packet(datagram: &[u8]) -> Result<(u32, FrameNumber, Pose), PosePacketError> {
    let (header, data) = PacketHeader::decode(datagram)?;
    if header.frame_packets.is_some() || header.timestamp_ms.is_some() || header.first {
        return Err(PosePacketError::Visibility(header.sequence));
    }
    let frame = header.frame.ok_or(PosePacketError::NoFrame(header.sequence))?;
    Ok((header.sequence, frame, Pose::decode(data)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    const POSE: Pose = Pose {
        position_m: [1.0, -2.5, 1e6],
        orientation: [0.0, 0.6, 0.0, 0.8],
        yfov_rad: 1.0,
        scene_time_s: -3.25,
        client_time_ms: 77,
        mask_px: [1920, 1080],
        look_ahead_ms: 120,
        revision: 0x0102_0304,
    };

    #[test]
    fn a_pose_packet_round_trips() {
        let packet = encode_pose_packet(5, FrameNumber(9), &POSE);
        assert_eq!(decode_pose_packet(&packet), Ok((5, FrameNumber(9), POSE)));
    }

    #[test]
    fn the_range_of_fields_of_view_is_1_to_170_degrees() {
        assert_eq!(YFOV_RANGE_RAD, 1f64.to_radians()..=170f64.to_radians());
    }

    #[test]
    fn poses_outside_the_limits_are_refused() {
        let refused = |change: fn(&mut Pose)| {
            let mut pose = POSE;
            change(&mut pose);
            Pose::decode(&pose.encode()).unwrap_err()
        };
        for change in [
            (|pose| pose.position_m[0] = f64::NAN) as fn(&mut Pose),
            |pose| pose.position_m[1] = f64::NEG_INFINITY,
            |pose| pose.position_m[2] = 1.000_000_1e9,
        ] {
            assert_eq!(refused(change), PoseError::Range("position_m"));
        }
        for change in [
            (|pose| pose.yfov_rad = f64::NAN) as fn(&mut Pose),
            |pose| pose.yfov_rad = 0.0,
            |pose| pose.yfov_rad = 2.97,
        ] {
            assert_eq!(refused(change), PoseError::Range("yfov_rad"));
        }
        assert_eq!(refused(|pose| pose.scene_time_s = f64::INFINITY), PoseError::Range("scene_time_s"));
        for change in [(|pose| pose.mask_px[0] = 0) as fn(&mut Pose), |pose| pose.mask_px[1] = 4097] {
            assert_eq!(refused(change), PoseError::Range("mask_px"));
        }
        assert_eq!(refused(|pose| pose.look_ahead_ms = 1001), PoseError::Range("look_ahead_ms"));
        assert!(matches!(refused(|pose| pose.orientation[0] = f64::NAN), PoseError::NotUnit(_)));
        assert!(matches!(refused(|pose| pose.orientation = [0.0; 4]), PoseError::NotUnit(_)));
        assert!(matches!(refused(|pose| pose.orientation[3] = 0.9), PoseError::NotUnit(_)));
    }

    #[test]
    fn other_packets_are_refused_as_poses() {
        let good = encode_pose_packet(5, FrameNumber(9), &POSE);
        let with = |place: usize, bytes: &[u8]| {
            let mut bad = good;
            bad[place..place + bytes.len()].copy_from_slice(bytes);
            decode_pose_packet(&bad).unwrap_err()
        };
        assert_eq!(with(4, &[0xFF; 4]), PosePacketError::NoFrame(5));
        assert_eq!(with(10, &[2]), PosePacketError::Visibility(5));
        assert_eq!(with(10, &[1]), PosePacketError::Visibility(5));
        assert_eq!(with(12, &[0]), PosePacketError::Visibility(5));
        let short = HeaderError::DataSize { stated: 86, found: 85 };
        assert_eq!(decode_pose_packet(&good[..101]), Err(PosePacketError::Header(short)));
        let mut other = good[..101].to_vec();
        other[8] = 85;
        assert_eq!(decode_pose_packet(&other), Err(PosePacketError::Pose(PoseError::Length(85))));
    }
}
