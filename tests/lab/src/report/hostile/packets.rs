//! Packets that nobody should send.

use std::{
    net::{Ipv4Addr, SocketAddr, UdpSocket},
    time::{Duration, Instant},
};

use anyhow::{Result, ensure};
use gnomon_client::{
    app::probe::{ProbeOptions, run_probe},
    camera_path::CameraPath,
    link::url::ServerUrl,
};
use gnomon_protocol::codec::CodecId;
use tokio::runtime::Handle;

/// Sockets that garbage comes from.
const SOURCES: usize = 16;

/// Packets between two pauses: loopback has no back-pressure, and what the kernel drops tests nothing.
const BURST: u32 = 64;

/// First packets sent to see what comes back.
const ASKED: u64 = 500;

/// A small generator that needs no crate and gives the same packets every time (xorshift64*, Vigna 2016).
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    fn below(&mut self, bound: usize) -> usize {
        usize::try_from(self.next() >> 33).unwrap_or(0) % bound.max(1)
    }

    fn fill(&mut self, bytes: &mut [u8]) {
        for chunk in bytes.chunks_mut(8) {
            let word = self.next().to_le_bytes();
            chunk.copy_from_slice(&word[..chunk.len()]);
        }
    }
}

/// A client's first packet, whole: what a recording holds.
///
/// # Errors
/// When the client sends none.
pub(super) fn first(runtime: &Handle, path: &CameraPath) -> Result<Vec<u8>> {
    let ear = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
    ear.set_read_timeout(Some(Duration::from_secs(5)))?;
    let url: ServerUrl = format!("gnomon://{}/?cert={}", ear.local_addr()?, "00".repeat(32)).parse()?;
    let options = ProbeOptions {
        connect_timeout: ProbeOptions::CONNECT_TIMEOUT,
        url,
        token: None,
        width: 64,
        height: 36,
        codec: CodecId::PlanesLz4,
        frames: 1,
        fps: None,
        start_time_s: 0.0,
    };
    let mut packet = vec![0; 2048];
    std::thread::scope(|scope| {
        // It never gets an answer, and gives up.
        let connecting = scope.spawn(|| run_probe(runtime, &options, path).map(drop));
        let length = ear.recv(&mut packet)?;
        packet.truncate(length);
        ensure!(connecting.join().is_ok_and(|ended| ended.is_err()), "nobody was there to connect to");
        ensure!(length >= 1200, "a first packet of {length} bytes");
        Ok(packet)
    })
}

/// Sends garbage of every kind in turn, and says how much of it until `patience` ended.
///
/// # Errors
/// When a socket fails.
pub(super) fn garbage(server: SocketAddr, first: &[u8], packets: u32, patience: Duration) -> Result<u32> {
    let sockets = (0..SOURCES).map(|_| UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))).collect::<Result<Vec<_>, _>>()?;
    let mut noise = Noise(0x9E37_79B9_7F4A_7C15);
    let begun = Instant::now();
    let mut packet = Vec::new();
    for number in 0..packets {
        packet.clear();
        match number % 4 {
            // Anything.
            0 => {
                packet.resize(1 + noise.below(1400), 0);
                noise.fill(&mut packet);
            }
            // A long header with the right version, and nothing right behind it.
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
            // A real first packet, again.
            _ => packet.extend_from_slice(first),
        }
        let socket = &sockets[noise.below(SOURCES)];
        // A full buffer loses one, as a network would.
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

/// Bytes sent as a first packet from an address that never answers, and bytes that came back to it.
///
/// # Errors
/// When a socket fails, or nothing comes back at all: then nothing was asked.
pub(super) fn amplification(server: SocketAddr, first: &[u8]) -> Result<(u64, u64)> {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
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
    // What a server tries again comes later.
    socket.set_read_timeout(Some(Duration::from_secs(2)))?;
    while let Ok(length) = socket.recv(&mut answer) {
        answered += length as u64;
        answers += 1;
    }
    ensure!(answers > 0, "the server did not even send a Retry");
    Ok((ASKED * first.len() as u64, answered))
}
