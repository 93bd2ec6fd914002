//! A server on loopback as a child process, for the demo and for the reference of a split picture.

use std::{
    convert::Infallible,
    ffi::{OsStr, OsString},
    fs,
    io::{BufRead as _, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::mpsc::{Receiver, SyncSender, sync_channel},
    thread::JoinHandle,
    time::{Duration, Instant},
};

use gnomon_scene::LoadOptions;
use tempfile::TempDir;
use thiserror::Error;

use crate::link::url::ServerUrl;

/// Includes building its hierarchies.
const START_TIMEOUT: Duration = Duration::from_secs(120);

/// After this it is killed.
const STOP_TIMEOUT: Duration = Duration::from_secs(5);

#[derive(Debug, Error)]
pub enum LocalServerError {
    /// There is no server program beside this one.
    #[error("there is no {}: build it with cargo build -p gnomon-server", .0.display())]
    Missing(PathBuf),
    /// The process or its folder cannot be created.
    #[error("cannot start in {}: {source}", folder.display())]
    Start { folder: PathBuf, source: std::io::Error },
    /// The scene is not in the cache.
    #[error("the scene is not cached: cannot write to {}, or it is larger than --cache-limit", .0.display())]
    NotCached(PathBuf),
    #[error("the scene is not cached: no cache folder of this user is known, pass --cache-dir")]
    NoCache,
    /// The server ended, or printed nothing, before it listened.
    #[error("the server does not start: {0}")]
    NotListening(String),
}

/// A scene on this machine, and how it is read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LocalScene {
    /// glTF file or packed scene.
    pub file: PathBuf,
    pub options: LoadOptions,
}

impl LocalScene {
    #[must_use]
    pub fn new(file: PathBuf) -> Self {
        Self { file, options: LoadOptions::default() }
    }

    /// Returns what makes `gnomon-server` serve it.
    #[must_use]
    pub fn server_arguments(&self) -> Vec<OsString> {
        let LoadOptions { lights_from, max_lights, default_light, scene, animation, variant, editable } = &self.options;
        let mut arguments: Vec<OsString> = vec!["--scene".into(), self.file.clone().into()];
        // In one word: a name may begin with a dash.
        let mut add = |flag: &str, value: Option<&OsStr>| {
            if let Some(value) = value {
                let mut argument = OsString::from(flag);
                argument.push("=");
                argument.push(value);
                arguments.push(argument);
            }
        };
        add("--lights-from", lights_from.as_deref().map(Path::as_os_str));
        add("--lights", max_lights.map(|lights| lights.to_string()).as_deref().map(OsStr::new));
        add("--default-light", (!default_light).then_some(OsStr::new("off")));
        add("--scene-name", scene.as_deref().map(OsStr::new));
        add("--animation", animation.as_deref().map(OsStr::new));
        add("--variant", variant.as_deref().map(OsStr::new));
        add("--editable", (!editable.is_empty()).then(|| editable.join(",")).as_deref().map(OsStr::new));
        arguments
    }
}

/// Creates a folder that is removed when dropped. Its name cannot be guessed, and only this user can read it, because
/// it holds the server's key.
///
/// # Errors
/// Errors if the system's temporary folder cannot be written.
pub fn temporary_folder(purpose: &str) -> Result<TempDir, LocalServerError> {
    let created = tempfile::Builder::new().prefix(&format!("gnomon-{purpose}-")).tempdir();
    created.map_err(|source| LocalServerError::Start { folder: std::env::temp_dir(), source })
}

/// A running server. Dropping it stops it.
#[derive(Debug)]
pub struct LocalServer {
    url: ServerUrl,
    _process: ServerProcess,
    /// Removed after the server has stopped.
    _folder: TempDir,
}

