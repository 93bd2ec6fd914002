//! Runs a real server and real clients as processes.

mod ask;
pub mod masks;
pub mod program;
pub mod ray_queries;
pub mod usage;

use std::{
    ffi::{OsStr, OsString},
    path::Path,
    time::Duration,
};

use anyhow::{Context, Result};
use serde_json::Value;
use tempfile::TempDir;

pub use self::ask::Ask;
use self::program::{Outcome, Program};

/// Longest wait for a program: loading Pink Room on one busy core takes seconds, never minutes.
pub const PATIENCE: Duration = Duration::from_secs(300);

#[derive(Debug)]
pub struct ServerProcess {
    program: Program,
    url: String,
    _certificate: TempDir,
}

impl ServerProcess {
    /// Starts a server and waits for its URL. Unless the arguments say otherwise, it has a free loopback port and a new
    /// certificate.
    pub fn start<A: AsRef<OsStr>>(scene: &Path, arguments: &[A]) -> Result<Self> {
        Self::start_in(scene, arguments, &[])
    }

    /// Like [`Self::start`], with environment variables.
    pub fn start_in<A: AsRef<OsStr>>(scene: &Path, arguments: &[A], environment: &[(&str, &str)]) -> Result<Self> {
        Self::start_through(&[], scene, arguments, environment)
    }

    /// Like [`Self::start_in`]. The command `through` starts the server and becomes it, as `ip netns exec NAME` does.
    pub fn start_through<A: AsRef<OsStr>>(
        through: &[String],
        scene: &Path,
        arguments: &[A],
        environment: &[(&str, &str)],
    ) -> Result<Self> {
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
        let mut path = program::find("gnomon-server")?;
        if let [first, rest @ ..] = through {
            let server = std::mem::replace(&mut path, first.into());
            all.splice(0..0, rest.iter().map(OsString::from).chain([server.into()]));
        }
        let mut program = Program::start(&path, &all, environment)?;
        let url = program.wait_for(PATIENCE, url_in)?;
        Ok(Self { program, url, _certificate: certificate })
    }

    pub fn url(&self) -> &str {
        &self.url
    }

    pub fn program(&mut self) -> &mut Program {
        &mut self.program
    }

    /// Sends SIGKILL.
    pub fn kill(self) -> Result<()> {
        self.program.kill()
    }

    /// Accepts any exit status.
    pub fn wait(self, patience: Duration) -> Result<Outcome> {
        self.program.finish(patience)
    }

    /// Sends SIGTERM and waits for the end. Errors if the program reports failure.
    pub fn stop(self) -> Result<Outcome> {
        self.program.terminate()?;
        self.program.finish(PATIENCE)?.success()
    }
}

/// Returns the URL in a server's output. Ignores a last line that is not complete.
fn url_in(said: &str) -> Option<String> {
    let whole = &said[..said.rfind('\n')? + 1];
    whole
        .split_whitespace()
        .find(|word| {
            ["gnomon://", "gnomon+lab-udp://", "gnomon+lab-tcp://"].iter().any(|scheme| word.starts_with(scheme))
        })
        .map(str::to_owned)
}

#[derive(Debug, Clone)]
pub struct ClientJob<'a> {
    /// The server's URL; `None` needs `--offline` among the arguments.
    pub url: Option<&'a str>,
    /// Camera path: FILE or FILE#NAME.
    pub path: OsString,
    pub frames: u32,
    pub size: (u32, u32),
    /// For summary, statistics and saved masks.
    pub folder: &'a Path,
    pub save_masks: bool,
    pub arguments: Vec<OsString>,
}

impl ClientJob<'_> {
    pub fn start(&self) -> Result<Program> {
        let mut all: Vec<OsString> = self.url.map(OsString::from).into_iter().collect();
        all.extend(["--headless".into(), "--path".into(), self.path.clone()]);
        all.extend(["--frames".into(), self.frames.to_string().into()]);
        all.extend(["--size".into(), format!("{}x{}", self.size.0, self.size.1).into()]);
        all.extend(["--summary".into(), self.folder.join("summary.json").into()]);
        all.extend(["--stats".into(), self.folder.join("stats.jsonl").into()]);
        if self.save_masks {
            all.extend(["--save-masks".into(), self.folder.join("masks").into()]);
        }
        all.extend(self.arguments.iter().cloned());
        Program::start(&program::find("gnomon-client")?, &all, &[])
    }

    /// Reads the summary of a client that has ended.
    pub fn summary(&self) -> Result<Value> {
        let path = self.folder.join("summary.json");
        let text = std::fs::read_to_string(&path).with_context(|| format!("reading {}", path.display()))?;
        serde_json::from_str(&text).with_context(|| format!("parsing {}", path.display()))
    }

    /// Reads the statistics of a client that has ended: one object per frame.
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
