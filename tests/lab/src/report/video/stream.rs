//! A video stream encoded as game-streaming hosts do: no frame waits for a later one, and none exceeds its share of the
//! rate.

use std::{
    fmt,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use anyhow::{Context, Result, ensure};
use image::RgbImage;

use crate::metrics::ffmpeg::{Ffmpeg, QUIET};

const FILE: &str = "stream.mkv";

/// Pictures are sRGB; streams are 8-bit 4:2:0 in BT.709, as every hardware decoder takes them.
const TO_VIDEO: &str = "scale=out_color_matrix=bt709:out_range=tv:flags=accurate_rnd+full_chroma_int,format=yuv420p";
const FROM_VIDEO: &str =
    "scale=in_color_matrix=bt709:in_range=tv:flags=accurate_rnd+full_chroma_int+full_chroma_inp,format=rgb24";

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum VideoCodec {
    /// H.264.
    X264,
    /// H.265.
    X265,
}

impl VideoCodec {
    fn encoder(self) -> &'static str {
        match self {
            Self::X264 => "libx264",
            Self::X265 => "libx265",
        }
    }

    /// Allows no key frames but the first.
    fn arguments(self) -> [&'static str; 2] {
        match self {
            Self::X264 => ["-x264-params", "keyint=infinite:scenecut=0"],
            Self::X265 => ["-x265-params", "keyint=-1:scenecut=0:log-level=error"],
        }
    }
}

impl fmt::Display for VideoCodec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::X264 => "x264",
            Self::X265 => "x265",
        })
    }
}

/// Errors if ffmpeg lacks the codec's encoder.
pub(super) fn check(ffmpeg: &Path, codec: VideoCodec) -> Result<()> {
    let listed = Command::new(ffmpeg).args(["-hide_banner", "-encoders"]).stdin(Stdio::null()).output();
    let listed = listed.with_context(|| format!("running {} (Debian: ffmpeg)", ffmpeg.display()))?;
    let has = String::from_utf8_lossy(&listed.stdout).split_whitespace().any(|word| word == codec.encoder());
    ensure!(has, "{} has no encoder {}", ffmpeg.display(), codec.encoder());
    Ok(())
}

pub(super) struct Stream {
    program: PathBuf,
    /// Keeps the folder with the stream.
    encoder: Ffmpeg,
    size: (u32, u32),
    frame_bytes: Vec<u64>,
}

impl Stream {
    /// All `pictures` must have one size.
    pub(super) fn encode(
        ffmpeg: &Path,
        codec: VideoCodec,
        (mbit_per_s, preset): (f64, &str),
        fps: f64,
        pictures: &[RgbImage],
    ) -> Result<Self> {
        let size = pictures.first().context("no pictures to encode")?.dimensions();
        let kbit = |value: f64| format!("{:.0}k", value * 1e3);
        let (rate, buffer) = (kbit(mbit_per_s), kbit(mbit_per_s / fps));
        let mut arguments = vec!["-vf", TO_VIDEO, "-c:v", codec.encoder(), "-preset", preset, "-tune", "zerolatency"];
        arguments.extend(["-b:v", &rate, "-maxrate", &rate, "-bufsize", &buffer]);
        arguments.extend(codec.arguments());
        arguments.push(FILE);
        let mut encoder = Ffmpeg::start(ffmpeg, size, fps, &arguments)?;
        pictures.iter().try_for_each(|picture| encoder.write(picture.as_raw()))?;
        encoder.finish()?;
        let mut stream = Self { program: ffmpeg.to_owned(), encoder, size, frame_bytes: Vec::new() };
        let listed = stream.read(&["-c", "copy", "-f", "framecrc", "pipe:1"])?;
        stream.frame_bytes = packet_sizes(&String::from_utf8_lossy(&listed))?;
        let coded = stream.frame_bytes.len();
        ensure!(coded == pictures.len(), "{} pictures became {coded} coded ones", pictures.len());
        Ok(stream)
    }

    /// Size of each coded picture, in bytes.
    pub(super) fn frame_bytes(&self) -> &[u64] {
        &self.frame_bytes
    }

    pub(super) fn decode(&self) -> Result<Vec<RgbImage>> {
        let raw = self.read(&["-vf", FROM_VIDEO, "-f", "rawvideo", "pipe:1"])?;
        let (width, height) = self.size;
        let bytes = 3 * width as usize * height as usize;
        ensure!(raw.len() == bytes * self.frame_bytes.len(), "{} bytes of decoded video", raw.len());
        let picture = |raw: &[u8]| RgbImage::from_raw(width, height, raw.to_vec()).context("a picture of another size");
        raw.chunks_exact(bytes).map(picture).collect()
    }

    fn read(&self, arguments: &[&str]) -> Result<Vec<u8>> {
        let mut command = Command::new(&self.program);
        command.args(QUIET).args(["-i", FILE]).args(arguments).current_dir(self.encoder.folder()).stdin(Stdio::null());
        let Output { status, stdout, stderr } = command.output().context("running ffmpeg")?;
        ensure!(status.success(), "ffmpeg ended with {status}: {}", String::from_utf8_lossy(&stderr));
        Ok(stdout)
    }
}

/// Parses the sizes in ffmpeg's packet list: `stream, dts, pts, duration, size, checksum`.
fn packet_sizes(list: &str) -> Result<Vec<u64>> {
    let size = |line: &str| line.split(',').nth(4)?.trim().parse().ok();
    let lines = list.lines().filter(|line| !line.starts_with('#') && !line.trim().is_empty());
    lines.map(|line| size(line).with_context(|| format!("ffmpeg's list of packets has {line:?}"))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packet_sizes_are_parsed_among_other_lines() {
        let list = "#software: Lavf\n#tb 0: 1/1000\n0,  0,  0,  16,  8011, 0x1\n0, 17, 17, 16, 402, 0x2, S=1, 8\n";
        assert_eq!(packet_sizes(list).unwrap(), [8011, 402]);
        assert!(packet_sizes("0, 0, 0").unwrap_err().to_string().contains("0, 0, 0"));
        assert!(packet_sizes("").unwrap().is_empty());
    }

    #[test]
    fn a_program_without_the_encoder_is_refused() {
        assert!(check(Path::new("/no/such/ffmpeg"), VideoCodec::X264).unwrap_err().to_string().contains("ffmpeg"));
        let error = check(Path::new("/bin/true"), VideoCodec::X265).unwrap_err().to_string();
        assert!(error.contains("libx265"), "{error}");
    }
}
