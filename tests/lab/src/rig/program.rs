//! Child processes: finds the project's programs, collects their output, and kills them when dropped.

use std::{
    env,
    ffi::OsStr,
    fs::{self, File},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail, ensure};
use tempfile::TempDir;

const POLL: Duration = Duration::from_millis(5);

/// Returns the path of the built program `name`, in the running program's folder or above it. Errors if it is older
/// than its sources: a test of an outdated program proves nothing.
pub fn find(name: &str) -> Result<PathBuf> {
    let own = env::current_exe().context("the running program has no path")?;
    let folders = own.ancestors().skip(1).take(2);
    let found =
        folders.map(|folder| folder.join(name).with_extension(env::consts::EXE_EXTENSION)).find(|p| p.is_file());
    let Some(path) = found else {
        bail!(
            "{name} is not built beside {}: run `cargo build --workspace` (with --release for a release)",
            own.display()
        );
    };
    if let Some(newer) = newer_source(&path)? {
        bail!("{name} is older than {newer}: run `cargo build --workspace`");
    }
    Ok(path)
}

/// Returns a source of the program, from cargo's `.d` file beside it, that is newer than it or missing. Copied programs
/// have no such file and are not checked.
fn newer_source(program: &Path) -> Result<Option<String>> {
    let list = program.with_extension("d");
    let text = match fs::read_to_string(&list) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        text => text.with_context(|| format!("reading {}", list.display()))?,
    };
    let (_, sources) = text.split_once(": ").with_context(|| format!("{} lists no sources", list.display()))?;
    let built = fs::metadata(program)?.modified()?;
    // Spaces inside a path are escaped with a backslash.
    let sources = sources.trim().replace("\\ ", "\0");
    let newer = sources.split(' ').map(|source| source.replace('\0', " ")).find(|source| {
        let changed = fs::metadata(source).and_then(|source| source.modified());
        changed.map_or(true, |changed| changed > built)
    });
    Ok(newer)
}

/// A running program. Dropping it kills it and waits for its end.
#[derive(Debug)]
pub struct Program {
    name: String,
    child: Child,
    /// Output goes to files here: an unread pipe would block the program.
    folder: TempDir,
}

#[derive(Debug)]
pub struct Outcome {
    pub status: ExitStatus,
    pub stdout: String,
    pub stderr: String,
}

impl Program {
    /// Starts a program without input, and without the caller's `GNOMON_*` variables.
    pub fn start<A: AsRef<OsStr>>(path: &Path, arguments: &[A], environment: &[(&str, &str)]) -> Result<Self> {
        let folder = tempfile::tempdir().context("making a temporary folder")?;
        let name = path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into());
        let output = |which: &str| File::create(folder.path().join(which)).with_context(|| format!("creating {which}"));
        let mut command = Command::new(path);
        for (key, _) in env::vars_os().filter(|(key, _)| key.to_string_lossy().starts_with("GNOMON_")) {
            command.env_remove(key);
        }
        let child = command
            .args(arguments)
            // State and cache stay with the test.
            .env("HOME", folder.path())
            .env("XDG_CACHE_HOME", folder.path().join("cache"))
            .env("XDG_STATE_HOME", folder.path().join("state"))
            // Otherwise libwayland, which Mesa's software Vulkan asks for screens, complains on standard error.
            .env("XDG_RUNTIME_DIR", folder.path())
            .envs(environment.iter().copied())
            .stdin(Stdio::null())
            .stdout(output("stdout")?)
            .stderr(output("stderr")?)
            .spawn()
            .with_context(|| format!("starting {}", path.display()))?;
        Ok(Self { name, child, folder })
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Standard output and standard error so far.
    pub fn said(&self) -> Result<[String; 2]> {
        let read = |which: &str| {
            let bytes = fs::read(self.folder.path().join(which)).with_context(|| format!("reading {which}"))?;
            Ok::<_, anyhow::Error>(String::from_utf8_lossy(&bytes).into_owned())
        };
        Ok([read("stdout")?, read("stderr")?])
    }

    pub fn is_running(&mut self) -> Result<bool> {
        Ok(self.child.try_wait().context("asking for a child's status")?.is_none())
    }

    /// Waits until `found` accepts standard output or error. Errors, with the output, if the program ends first or
    /// `patience` runs out.
    pub fn wait_for<T>(&mut self, patience: Duration, found: impl Fn(&str) -> Option<T>) -> Result<T> {
        let start = Instant::now();
        loop {
            let running = self.is_running()?;
            let [stdout, stderr] = self.said()?;
            if let Some(thing) = found(&stdout).or_else(|| found(&stderr)) {
                return Ok(thing);
            }
            ensure!(running, "{} ended too early:\n{stdout}{stderr}", self.name);
            ensure!(start.elapsed() < patience, "{} did not respond within {patience:?}:\n{stdout}{stderr}", self.name);
            std::thread::sleep(POLL);
        }
    }

