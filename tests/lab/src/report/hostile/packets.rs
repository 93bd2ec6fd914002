//! Garbage packets.

use std::{
    net::{Ipv4Addr, UdpSocket},
    time::{Duration, Instant},
};

use anyhow::{Result, ensure};
use gnomon_client::{app::probe::run_probe, camera_path::CameraPath, link::url::ServerUrl};
use tokio::runtime::Handle;

use super::addresses::Addresses;
use crate::rig::Ask;

const SOURCES: usize = 16;

/// Packets between pauses: loopback has no back-pressure, and packets that the kernel drops test nothing.
const BURST: u32 = 64;

/// First packets sent to measure amplification.
const ASKED: u64 = 500;

/// A generator with the same output every time (xorshift64*, Vigna 2016).
pub(super) struct Noise(u64);

impl Noise {
    pub(super) const fn new() -> Self {
        Self(0x9E37_79B9_7F4A_7C15)
    }

    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    fn below(&mut self, bound: usize) -> usize {
        usize::try_from(self.next() >> 33).unwrap_or(0) % bound.max(1)
    }

    pub(super) fn fill(&mut self, bytes: &mut [u8]) {
        for chunk in bytes.chunks_mut(8) {
            let word = self.next().to_le_bytes();
            chunk.copy_from_slice(&word[..chunk.len()]);
        }
    }
}

/// Returns a real client's first packet.
pub(super) fn first(runtime: &Handle, path: &CameraPath) -> Result<Vec<u8>> {
    let listener = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
    listener.set_read_timeout(Some(Duration::from_secs(5)))?;
    let url: ServerUrl = format!("gnomon://{}/?cert={}", listener.local_addr()?, "00".repeat(32)).parse()?;
    let options = Ask { size: (64, 36), fps: None, frames: 1 }.of(&url);
    let mut packet = vec![0; 2048];
    std::thread::scope(|scope| {
        // It gets no answer and gives up.
        let connecting = scope.spawn(|| run_probe(runtime, &options, path).map(drop));
        let length = listener.recv(&mut packet)?;
        packet.truncate(length);
        ensure!(connecting.join().is_ok_and(|ended| ended.is_err()), "the client connected without a server");
        ensure!(length >= 1200, "a first packet of {length} bytes");
        Ok(packet)
    })
}

/// Sends every kind of garbage in turn; returns how many packets were sent before `patience` ended.
pub(super) fn garbage(addresses: &Addresses, first: &[u8], packets: u32, patience: Duration) -> Result<u32> {
    let sockets = addresses.pairs().cycle().take(SOURCES.max(addresses.pairs().len()));
    let sockets = sockets.map(|(from, to)| Ok((UdpSocket::bind((from, 0))?, to))).collect::<Result<Vec<_>>>()?;
    let mut noise = Noise::new();
    let begun = Instant::now();
    let mut packet = Vec::new();
    for number in 0..packets {
        packet.clear();
        match number % 4 {
            // Random bytes.
            0 => {
                packet.resize(1 + noise.below(1400), 0);
                noise.fill(&mut packet);
            }
            // A long header with the right version, then random bytes.
            1 => {
                packet.resize(1200, 0);
                noise.fill(&mut packet);
                packet[..6].copy_from_slice(&[0xc0, 0, 0, 0, 1, 8]);
            }
            // A real first packet with a few bytes changed.
            2 => {
                packet.extend_from_slice(first);
                for _ in 0..=noise.below(8) {
                    let at = noise.below(packet.len());
                    packet[at] ^= u8::try_from(noise.below(255)).unwrap_or(0) + 1;
                }
            }
            // A real first packet, replayed.
            _ => packet.extend_from_slice(first),
        }
        let (socket, server) = &sockets[noise.below(sockets.len())];
        // A full buffer loses the packet, as a network would.
        let _ = socket.send_to(&packet, server);
        if number % BURST == BURST - 1 {
            std::thread::sleep(Duration::from_millis(1));
            if begun.elapsed() > patience {
                return Ok(number + 1);
            }
        }
    }
    Ok(packets)
}

/// Returns the bytes sent as first packets from an address that never answers, and the bytes received there.
pub(super) fn amplification(addresses: &Addresses, first: &[u8]) -> Result<(u64, u64)> {
    let (from, server) = addresses.first();
    let socket = UdpSocket::bind((from, 0))?;
    let (mut answered, mut answers) = (0, 0_u64);
    let mut answer = [0; 2048];
    for _ in 0..ASKED {
        socket.send_to(first, server)?;
        socket.set_read_timeout(Some(Duration::from_millis(5)))?;
        while let Ok(length) = socket.recv(&mut answer) {
            answered += length as u64;
            answers += 1;
        }
    }
    // Retransmissions come later.
    socket.set_read_timeout(Some(Duration::from_secs(2)))?;
    while let Ok(length) = socket.recv(&mut answer) {
        answered += length as u64;
        answers += 1;
    }
    ensure!(answers > 0, "the server did not even send a Retry");
    Ok((ASKED * first.len() as u64, answered))
}
