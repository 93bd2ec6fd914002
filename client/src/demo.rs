//! `--demo`: the server that lies beside this program, as a child on loopback, with the scene that this program carries.

use std::{
    fs,
    io::{BufRead as _, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::mpsc::sync_channel,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, anyhow, bail};

const SCENE: &[u8] = include_bytes!("../../tests/assets/cloister.glb");
const PATHS: &[u8] = include_bytes!("../../tests/assets/cloister.json");

/// How long the server may take until it listens: it builds its hierarchies first.
const PATIENCE: Duration = Duration::from_secs(120);

/// How long it may take to stop before it is ended.
const FAREWELL: Duration = Duration::from_secs(5);

/// A running server. Dropping it stops it, and takes its files away.
pub(crate) struct Demo {
    server: Child,
    folder: PathBuf,
    url: String,
}

impl Demo {
    /// Starts the server and waits until it listens.
    pub(crate) fn start() -> Result<Self> {
        let own = std::env::current_exe().context("--demo: this program has no path")?;
        let program = own.with_file_name("gnomon-server").with_extension(std::env::consts::EXE_EXTENSION);
        if !program.is_file() {
            bail!("--demo: there is no {}: build it with cargo build -p gnomon-server", program.display());
        }
        let folder = std::env::temp_dir().join(format!("gnomon-demo-{}", std::process::id()));
        fs::create_dir_all(&folder).with_context(|| format!("--demo: making {}", folder.display()))?;
        let (scene, log) = (folder.join("cloister.glb"), folder.join("server.log"));
        let write = |file: &Path, bytes| fs::write(file, bytes).with_context(|| format!("writing {}", file.display()));
        write(&scene, SCENE)?;
        write(&folder.join("cloister.json"), PATHS)?;
        let errors = fs::File::create(&log).with_context(|| format!("--demo: making {}", log.display()))?;
        let mut server = command(&program)
            .args(["--listen", "127.0.0.1:0", "--scene"])
            .arg(&scene)
            .arg("--cert-dir")
            .arg(folder.join("certificate"))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(errors)
            .spawn()
            .with_context(|| format!("--demo: starting {}", program.display()))?;
        let output = server.stdout.take();
        let mut demo = Self { server, folder, url: String::new() };
        let (send, said) = sync_channel(1);
        std::thread::spawn(move || {
            let mut line = String::new();
            let read = output.map(|output| BufReader::new(output).read_line(&mut line));
            let _ = send.send(read.and_then(Result::ok).map(|_| line));
        });
        let line = said.recv_timeout(PATIENCE).ok().flatten().unwrap_or_default();
        demo.url = line.split_whitespace().find(|word| word.starts_with("gnomon")).unwrap_or_default().to_owned();
        if demo.url.is_empty() {
            let log = fs::read_to_string(&log).unwrap_or_default();
            return Err(anyhow!(
                "--demo: the server does not start: {}",
                log.lines().last().unwrap_or("it says nothing")
            ));
        }
        Ok(demo)
    }

    /// Where it listens.
    pub(crate) fn url(&self) -> &str {
        &self.url
    }

    /// A camera path through the scene.
    pub(crate) fn path(&self) -> String {
        format!("{}#walk", self.folder.join("cloister.json").display())
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

impl Drop for Demo {
    fn drop(&mut self) {
        stop(&mut self.server);
        // What is left of it is in the system's temporary folder.
        let _ = fs::remove_dir_all(&self.folder);
    }
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
