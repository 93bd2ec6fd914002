//! Promise: a person in a window picks a thing, drags it, takes that back and does it again, if the server lets them;
//! the view stays where it is meanwhile. Otherwise the same drag looks around.
//!
//! The window runs under Xvfb, and xdotool acts as the person (`deploy/setup tests`).
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod display;

use std::{fs, path::Path, time::Instant};

use display::Display;
use gnomon_lab::rig::{
    PATIENCE, ServerProcess,
    program::{Program, find},
};
use gnomon_scene::testing::write_living_scene;
use gnomon_server::tokens::{self, Scope};
use image::RgbImage;

const SIZE: &str = "640x360";

/// The middle of the picture, where the square is.
const MIDDLE: &str = "320 180";

/// Where it is dragged.
const THERE: &str = "250 165";

struct Window<'a> {
    display: &'a Display,
    client: Program,
    id: String,
    folder: &'a Path,
    kept: u32,
}

impl<'a> Window<'a> {
    fn open(display: &'a Display, folder: &'a Path, arguments: &[&str]) -> Self {
        let out = folder.to_str().unwrap();
        let own = ["--size", SIZE, "--out", out, "--allow-software", "--exposure", "1", "--exit-after", "300"];
        let environment = [("DISPLAY", display.name.as_str()), ("WAYLAND_DISPLAY", "")];
        let client =
            Program::start(&find("gnomon-client").unwrap(), &[&own, arguments].concat(), &environment).unwrap();
        let id = display.person("search --sync --name Gnomon").lines().next().unwrap().to_owned();
        display.focus(&id);
        Self { display, client, id, folder, kept: 0 }
    }

    fn person(&self, does: &str) {
        self.display.person(does);
    }

    /// Moves the pointer to a place in the window, and does something there.
    fn point(&self, place: &str, does: &str) {
        self.person(&format!("mousemove --window {} {place} {does}", self.id));
    }

    /// Presses P until a picture is `wanted`, and returns it.
    fn picture_that(&mut self, what: &str, wanted: impl Fn(&RgbImage) -> bool) -> RgbImage {
        let begun = Instant::now();
        let mut pressed: Option<Instant> = None;
        loop {
            if pressed.is_none_or(|pressed| pressed.elapsed().as_secs() >= 3) {
                self.person("key p");
                pressed = Some(Instant::now());
            }
            // A partly written picture does not open.
            if let Ok(picture) = image::open(self.folder.join(format!("gnomon_{:05}.png", self.kept + 1))) {
                (self.kept, pressed) = (self.kept + 1, None);
                let picture = picture.to_rgb8();
                if wanted(&picture) {
                    return picture;
                }
            }
            assert!(
                self.client.is_running().unwrap() && begun.elapsed() < PATIENCE,
                "{what}: {:?}",
                self.client.said()
            );
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
    }

    /// Waits until the picture stops changing: masks have arrived and fades have ended.
    fn still_picture(&mut self) -> RgbImage {
        let last = std::cell::RefCell::new(RgbImage::default());
        self.picture_that("stands still", |picture| *picture == last.replace(picture.clone()))
    }
}

/// The picture's right edge, far from all that is moved.
fn edge(picture: &RgbImage) -> Vec<u8> {
    let edge = picture.enumerate_pixels().filter(|(x, ..)| *x >= 600);
    edge.flat_map(|(.., pixel)| pixel.0).collect()
}

#[test]
fn a_person_edits_by_hand_where_the_server_lets_them() {
    let (display, folder) = (Display::start(), tempfile::tempdir().unwrap());
    let scene = write_living_scene(folder.path()).unwrap();
    let path = folder.path().join("path.json");
    let text = r#"{"camera_path": {"keyframes": [{"t": 0, "pos": [-1.5, 2.8, 3], "target": [-1.5, 0.8, 0]}]}}"#;
    fs::write(&path, text).unwrap();
    let make = |scopes: &[Scope]| tokens::make("", None, scopes, false).unwrap();
    let (watching, editing) = (make(&[Scope::Session]), make(&[Scope::Session, Scope::Edit]));
    let list = folder.path().join("tokens.toml");
    fs::write(&list, format!("{}\n{}", watching.1, editing.1)).unwrap();
    let options = ["--backend", "cpu", "--editable", "1", "--token-file", list.to_str().unwrap()];
    let server = ServerProcess::start(&scene, &options).unwrap();
    for (token, may_edit) in [(editing.0, true), (watching.0, false)] {
        let pictures = tempfile::tempdir().unwrap();
        let arguments = [server.url(), "--path", path.to_str().unwrap(), "--token", token.as_str()];
        let mut window = Window::open(&display, pictures.path(), &arguments);
        let first = window.still_picture();
        // Keys count with the next picture, and handles are there with the next one.
        window.person("key i");
        window.still_picture();
        window.point(MIDDLE, "click 1");
        assert!(window.still_picture() == first, "a click changes the picture");
        window.point(MIDDLE, "mousedown 1");
        window.point(THERE, "mouseup 1");
        window.picture_that("has changed", |picture| *picture != first);
        let dragged = window.still_picture();
        assert_eq!(edge(&dragged) == edge(&first), may_edit, "does the view stay?");
        window.person("key ctrl+z");
        let expected = if may_edit { &first } else { &dragged };
        window.picture_that("is as before", |picture| picture == expected);
        window.person("key ctrl+y");
        window.picture_that("is dragged again", |picture| *picture == dragged);
        // The first Esc ends editing.
        (0..=u32::from(may_edit)).for_each(|_| window.person("key Escape"));
        window.client.finish(PATIENCE).unwrap().success().unwrap();
    }
}
