//! Boots a real server and real clients on this machine, as processes, and cleans up behind them.

pub mod masks;
pub mod program;
pub mod ray_queries;

use std::{
    ffi::{OsStr, OsString},
    path::Path,
    time::Duration,
};

use anyhow::{Context, Result};
use serde_json::Value;
use tempfile::TempDir;

use program::{Outcome, Program};

/// Time that a program gets for anything: loading Pink Room on one busy core takes seconds, never minutes.
pub const PATIENCE: Duration = Duration::from_secs(300);

/// A running `gnomon-server`.
#[derive(Debug)]
pub struct ServerProcess {
    program: Program,
    url: String,
    _certificate: TempDir,
}

impl ServerProcess {
    /// Starts a server on a free loopback port, with a certificate of its own, unless the arguments say otherwise, and waits until it
    /// has printed its URL.
    ///
    /// # Errors
    /// When it is not built, ends, or does not get ready.
    pub fn start<A: AsRef<OsStr>>(scene: &Path, arguments: &[A]) -> Result<Self> {
        Self::start_in(scene, arguments, &[])
    }

    /// As [`Self::start`], in an environment with these variables.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn start_in<A: AsRef<OsStr>>(scene: &Path, arguments: &[A], environment: &[(&str, &str)]) -> Result<Self> {
        let certificate = tempfile::tempdir().context("making a temporary folder")?;
        let mut all: Vec<OsString> = vec!["--scene".into(), scene.into()];
        let says = |flag: &str| arguments.iter().any(|argument| argument.as_ref() == flag);
        if !says("--listen") {
            all.extend(["--listen".into(), "127.0.0.1:0".into()]);
        }
        if !says("--cert-dir") {
            all.extend(["--cert-dir".into(), certificate.path().into()]);
        }
        all.extend(arguments.iter().map(|argument| argument.as_ref().to_owned()));
        let mut program = Program::start(&program::find("gnomon-server")?, &all, environment)?;
        let url = program.wait_for(PATIENCE, url_in)?;
        Ok(Self { program, url, _certificate: certificate })
    }

    /// The URL that it printed.
    #[must_use]
    pub fn url(&self) -> &str {
        &self.url
    }

    /// The process.
    pub fn program(&mut self) -> &mut Program {
        &mut self.program
    }

    /// Kills it at once (SIGKILL).
    ///
    /// # Errors
    /// When the operating system refuses.
    pub fn kill(self) -> Result<()> {
        self.program.kill()
    }

    /// Waits for its end, whatever that is.
    ///
    /// # Errors
    /// When it does not end in time.
    pub fn wait(self, patience: Duration) -> Result<Outcome> {
        self.program.finish(patience)
    }

    /// Asks it to stop (SIGTERM) and waits for its end.
    ///
    /// # Errors
    /// When it does not end in time or reports failure.
    pub fn stop(self) -> Result<Outcome> {
        self.program.terminate()?;
        self.program.finish(PATIENCE)?.success()
    }
}

/// The first whole line's URL in what a server has said. A line that is still being written is not looked at.
fn url_in(said: &str) -> Option<String> {
    let whole = &said[..said.rfind('\n')? + 1];
    whole
        .split_whitespace()
        .find(|word| {
            ["gnomon://", "gnomon+lab-udp://", "gnomon+lab-tcp://"].iter().any(|scheme| word.starts_with(scheme))
        })
        .map(str::to_owned)
}

/// A headless client's work: what to render, and what it leaves behind in a folder.
#[derive(Debug, Clone)]
pub struct ClientJob<'a> {
    /// The server's URL, or `None` for a client without a server, which then needs further arguments.
    pub url: Option<&'a str>,
    /// Camera path file, with `#NAME` where it has several.
    pub path: OsString,
    /// Frames to render.
    pub frames: u32,
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// Folder for the summary, the statistics and, with `save_masks`, the masks.
    pub folder: &'a Path,
    /// Whether each frame waits for its own mask.
    pub wait: bool,
    /// Whether received masks are kept.
    pub save_masks: bool,
    /// Whatever else.
    pub arguments: Vec<OsString>,
}

impl ClientJob<'_> {
    /// Starts the client.
    ///
    /// # Errors
    /// When it is not built or cannot be started.
    pub fn start(&self) -> Result<Program> {
        let mut all: Vec<OsString> = self.url.map(OsString::from).into_iter().collect();
        all.extend(["--headless".into(), "--path".into(), self.path.clone()]);
        all.extend(["--frames".into(), self.frames.to_string().into()]);
        all.extend(["--size".into(), format!("{}x{}", self.size.0, self.size.1).into()]);
        all.extend(["--summary".into(), self.folder.join("summary.json").into()]);
        all.extend(["--stats".into(), self.folder.join("stats.jsonl").into()]);
        if self.wait {
            all.push("--wait".into());
        }
        if self.save_masks {
            all.extend(["--save-masks".into(), self.folder.join("masks").into()]);
        }
        all.extend(self.arguments.iter().cloned());
        Program::start(&program::find("gnomon-client")?, &all, &[])
    }

    /// The summary of a client that has ended.
    ///
    /// # Errors
    /// When there is none, or no JSON in it.
    pub fn summary(&self) -> Result<Value> {
        let path = self.folder.join("summary.json");
        let text = std::fs::read_to_string(&path).with_context(|| format!("reading {}", path.display()))?;
        serde_json::from_str(&text).with_context(|| format!("parsing {}", path.display()))
    }

    /// The statistics of a client that has ended: one object a frame.
    ///
    /// # Errors
    /// When there are none, or a line is no JSON.
    pub fn stats(&self) -> Result<Vec<Value>> {
        let path = self.folder.join("stats.jsonl");
        let text = std::fs::read_to_string(&path).with_context(|| format!("reading {}", path.display()))?;
        text.lines().map(|line| serde_json::from_str(line).with_context(|| format!("parsing {line:?}"))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_url_is_taken_from_whole_lines_only() {
        assert_eq!(url_in("listening\n  gnomon://127.0.0.1:4433/?cert=ab"), None);
        let said = "listening\n  gnomon://127.0.0.1:4433/?cert=ab\nmore";
        assert_eq!(url_in(said).as_deref(), Some("gnomon://127.0.0.1:4433/?cert=ab"));
        assert_eq!(url_in("gnomon+lab-tcp://[::1]:1/\n").as_deref(), Some("gnomon+lab-tcp://[::1]:1/"));
        assert_eq!(url_in("no url"), None);
    }
}
