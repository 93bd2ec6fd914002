//! An ffmpeg that reads raw pictures from its standard input.

use std::{
    fs::{self, File},
    io::Write as _,
    path::Path,
    process::{Child, ChildStdin, Command, Stdio},
};

use anyhow::{Context, Result, bail, ensure};
use tempfile::TempDir;

const ERRORS: &str = "errors";

pub const QUIET: [&str; 4] = ["-hide_banner", "-nostats", "-loglevel", "error"];

/// Dropping it kills the process.
#[derive(Debug)]
pub struct Ffmpeg {
    child: Child,
    stdin: Option<ChildStdin>,
    folder: TempDir,
}

impl Ffmpeg {
    /// Starts `program` on 8-bit RGB pictures of `size` at `fps`. `arguments` follow the input; paths in them are
    /// relative to a temporary folder.
    pub fn start(program: &Path, size: (u32, u32), fps: f64, arguments: &[&str]) -> Result<Self> {
        let folder = tempfile::tempdir().context("making a temporary folder")?;
        let errors = File::create(folder.path().join(ERRORS)).context("creating a log")?;
        let mut child = Command::new(program)
            .args(QUIET)
            .args(["-f", "rawvideo", "-pixel_format", "rgb24", "-video_size", &format!("{}x{}", size.0, size.1)])
            .args(["-framerate", &fps.to_string(), "-i", "pipe:0"])
            .args(arguments)
            .current_dir(folder.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(errors)
            .spawn()
            .with_context(|| format!("starting {}", program.display()))?;
        let stdin = child.stdin.take();
        Ok(Self { child, stdin, folder })
    }

    pub fn write(&mut self, pixels: &[u8]) -> Result<()> {
        if let Err(error) = self.stdin.as_mut().context("ffmpeg has no input")?.write_all(pixels) {
            bail!("writing to ffmpeg: {error}: {}", self.errors());
        }
        Ok(())
    }

    /// Ends the input and waits for the process. Errors if it reports failure.
    pub fn finish(&mut self) -> Result<()> {
        drop(self.stdin.take());
        let status = self.child.wait().context("waiting for ffmpeg")?;
        ensure!(status.success(), "ffmpeg ended with {status}: {}", self.errors());
        Ok(())
    }

    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    fn errors(&self) -> String {
        fs::read_to_string(self.folder.path().join(ERRORS)).unwrap_or_default().trim().to_owned()
    }
}

impl Drop for Ffmpeg {
    fn drop(&mut self) {
        // It may have ended already.
        if self.child.kill().is_ok() {
            drop(self.child.wait());
        }
    }
}
