//! Writes log lines on its own thread, so that a full or slow disk, or a stalled reader, blocks no other thread.
//!
//! Lines that cannot be written are dropped and counted. The count is logged once writing works again.

use std::{
    io::{self, Write},
    path::{Path, PathBuf},
    sync::{
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use tracing_subscriber::fmt::MakeWriter;

use super::{
    escape::{self, Form},
    file::append,
    site_limit::{REPORT_EVERY, SiteLimit},
};
use crate::{limits::MAX_WAITING_LOG_LINES, metrics::reloads::Outcome};

/// Time limit for writing the last lines at exit.
const FLUSH_TIMEOUT: Duration = Duration::from_secs(2);

/// How long a line waits for a FIFO or a terminal whose reader is slow.
const WRITE_PATIENCE: Duration = Duration::from_secs(1);

/// How often such a line is tried again.
const WRITE_PAUSE: Duration = Duration::from_millis(2);

/// Static, since a process has one log.
static LOST: AtomicU64 = AtomicU64::new(0);

/// How the log file was opened last. Static for the same reason.
static OPENED: Outcome = Outcome::new();

/// The log file is to be reopened, and the queue had no room to say so.
static REOPEN: AtomicBool = AtomicBool::new(false);

/// Lines dropped since the start.
pub(crate) fn lines_lost() -> u64 {
    LOST.load(Ordering::Relaxed)
}

/// Whether the log file could be reopened at the last SIGHUP. Never loaded if the log is standard error.
pub(crate) const fn opened() -> &'static Outcome {
    &OPENED
}

enum Command {
    Write(Vec<u8>),
    Reopen,
    End(SyncSender<()>),
}

/// The writing thread. Dropping this flushes the queue, for up to 2 s.
pub struct Logs {
    commands: SyncSender<Command>,
    // Never joined, because it may hang in a write. It ends when the last sender is dropped.
    _thread: JoinHandle<()>,
}

#[derive(Clone)]
pub(super) struct Lines(SyncSender<Command>);

/// One line. Dropping it sends it to the thread.
pub(super) struct Line {
    text: Vec<u8>,
    commands: SyncSender<Command>,
}

impl Logs {
    pub(super) fn open(file: Option<&Path>, form: Form, limit: &'static SiteLimit) -> io::Result<(Self, Lines)> {
        let target = Target::open(file, form)?;
        let (commands, waiting) = sync_channel(MAX_WAITING_LOG_LINES);
        let thread = std::thread::Builder::new()
            .name("gnomon-logs".to_owned())
            .spawn(move || write_all(target, &waiting, limit))?;
        Ok((Self { commands: commands.clone(), _thread: thread }, Lines(commands)))
    }

    /// Reopens the log file after log rotation. Does nothing for standard error.
    pub fn reopen(&self) {
        if self.commands.try_send(Command::Reopen).is_err() {
            REOPEN.store(true, Ordering::Release);
        }
    }
}

impl Drop for Logs {
    fn drop(&mut self) {
        let (done, wait) = sync_channel(1);
        if self.commands.try_send(Command::End(done)).is_ok() {
            let _ = wait.recv_timeout(FLUSH_TIMEOUT);
        }
    }
}

impl<'a> MakeWriter<'a> for Lines {
    type Writer = Line;

    fn make_writer(&'a self) -> Line {
        Line { text: Vec::with_capacity(512), commands: self.0.clone() }
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.text.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        if !self.text.is_empty() && self.commands.try_send(Command::Write(std::mem::take(&mut self.text))).is_err() {
            LOST.fetch_add(1, Ordering::Relaxed);
        }
    }
}

fn write_all(mut target: Target, commands: &Receiver<Command>, limit: &SiteLimit) {
    let mut reported_at = Instant::now();
    loop {
        let command = commands.recv_timeout(REPORT_EVERY.saturating_sub(reported_at.elapsed()));
        if REOPEN.swap(false, Ordering::AcqRel) {
            target.reopen();
        }
        if reported_at.elapsed() >= REPORT_EVERY {
            reported_at = Instant::now();
            limit.report();
        }
        match command {
            Ok(Command::Write(line)) => target.write_line(&line),
            Ok(Command::Reopen) => target.reopen(),
            Err(RecvTimeoutError::Timeout) => {}
            Ok(Command::End(done)) => {
                limit.report();
                while let Ok(Command::Write(line)) = commands.try_recv() {
                    target.write_line(&line);
                }
                // The receiver may have timed out.
                let _ = done.try_send(());
            }
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

struct Target {
    out: Box<dyn Write + Send>,
    path: Option<PathBuf>,
    form: Form,
    /// True if the last line was cut off, so the next one starts with a line feed.
    torn: bool,
    lost_before: u64,
}

impl Target {
    fn open(file: Option<&Path>, form: Form) -> io::Result<Self> {
        let out: Box<dyn Write + Send> = match file {
            Some(path) => {
                let file = append(path)?;
                OPENED.succeeded();
                Box::new(file)
            }
            None => Box::new(io::stderr()),
        };
        Ok(Self { out, path: file.map(Path::to_owned), form, torn: false, lost_before: 0 })
    }

    fn reopen(&mut self) {
        let Some(path) = &self.path else { return };
        match append(path) {
            Ok(file) => {
                (self.out, self.torn) = (Box::new(file), false);
                OPENED.succeeded();
            }
            // Keep writing to the old file.
            Err(error) => {
                OPENED.failed();
                tracing::error!(%error, path = %path.display(), "cannot reopen the log file");
            }
        }
    }

    fn write_line(&mut self, line: &[u8]) {
        let mut text = Vec::new();
        if self.torn {
            text.push(b'\n');
        }
        text.extend_from_slice(escape::line(&String::from_utf8_lossy(line), self.form).as_bytes());
        let mut rest = text.as_slice();
        let began_at = Instant::now();
        while !rest.is_empty() {
            match self.out.write(rest) {
                Ok(0) => break,
                Ok(written) => rest = &rest[written..],
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                // Files are opened without blocking, so that this thread always comes back.
                Err(error) if error.kind() == io::ErrorKind::WouldBlock && began_at.elapsed() < WRITE_PATIENCE => {
                    std::thread::sleep(WRITE_PAUSE);
                }
                Err(_) => break,
            }
        }
        if rest.is_empty() {
            self.torn = false;
            let lost = lines_lost();
            if lost > self.lost_before {
                tracing::warn!(lines = lost - self.lost_before, "log lines were lost");
                self.lost_before = lost;
            }
        } else {
            self.torn |= rest.len() < text.len();
            LOST.fetch_add(1, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Content, and bytes until it is full.
    #[derive(Clone, Default)]
    struct Disk(std::sync::Arc<std::sync::Mutex<(Vec<u8>, usize)>>);

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let (content, room) = &mut *self.0.lock().unwrap();
            let taken = bytes.len().min(*room);
            if taken == 0 {
                return Err(io::ErrorKind::StorageFull.into());
            }
            content.extend_from_slice(&bytes[..taken]);
            *room -= taken;
            Ok(taken)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_full_disk_drops_lines_and_never_joins_two() {
        let disk = Disk::default();
        disk.0.lock().unwrap().1 = 10;
        let mut target =
            Target { out: Box::new(disk.clone()), path: None, form: Form::Text, torn: false, lost_before: 0 };
        let before = lines_lost();
        target.write_line(b"first\n");
        target.write_line(b"second\n");
        target.write_line(b"third\n");
        assert_eq!(lines_lost() - before, 2);
        disk.0.lock().unwrap().1 = 100;
        target.write_line(b"fourth\n");
        assert_eq!(disk.0.lock().unwrap().0, b"first\nseco\nfourth\n");
    }

    #[test]
    fn a_rotated_file_is_left_alone_after_reopening() {
        let folder = tempfile::tempdir().unwrap();
        let (path, old) = (folder.path().join("log"), folder.path().join("log.1"));
        let (logs, lines) = Logs::open(Some(&path), Form::Text, Box::leak(Box::default())).unwrap();
        let write = |text: &str| lines.make_writer().write_all(text.as_bytes()).unwrap();
        write("one\n");
        // A rename does not affect the open file, even if the thread has not written yet.
        std::fs::rename(&path, &old).unwrap();
        write("two\n");
        logs.reopen();
        write("three\n");
        drop(logs);
        assert_eq!(std::fs::read_to_string(&old).unwrap(), "one\ntwo\n");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "three\n");
    }
}