    /// Waits for the end. After `patience` the program is killed, and the error has its output.
    pub fn finish(mut self, patience: Duration) -> Result<Outcome> {
        let start = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().context("asking for a child's status")? {
                let [stdout, stderr] = self.said()?;
                return Ok(Outcome { status, stdout, stderr });
            }
            if start.elapsed() > patience {
                let [stdout, stderr] = self.said()?;
                bail!("{} still runs after {patience:?}:\n{stdout}{stderr}", self.name);
            }
            std::thread::sleep(POLL);
        }
    }

    /// Sends SIGKILL.
    pub fn kill(mut self) -> Result<()> {
        self.child.kill().with_context(|| format!("killing {}", self.name))?;
        self.child.wait().with_context(|| format!("waiting for {}", self.name)).map(drop)
    }

    /// Sends SIGTERM.
    pub fn terminate(&self) -> Result<()> {
        let status = Command::new("kill").args(["-TERM", &self.id().to_string()]).status().context("running kill")?;
        ensure!(status.success(), "kill -TERM {} failed", self.id());
        Ok(())
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // It may have ended already.
        if self.child.kill().is_ok() {
            drop(self.child.wait());
        }
    }
}

impl Outcome {
    pub fn success(self) -> Result<Self> {
        ensure!(self.status.success(), "a child ended with {}:\n{}{}", self.status, self.stdout, self.stderr);
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use std::time::SystemTime;

    use super::*;

    fn shell(script: &str) -> Program {
        Program::start(Path::new("/bin/sh"), &["-c", script], &[("GIVEN", "yes")]).unwrap()
    }

    #[test]
    fn output_and_status_are_collected() {
        let mut program = shell("echo out $GIVEN; echo err >&2; sleep 0.05; echo later; exit 7");
        assert_eq!(program.wait_for(Duration::from_secs(60), |s| s.find("later")).unwrap(), 8);
        let outcome = program.finish(Duration::from_secs(60)).unwrap();
        assert_eq!((outcome.status.code(), outcome.stdout.as_str()), (Some(7), "out yes\nlater\n"));
        assert_eq!(outcome.stderr, "err\n");
        assert!(outcome.success().unwrap_err().to_string().contains("out yes"));
        let error = shell("echo last words").wait_for(Duration::from_secs(60), |_| None::<()>).unwrap_err();
        assert!(error.to_string().contains("too early:\nlast words"), "{error}");
    }

    #[test]
    fn an_endless_program_is_killed() {
        let mut program = shell("echo busy; exec sleep 1000");
        program.wait_for(Duration::from_secs(60), |said| said.find("busy")).unwrap();
        let id = program.id();
        let error = program.finish(Duration::from_millis(200)).unwrap_err();
        assert!(error.to_string().contains("still runs after 200ms:\nbusy"), "{error}");
        assert!(!Path::new(&format!("/proc/{id}")).exists());
    }

    #[test]
    fn a_program_older_than_a_source_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        for name in ["a b.rs", "c.rs", "program"] {
            fs::write(place(name), "").unwrap();
        }
        let listed = |names: [&str; 2]| names.map(|name| place(name).display().to_string());
        let [spaced, plain] = listed(["a b.rs", "c.rs"]);
        let list = format!("{}: {} {plain}\n", place("program").display(), spaced.replace(' ', "\\ "));
        fs::write(place("program.d"), list).unwrap();
        let at = |name: &str, age_s: u64| {
            let time = SystemTime::now() - Duration::from_secs(age_s);
            File::options().write(true).open(place(name)).unwrap().set_modified(time).unwrap();
        };
        at("program", 50);
        at("a b.rs", 60);
        at("c.rs", 60);
        assert_eq!(newer_source(&place("program")).unwrap(), None);
        at("a b.rs", 40);
        assert_eq!(newer_source(&place("program")).unwrap(), Some(spaced));
        at("a b.rs", 60);
        fs::remove_file(place("c.rs")).unwrap();
        assert_eq!(newer_source(&place("program")).unwrap(), Some(plain));
    }

    #[test]
    fn a_missing_program_is_named_with_the_remedy() {
        let error = find("gnomon-nosuch").unwrap_err().to_string();
        assert!(error.contains("gnomon-nosuch is not built") && error.contains("cargo build"), "{error}");
    }
}
