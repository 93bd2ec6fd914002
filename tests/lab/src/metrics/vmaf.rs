//! VMAF, by an ffmpeg that has libvmaf: named by `GNOMON_FFMPEG`, or else the `ffmpeg` on the search path.
//!
//! Shown and true frame travel as one picture, one above the other, and are cut apart inside ffmpeg: no container, no
//! timestamps, nothing that could pair a frame with another one's truth.

use std::{
    env,
    ffi::OsStr,
    fs::{self, File},
    io::Write as _,
    path::{Path, PathBuf},
    process::{Child, ChildStdin, Command, Stdio},
    sync::OnceLock,
};

use anyhow::{Context, Result, bail, ensure};
use image::RgbImage;
use serde_json::Value;
use tempfile::TempDir;

/// Variable that names the ffmpeg to use.
pub const FFMPEG_VARIABLE: &str = "GNOMON_FFMPEG";

const LOG: &str = "vmaf.json";
const ERRORS: &str = "errors";

/// The mean VMAF (model v0.6.1, 0 to 100) of shown frames against true ones; `None` where no ffmpeg has libvmaf, which
/// is said once on standard error.
///
/// # Errors
/// When the counts or sizes of the frames differ, there is no frame, or ffmpeg fails.
pub fn vmaf(shown: &[RgbImage], truth: &[RgbImage], fps: f64) -> Result<Option<f64>> {
    ensure!(shown.len() == truth.len(), "{} frames shown, {} true ones", shown.len(), truth.len());
    let first = truth.first().context("no frames: VMAF of nothing")?;
    let Some(mut run) = Vmaf::start(first.dimensions(), fps)? else { return Ok(None) };
    for (shown, truth) in shown.iter().zip(truth) {
        run.push(shown, truth)?;
    }
    run.finish().map(Some)
}

/// A measurement under way, for frames that need not all be in memory at once.
#[derive(Debug)]
pub struct Vmaf {
    ffmpeg: Child,
    stdin: Option<ChildStdin>,
    folder: TempDir,
    size: (u32, u32),
    frames: usize,
}

impl Vmaf {
    /// Starts ffmpeg for frames of `size` pixels; `None` where no ffmpeg has libvmaf, which is said once.
    ///
    /// # Errors
    /// When the ffmpeg that was named has no libvmaf, or it does not start.
    pub fn start(size: (u32, u32), fps: f64) -> Result<Option<Self>> {
        match ffmpeg()? {
            None => Ok(None),
            Some(program) => Self::with(&program, size, fps).map(Some),
        }
    }

    fn with(program: &Path, size: (u32, u32), fps: f64) -> Result<Self> {
        let (width, height) = size;
        // Chroma counts for nothing in VMAF, and 4:4:4 takes odd sizes.
        let cut = |y: u32| format!("crop={width}:{height}:0:{y},scale=out_color_matrix=bt709,format=yuv444p");
        let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let graph = format!(
            "[0:v]split[a][b];[a]{}[shown];[b]{}[truth];\
             [shown][truth]libvmaf=log_fmt=json:log_path={LOG}:n_threads={threads}",
            cut(0),
            cut(height)
        );
        let folder = tempfile::tempdir().context("making a temporary folder")?;
        let errors = File::create(folder.path().join(ERRORS)).context("creating a log")?;
        let mut ffmpeg = Command::new(program)
            .args(["-hide_banner", "-nostats", "-loglevel", "error", "-f", "rawvideo", "-pixel_format", "rgb24"])
            .args(["-video_size", &format!("{width}x{}", 2 * height), "-framerate", &fps.to_string(), "-i", "pipe:0"])
            .args(["-filter_complex", &graph, "-f", "null", "-"])
            .current_dir(folder.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(errors)
            .spawn()
            .with_context(|| format!("starting {}", program.display()))?;
        let stdin = ffmpeg.stdin.take();
        Ok(Self { ffmpeg, stdin, folder, size, frames: 0 })
    }

    /// Adds a frame and its truth.
    ///
    /// # Errors
    /// When one is not of the agreed size, or ffmpeg takes no more.
    pub fn push(&mut self, shown: &RgbImage, truth: &RgbImage) -> Result<()> {
        for image in [shown, truth] {
            ensure!(image.dimensions() == self.size, "a frame of {:?} among {:?}", image.dimensions(), self.size);
        }
        let stdin = self.stdin.as_mut().context("ffmpeg has no input")?;
        if let Err(error) = stdin.write_all(shown.as_raw()).and_then(|()| stdin.write_all(truth.as_raw())) {
            bail!("ffmpeg takes no more: {error}: {}", self.errors());
        }
        self.frames += 1;
        Ok(())
    }

    /// The mean over all frames.
    ///
    /// # Errors
    /// When ffmpeg fails, or has compared another number of frames than it was given.
    pub fn finish(mut self) -> Result<f64> {
        drop(self.stdin.take());
        let status = self.ffmpeg.wait().context("waiting for ffmpeg")?;
        ensure!(status.success(), "ffmpeg ended with {status}: {}", self.errors());
        let log = fs::read_to_string(self.folder.path().join(LOG)).context("reading libvmaf's log")?;
        mean_in(&log, self.frames)
    }

    fn errors(&self) -> String {
        fs::read_to_string(self.folder.path().join(ERRORS)).unwrap_or_default().trim().to_owned()
    }
}

impl Drop for Vmaf {
    fn drop(&mut self) {
        // Already ended is as good.
        if self.ffmpeg.kill().is_ok() {
            drop(self.ffmpeg.wait());
        }
    }
}

/// The pooled mean in libvmaf's log, which must be of so many frames.
fn mean_in(log: &str, frames: usize) -> Result<f64> {
    let log: Value = serde_json::from_str(log).context("libvmaf's log")?;
    let compared = log["frames"].as_array().context("libvmaf's log lists no frames")?.len();
    ensure!(compared == frames, "libvmaf compared {compared} frames of {frames}");
    log["pooled_metrics"]["vmaf"]["mean"].as_f64().context("libvmaf's log has no mean")
}

/// The ffmpeg to use, looked for once.
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

/// The named ffmpeg, which must then be one with libvmaf, or else the search path's, if it is one.
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

    use super::*;

    fn frames(noise: u8) -> Vec<RgbImage> {
        let value = |x: u32, y: u32, t: u32| u8::try_from((x * 5 + y * 3 + t * 9) % 200 + 20).unwrap();
        let noisy = |v: u8, x: u32, y: u32| if (x * 7 + y * 13) % 5 < 2 { v.saturating_sub(noise) } else { v };
        (0..4).map(|t| RgbImage::from_fn(97, 65, |x, y| Rgb([noisy(value(x / 8, y / 8, t), x, y); 3]))).collect()
    }

    /// A program that answers `-filters` with `filters` and otherwise ends well without a result.
    fn impostor(filters: &str) -> (TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("ffmpeg");
        fs::write(&program, format!("#!/bin/sh\necho '{filters}'\n[ $2 = -filters ] || cat >/dev/null\n")).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        (folder, program)
    }

    #[test]
    fn where_there_is_a_libvmaf_it_tells_noise_from_none_and_elsewhere_there_is_no_figure() {
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
    fn a_named_ffmpeg_must_be_what_it_is_named_for() {
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
