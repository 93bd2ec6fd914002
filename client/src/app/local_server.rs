//! The server that lies beside this program, as a child on loopback: for the demo, and as the reference of a split picture.

use std::{
    convert::Infallible,
    ffi::OsString,
    fs,
    io::{BufRead as _, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::mpsc::{Receiver, SyncSender, sync_channel},
    thread::JoinHandle,
    time::{Duration, Instant},
};

use tempfile::TempDir;
use thiserror::Error;

use crate::link::url::ServerUrl;

/// How long the server may take until it listens: it builds its hierarchies first.
const PATIENCE: Duration = Duration::from_secs(120);

/// How long it may take to stop before it is ended.
const FAREWELL: Duration = Duration::from_secs(5);

/// Why there is no local server.
#[derive(Debug, Error)]
pub enum LocalServerError {
    /// There is none to start.
    #[error("there is no {}: build it with cargo build -p gnomon-server", .0.display())]
    Missing(PathBuf),
    /// It cannot be started, or its folder cannot be made.
    #[error("cannot start it in {}: {source}", folder.display())]
    Start {
        /// Its folder.
        folder: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// The scene that it should trace is not on this machine.
    #[error("the scene is not kept: {} cannot be written", .0.display())]
    NotKept(PathBuf),
    /// It ended, or said nothing, before it listened.
    #[error("it does not start: {0}")]
    Silent(String),
}

/// What it traces.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LocalScene {
    /// The glTF file or packed scene.
    pub file: PathBuf,
    /// File whose lights replace the scene's.
    pub lights_from: Option<PathBuf>,
    /// Keep the first lights only.
    pub lights: Option<u32>,
}

/// A folder in the system's temporary folder, with a name that nobody can guess and for this user only: the server's key lies in it.
/// Dropping it takes it away.
#[derive(Debug)]
pub struct Folder(TempDir);

impl Folder {
    /// Makes it. `purpose` is part of its name.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn make(purpose: &str) -> Result<Self, LocalServerError> {
        let made = tempfile::Builder::new().prefix(&format!("gnomon-{purpose}-")).tempdir();
        made.map(Self).map_err(|source| LocalServerError::Start { folder: std::env::temp_dir(), source })
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.0.path()
    }
}

/// A running server. Dropping it stops it.
#[derive(Debug)]
pub struct LocalServer {
    url: ServerUrl,
    _keeper: Keeper,
    /// Its files, which go after it.
    _folder: Folder,
}

/// The thread whose child the server is: the system ends a child with the thread that started it ([`command`]).
#[derive(Debug)]
struct Keeper {
    /// Dropping it stops the server.
    stop: Option<SyncSender<Infallible>>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Keeper {
    fn drop(&mut self) {
        self.stop = None;
        self.thread.take().map(JoinHandle::join);
    }
}

impl LocalServer {
    /// The server's program, beside this one, if it is there.
    ///
    /// # Errors
    /// When it is not.
    pub fn program() -> Result<PathBuf, LocalServerError> {
        let own = std::env::current_exe().unwrap_or_default();
        let program = own.with_file_name("gnomon-server").with_extension(std::env::consts::EXE_EXTENSION);
        if program.is_file() { Ok(program) } else { Err(LocalServerError::Missing(program)) }
    }

    /// Starts it with its files in `folder`, and waits until it listens.
    ///
    /// # Errors
    /// When there is no server, or it does not start; its last words are in the error.
    pub fn start(folder: Folder, scene: &LocalScene) -> Result<Self, LocalServerError> {
        let program = Self::program()?;
        let failed = |source| LocalServerError::Start { folder: folder.path().to_owned(), source };
        let log = folder.path().join("server.log");
        let errors = fs::File::create(&log).map_err(failed)?;
        let mut arguments: Vec<OsString> = vec!["--scene".into(), scene.file.clone().into()];
        if let Some(file) = &scene.lights_from {
            arguments.extend(["--lights-from".into(), file.into()]);
        }
        if let Some(lights) = scene.lights {
            arguments.extend(["--lights".into(), lights.to_string().into()]);
        }
        let mut command = command(&program);
        command
            .args(["--listen", "127.0.0.1:0"])
            .args(arguments)
            .arg("--cert-dir")
            .arg(folder.path().join("certificate"))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(errors);
        let ((say, said), (stop, stopped)) = (sync_channel(1), sync_channel(0));
        let keeper = std::thread::Builder::new().name("local server".to_owned());
        let keeper = keeper.spawn(move || keep(&mut command, say, &stopped)).map_err(failed)?;
        // From here on it is stopped however this ends.
        let keeper = Keeper { stop: Some(stop), thread: Some(keeper) };
        let line = match said.recv_timeout(PATIENCE) {
            Ok(Err(error)) => return Err(failed(error)),
            Ok(Ok(line)) => line,
            Err(_) => String::new(),
        };
        match line.split_whitespace().find_map(|word| word.parse().ok()) {
            Some(url) => Ok(Self { url, _keeper: keeper, _folder: folder }),
            None => {
                drop(keeper);
                let log = fs::read_to_string(&log).unwrap_or_default();
                Err(LocalServerError::Silent(log.lines().last().unwrap_or("it says nothing").to_owned()))
            }
        }
    }

    /// Where it listens.
    #[must_use]
    pub fn url(&self) -> &ServerUrl {
        &self.url
    }
}

/// The command that runs `program` and, where the system has a way, ends it with us however we end.
fn command(program: &Path) -> Command {
    let setpriv = Path::new("/usr/bin/setpriv");
    if cfg!(target_os = "linux") && setpriv.is_file() {
        let mut command = Command::new(setpriv);
        command.args(["--pdeathsig", "TERM"]).arg(program);
        return command;
    }
    Command::new(program)
}

/// Starts the server, says its first line, or why there is none, and stops it when `stopped` ends.
fn keep(command: &mut Command, say: SyncSender<std::io::Result<String>>, stopped: &Receiver<Infallible>) {
    let mut child = match command.spawn() {
        Ok(child) => child,
        Err(error) => {
            let _ = say.send(Err(error));
            return;
        }
    };
    if let Some(output) = child.stdout.take() {
        // Reading ends with the server.
        std::thread::spawn(move || {
            let mut line = String::new();
            let _ = say.send(BufReader::new(output).read_line(&mut line).map(|_| line));
        });
    }
    let _ = stopped.recv();
    stop(&mut child);
}

/// Asks the server to stop, where the system has a way to ask, and ends it when it does not.
fn stop(server: &mut Child) {
    let asked = cfg!(unix)
        && Command::new("kill")
            .args(["-TERM", &server.id().to_string()])
            .stderr(Stdio::null())
            .status()
            .is_ok_and(|status| status.success());
    let deadline = Instant::now() + FAREWELL;
    while asked && Instant::now() < deadline {
        if matches!(server.try_wait(), Ok(Some(_)) | Err(_)) {
            return;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let _ = server.kill();
    let _ = server.wait();
}
