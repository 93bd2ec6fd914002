//! Prints how long each codec takes on one core, and how many bytes it makes.
//!
//! ```text
//! cargo run --release -p gnomon-protocol --example codec_times [WIDTH HEIGHT LIGHTS] [FRAME.body …]
//! ```
//!
//! Without frames it uses synthetic masks: shadows of discs, with edges as ragged as those of leaves in one light of
//! four. With frames (as `gnomon-client --save-masks` writes them), it uses their masks.

use std::{
    env, fs,
    time::{Duration, Instant},
};

use gnomon_protocol::{
    codec::{CodecId, Decoder, EncodedFrame, Encoder},
    ids::FrameNumber,
    limits::MAX_PACKET_BYTES,
    mask::{Mask, MaskShape},
    packetizer::Packetizer,
    reassembler::{Policy, Reassembler},
};

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let numbers = arguments.iter().map_while(|argument| argument.parse().ok()).collect::<Vec<u32>>();
    let shape = match numbers[..] {
        [] => MaskShape::new(1920, 1080, 4)?,
        [width, height, lights] => MaskShape::new(width, height, lights)?,
        _ => return Err("give all of WIDTH HEIGHT LIGHTS, or none".into()),
    };
    let files = &arguments[numbers.len()..];
    let masks = if files.is_empty() { made_up(shape) } else { read(files)? };
    println!("{:?}, {} masks; medians", masks[0].shape(), masks.len());
    println!("codec       bytes     packets  encode ms  packetize ms  reassemble ms  decode ms");
    let one_core = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    one_core.install(|| {
        CodecId::ALL.into_iter().try_for_each(|codec| measure(codec, &masks)).map_err(|error| error.to_string())
    })?;
    Ok(())
}

fn read(files: &[String]) -> Result<Vec<Mask>, Failure> {
    files
        .iter()
        .map(|file| {
            let mut mask = Mask::new(MaskShape::new(1, 1, 1)?);
            Decoder::new().decode(&fs::read(file)?, &mut mask)?;
            Ok(mask)
        })
        .collect()
}

/// Five frames of 24 discs a light, which move 3 pixels a frame.
fn made_up(shape: MaskShape) -> Vec<Mask> {
    let mut state = 1u32;
    let mut random = |limit: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        i64::from((state >> 8) % limit)
    };
    let discs: Vec<[i64; 4]> = (0..shape.lights())
        .flat_map(|light| (0..24).map(move |_| light))
        .map(|light| [light.into(), random(shape.width()), random(shape.height()), 10 + random(150)])
        .collect();
    let frame = |step: i64| {
        let mut mask = Mask::new(shape);
        for light in 0..shape.lights() {
            (0..shape.height()).for_each(|y| (0..shape.width()).for_each(|x| mask.set(light, x, y, true)));
        }
        for [light, x, y, radius] in discs.iter().map(|[light, x, y, radius]| [*light, x + step * 3, *y, *radius]) {
            for py in (y - radius).max(0)..(y + radius).min(shape.height().into()) {
                for px in (x - radius).max(0)..(x + radius).min(shape.width().into()) {
                    // One light in four has ragged edges over the outer fifth of the disc.
                    let ragged = if light % 4 == 3 { ((px * 7919) ^ (py * 104_729)) % 5 * radius / 20 } else { 0 };
                    if (px - x).pow(2) + (py - y).pow(2) < (radius - ragged).pow(2) {
                        let [light, px, py] = [light, px, py].map(|value| u32::try_from(value).unwrap_or(0));
                        mask.set(light, px, py, false);
                    }
                }
            }
        }
        mask
    };
    (0..5).map(frame).collect()
}

fn measure(codec: CodecId, masks: &[Mask]) -> Result<(), Failure> {
    let (mut encoder, mut decoder) = (Encoder::new(codec), Decoder::new());
    let mut packetizer = Packetizer::new(MAX_PACKET_BYTES);
    let mut reassembler = Reassembler::new(Policy::WholeFrame);
    let (mut body, mut decoded) = (EncodedFrame::default(), masks[0].clone());
    let (mut bytes, mut packet_count) = (0, 0);
    let mut times: [Vec<Duration>; 4] = Default::default();
    let rounds = 20;
    for (number, mask) in (0..).zip(std::iter::repeat_n(masks, rounds).flatten()) {
        let start = Instant::now();
        encoder.encode(mask, &mut body)?;
        times[0].push(start.elapsed());

        let start = Instant::now();
        let packets: Vec<_> = packetizer.packets(FrameNumber(number), 0, &body)?.collect();
        times[1].push(start.elapsed());

        let start = Instant::now();
        for packet in &packets {
            reassembler.push(packet)?;
        }
        times[2].push(start.elapsed());

        let received = reassembler.frame().ok_or("the packets do not make a frame")?;
        let start = Instant::now();
        decoder.decode(received.body, &mut decoded)?;
        times[3].push(start.elapsed());

        if decoded != *mask {
            return Err(format!("{codec} changed mask {number}").into());
        }
        bytes += body.len();
        packet_count += packets.len();
    }
    let frames = rounds * masks.len();
    let [encode, packetize, reassemble, decode] = times.map(|mut times| {
        times.sort_unstable();
        times[times.len() / 2].as_secs_f64() * 1e3
    });
    println!(
        "{codec:<10} {:>9} {:>9} {encode:>10.3} {packetize:>13.3} {reassemble:>14.3} {decode:>10.3}",
        bytes / frames,
        packet_count / frames
    );
    Ok(())
}
