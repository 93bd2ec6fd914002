//! A display for windows under test: Xvfb, with xdotool as the person (`deploy/setup tests`).

use std::{
    io::{BufRead as _, BufReader},
    process::{Child, Command, Stdio},
};

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
        let output = Command::new("xdotool").args(does.split(' ')).env("DISPLAY", &self.name).output();
        let output = output.expect("the window's person is xdotool: run deploy/setup");
        assert!(output.status.success(), "xdotool {does}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8_lossy(&output.stdout).trim().to_owned()
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}
