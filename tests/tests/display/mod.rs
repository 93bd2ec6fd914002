//! A display for windows under test: Xvfb, with xdotool as the person (`deploy/setup tests`).

use std::{
    io::{BufRead as _, BufReader},
    process::{Child, Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use gnomon_lab::rig::PATIENCE;

/// A display. Dropping it closes it.
pub(crate) struct Display {
    server: Child,
    pub(crate) name: String,
}

impl Display {
    pub(crate) fn start() -> Self {
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "800x600x24", "-nolisten", "tcp"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("the window is tested under Xvfb: run deploy/setup, which installs xvfb and xdotool");
        let mut line = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let name = format!(":{}", line.trim().parse::<u32>().expect("Xvfb names no display"));
        Self { server, name }
    }

    /// Runs an xdotool command at this display and returns its output.
    pub(crate) fn person(&self, does: &str) -> String {
        self.attempt(does).unwrap_or_else(|error| panic!("xdotool {does}: {error}"))
    }

    /// Gives a window the keyboard. X refuses that until the window manager has shown it.
    pub(crate) fn focus(&self, window: &str) {
        let deadline = Instant::now() + PATIENCE;
        while let Err(error) = self.attempt(&format!("windowfocus {window}")) {
            assert!(Instant::now() < deadline, "window {window} cannot be focused: {error}");
            sleep(Duration::from_millis(50));
        }
    }

    fn attempt(&self, does: &str) -> Result<String, String> {
        let output = Command::new("xdotool").args(does.split(' ')).env("DISPLAY", &self.name).output();
        let output = output.expect("the window's person is xdotool: run deploy/setup");
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).trim().to_owned();
        if output.status.success() { Ok(text(&output.stdout)) } else { Err(text(&output.stderr)) }
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}
