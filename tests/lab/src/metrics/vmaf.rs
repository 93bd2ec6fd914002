//! VMAF by an ffmpeg with libvmaf: the one that `GNOMON_FFMPEG` names, or `ffmpeg` on the search path.
//!
//! Shown and true frame travel as one picture, one above the other, and ffmpeg cuts them apart. Without container and
//! timestamps, frames cannot be mispaired.

use std::{
    env,
    ffi::OsStr,
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::OnceLock,
};

use anyhow::{Context, Result, ensure};
use image::RgbImage;
use serde_json::Value;

use super::ffmpeg::Ffmpeg;

pub const FFMPEG_VARIABLE: &str = "GNOMON_FFMPEG";

const LOG: &str = "vmaf.json";

/// Returns the mean VMAF (model v0.6.1, 0 to 100) of shown frames against true ones; `None` if no ffmpeg has libvmaf,
/// which is printed once.
pub fn vmaf(shown: &[RgbImage], truth: &[RgbImage], fps: f64) -> Result<Option<f64>> {
    ensure!(shown.len() == truth.len(), "{} frames shown, {} true ones", shown.len(), truth.len());
    let first = truth.first().context("no frames to compare")?;
    let Some(mut run) = Vmaf::start(first.dimensions(), fps)? else { return Ok(None) };
    for (shown, truth) in shown.iter().zip(truth) {
        run.push(shown, truth)?;
    }
    run.finish().map(Some)
}

/// A running measurement, for frames that need not all be in memory.
#[derive(Debug)]
pub struct Vmaf {
    ffmpeg: Ffmpeg,
    size: (u32, u32),
    frames: usize,
}

impl Vmaf {
    /// Starts ffmpeg for frames of `size` pixels. Returns `None`, and prints a line once, if no ffmpeg has libvmaf.
    pub fn start(size: (u32, u32), fps: f64) -> Result<Option<Self>> {
        match ffmpeg()? {
            None => Ok(None),
            Some(program) => Self::with(&program, size, fps).map(Some),
        }
    }

    fn with(program: &Path, size: (u32, u32), fps: f64) -> Result<Self> {
        let (width, height) = size;
        // VMAF ignores chroma, and 4:4:4 takes odd sizes.
        let cut = |y: u32| format!("crop={width}:{height}:0:{y},scale=out_color_matrix=bt709,format=yuv444p");
        let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let graph = format!(
            "[0:v]split[a][b];[a]{}[shown];[b]{}[truth];\
             [shown][truth]libvmaf=log_fmt=json:log_path={LOG}:n_threads={threads}",
            cut(0),
            cut(height)
        );
        let arguments = ["-filter_complex", &graph, "-f", "null", "-"];
        Ok(Self { ffmpeg: Ffmpeg::start(program, (width, 2 * height), fps, &arguments)?, size, frames: 0 })
    }

    pub fn push(&mut self, shown: &RgbImage, truth: &RgbImage) -> Result<()> {
        for image in [shown, truth] {
            ensure!(image.dimensions() == self.size, "a frame of {:?} among {:?}", image.dimensions(), self.size);
        }
        self.ffmpeg.write(shown.as_raw())?;
        self.ffmpeg.write(truth.as_raw())?;
        self.frames += 1;
        Ok(())
    }

    pub fn finish(mut self) -> Result<f64> {
        self.ffmpeg.finish()?;
        let log = fs::read_to_string(self.ffmpeg.folder().join(LOG)).context("reading libvmaf's log")?;
        mean_in(&log, self.frames)
    }
}

/// Returns the pooled mean from libvmaf's log. Errors if it covers another number of frames.
fn mean_in(log: &str, frames: usize) -> Result<f64> {
    let log: Value = serde_json::from_str(log).context("libvmaf's log")?;
    let compared = log["frames"].as_array().context("libvmaf's log lists no frames")?.len();
    ensure!(compared == frames, "libvmaf compared {compared} frames of {frames}");
    log["pooled_metrics"]["vmaf"]["mean"].as_f64().context("libvmaf's log has no mean")
}

/// Returns the ffmpeg to use; looks for it once.
fn ffmpeg() -> Result<Option<PathBuf>> {
    static FOUND: OnceLock<Result<Option<PathBuf>, String>> = OnceLock::new();
    let found = FOUND.get_or_init(|| {
        let found = find(env::var_os(FFMPEG_VARIABLE).as_deref()).map_err(|error| format!("{error:#}"));
        if matches!(found, Ok(None)) {
            eprintln!("VMAF is left out: no ffmpeg with libvmaf on the search path, and {FFMPEG_VARIABLE} names none");
        }
        found
    });
    found.clone().map_err(anyhow::Error::msg)
}