/// The thread that started the server. It must outlive the child: the system ends a child with its thread
/// ([`command`]).
#[derive(Debug)]
struct ServerProcess {
    /// Dropping it stops the server.
    stop: Option<SyncSender<Infallible>>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for ServerProcess {
    fn drop(&mut self) {
        self.stop = None;
        self.thread.take().map(JoinHandle::join);
    }
}

impl LocalServer {
    /// Returns the path of the server program beside this one.
    ///
    /// # Errors
    /// Errors if there is none.
    pub fn program() -> Result<PathBuf, LocalServerError> {
        let own = std::env::current_exe().unwrap_or_default();
        let program = own.with_file_name("gnomon-server").with_extension(std::env::consts::EXE_EXTENSION);
        if program.is_file() { Ok(program) } else { Err(LocalServerError::Missing(program)) }
    }

    /// Starts a server with its files in `folder`, and waits until it listens.
    ///
    /// # Errors
    /// Errors with the last line of its log if it does not start.
    pub fn start(folder: TempDir, scene: &LocalScene) -> Result<Self, LocalServerError> {
        let program = Self::program()?;
        let failed = |source| LocalServerError::Start { folder: folder.path().to_owned(), source };
        let log = folder.path().join("server.log");
        let errors = fs::File::create(&log).map_err(failed)?;
        let mut command = command(&program);
        command
            .args(["--listen", "127.0.0.1:0"])
            .args(scene.server_arguments())
            .arg("--cert-dir")
            .arg(folder.path().join("certificate"))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(errors);
        let ((send_line, first_line), (stop, stopped)) = (sync_channel(1), sync_channel(0));
        let thread = std::thread::Builder::new().name("local server".to_owned());
        let thread = thread.spawn(move || run(&mut command, send_line, &stopped)).map_err(failed)?;
        // From here on, every return stops the server.
        let process = ServerProcess { stop: Some(stop), thread: Some(thread) };
        let line = match first_line.recv_timeout(START_TIMEOUT) {
            Ok(Err(error)) => return Err(failed(error)),
            Ok(Ok(line)) => line,
            Err(_) => String::new(),
        };
        match line.split_whitespace().find_map(|word| word.parse().ok()) {
            Some(url) => Ok(Self { url, _process: process, _folder: folder }),
            None => {
                drop(process);
                let log = fs::read_to_string(&log).unwrap_or_default();
                Err(LocalServerError::NotListening(log.lines().last().unwrap_or("it printed nothing").to_owned()))
            }
        }
    }

    #[must_use]
    pub fn url(&self) -> &ServerUrl {
        &self.url
    }
}

/// Returns a command that runs `program` and, on Linux, ends it when this process ends for any reason.
fn command(program: &Path) -> Command {
    let setpriv = Path::new("/usr/bin/setpriv");
    if cfg!(target_os = "linux") && setpriv.is_file() {
        let mut command = Command::new(setpriv);
        command.args(["--pdeathsig", "TERM"]).arg(program);
        return command;
    }
    Command::new(program)
}

/// Runs the server until `stopped` disconnects. Sends the first line that it prints, or why it did not start.
fn run(command: &mut Command, send_line: SyncSender<std::io::Result<String>>, stopped: &Receiver<Infallible>) {
    let mut child = match command.spawn() {
        Ok(child) => child,
        Err(error) => {
            let _ = send_line.send(Err(error));
            return;
        }
    };
    if let Some(output) = child.stdout.take() {
        // Reading ends when the server does.
        std::thread::spawn(move || {
            let mut line = String::new();
            let _ = send_line.send(BufReader::new(output).read_line(&mut line).map(|_| line));
        });
    }
    let _ = stopped.recv();
    stop(&mut child);
}

/// Asks the server to stop, where the system allows that. Kills it otherwise or after [`STOP_TIMEOUT`].
fn stop(server: &mut Child) {
    let asked = cfg!(unix)
        && Command::new("kill")
            .args(["-TERM", &server.id().to_string()])
            .stderr(Stdio::null())
            .status()
            .is_ok_and(|status| status.success());
    let deadline = Instant::now() + STOP_TIMEOUT;
    while asked && Instant::now() < deadline {
        if matches!(server.try_wait(), Ok(Some(_)) | Err(_)) {
            return;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let _ = server.kill();
    let _ = server.wait();
}
