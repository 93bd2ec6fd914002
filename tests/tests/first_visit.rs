//! Promise: a window asks a person before a token goes to a server that it does not know.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod display;

use std::{
    fs,
    path::Path,
    time::{Duration, Instant},
};

use display::Display;
use gnomon_lab::rig::{
    PATIENCE, ServerProcess,
    program::{Program, find},
};
use gnomon_server::tokens::{self, Scope};

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn a_window_asks_before_the_token_goes() {
    let (display, folder) = (Display::start(), tempfile::tempdir().unwrap());
    let scene = gnomon_scene::testing::write_scene(folder.path()).unwrap();
    let (ours, entry) = tokens::make("ours", None, &[Scope::Session], false).unwrap();
    let [token, list, state] = ["token", "tokens.toml", "state"].map(|name| folder.path().join(name));
    fs::write(&list, entry).unwrap();
    fs::write(&token, ours).unwrap();
    let server = ServerProcess::start(&scene, &["--backend", "cpu", "--token-file", text(&list)]).unwrap();
    let (address, sha256) = server.url().split_once("/?cert=").unwrap();
    let first_use = format!("{address}/?cert=first-use");
    let pins = state.join("gnomon/servers.json");
    let open = || {
        let arguments =
            [&first_use, "--size", "320x180", "--allow-software", "--exit-after", "300", "--token-file", text(&token)];
        let environment = [
            ("DISPLAY", display.name.as_str()),
            ("WAYLAND_DISPLAY", ""),
            ("XDG_STATE_HOME", text(&state)),
            ("RUST_LOG", "gnomon_client=info"),
        ];
        let client = Program::start(&find("gnomon-client").unwrap(), &arguments, &environment).unwrap();
        let id = display.person("search --sync --name Gnomon");
        display.focus(id.lines().next().unwrap());
        client
    };
    // A key does nothing before the question is on the screen.
    let press = |client: &Program, key: &str, until: &str| {
        let begun = Instant::now();
        while !client.said().unwrap()[1].contains(until) {
            display.person(&format!("key {key}"));
            assert!(begun.elapsed() < PATIENCE, "{key}: {:?}", client.said());
            std::thread::sleep(Duration::from_millis(100));
        }
    };

    let client = open();
    press(&client, "n", "no picture");
    assert!(!client.said().unwrap()[1].contains("admitted") && !pins.exists());
    display.person("key Escape");
    let refused = client.finish(PATIENCE).unwrap();
    assert!(!refused.status.success() && refused.stderr.contains("first visit"), "{}", refused.stderr);

    let client = open();
    press(&client, "y", "admitted");
    assert!(fs::read_to_string(&pins).unwrap().contains(sha256));
    display.person("key Escape");
    client.finish(PATIENCE).unwrap().success().unwrap();
    server.stop().unwrap();
}