/// Returns the named ffmpeg, or the search path's if it has libvmaf. Errors if the named one has none.
fn find(named: Option<&OsStr>) -> Result<Option<PathBuf>> {
    let has_vmaf = |program: &Path| {
        let listed = Command::new(program).args(["-hide_banner", "-filters"]).stdin(Stdio::null()).output();
        listed.map(|listed| String::from_utf8_lossy(&listed.stdout).split_whitespace().any(|word| word == "libvmaf"))
    };
    if let Some(named) = named.map(Path::new) {
        let found = has_vmaf(named).with_context(|| format!("{FFMPEG_VARIABLE}: running {}", named.display()))?;
        ensure!(found, "{FFMPEG_VARIABLE}: {} has no libvmaf", named.display());
        return Ok(Some(named.to_owned()));
    }
    let program = PathBuf::from("ffmpeg");
    Ok(has_vmaf(&program).unwrap_or(false).then_some(program))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use image::Rgb;
    use tempfile::TempDir;

    use super::*;

    fn frames(noise: u8) -> Vec<RgbImage> {
        let value = |x: u32, y: u32, t: u32| u8::try_from((x * 5 + y * 3 + t * 9) % 200 + 20).unwrap();
        let noisy = |v: u8, x: u32, y: u32| if (x * 7 + y * 13) % 5 < 2 { v.saturating_sub(noise) } else { v };
        (0..4).map(|t| RgbImage::from_fn(97, 65, |x, y| Rgb([noisy(value(x / 8, y / 8, t), x, y); 3]))).collect()
    }

    /// A program that prints `filters` for `-filters` and otherwise succeeds without a result.
    fn impostor(filters: &str) -> (TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("ffmpeg");
        fs::write(&program, format!("#!/bin/sh\necho '{filters}'\n[ $2 = -filters ] || cat >/dev/null\n")).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        (folder, program)
    }

    #[test]
    fn vmaf_falls_with_noise_and_is_none_without_libvmaf() {
        let truth = frames(0);
        let figures = [0, 20, 60].map(|noise| vmaf(&frames(noise), &truth, 60.0).unwrap());
        match (ffmpeg().unwrap(), figures) {
            (Some(_), [Some(equal), Some(little), Some(much)]) => {
                // The model gives equal frames 97 to 100, depending on how much moves in them.
                assert!((97.0..=100.0).contains(&equal) && equal > little && little > much, "{figures:?}");
            }
            (found, figures) => assert_eq!((found, figures), (None, [None; 3])),
        }
    }

    #[test]
    fn frames_that_do_not_pair_are_refused() {
        let error = vmaf(&frames(0), &frames(0)[..3], 60.0).unwrap_err().to_string();
        assert_eq!(error, "4 frames shown, 3 true ones");
        assert!(vmaf(&[], &[], 60.0).unwrap_err().to_string().contains("no frames"));
        let log = r#"{"frames": [{}, {}], "pooled_metrics": {"vmaf": {"mean": 88.5}}}"#;
        assert!((mean_in(log, 2).unwrap() - 88.5).abs() < 1e-12);
        assert!(mean_in(log, 3).unwrap_err().to_string().contains("2 frames of 3"));
        assert!(mean_in("{}", 0).is_err());
    }

    #[test]
    fn a_named_ffmpeg_must_have_libvmaf() {
        let (_folder, plain) = impostor("psnr");
        assert!(find(Some(plain.as_os_str())).unwrap_err().to_string().contains("has no libvmaf"));
        assert!(find(Some(OsStr::new("/no/such/ffmpeg"))).unwrap_err().to_string().contains("/no/such/ffmpeg"));
        let (_folder, mute) = impostor("T. libvmaf VV->V");
        assert_eq!(find(Some(mute.as_os_str())).unwrap(), Some(mute.clone()));
        let mut run = Vmaf::with(&mute, (97, 65), 60.0).unwrap();
        run.push(&frames(0)[0], &frames(0)[0]).unwrap();
        assert!(run.push(&RgbImage::new(1, 1), &RgbImage::new(1, 1)).is_err());
        assert!(run.finish().unwrap_err().to_string().contains("libvmaf's log"));
    }
}
