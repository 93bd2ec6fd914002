//! Promise: a person can use the client in a window: walk, look, resize, choose, save a picture, and lose the server.
//! The window shows what a headless run writes.
//!
//! The window runs under Xvfb, xdotool acts as the person, and openbox manages windows if needed (`deploy/setup
//! tests`).
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod display;

use std::{
    fs,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use display::Display;
use gnomon_lab::{
    cloister::asset,
    link::{self, LinkSettings},
    report::{
        replay::{self, ReplayOptions},
        scene_args::parse,
    },
    rig::{
        ClientJob, PATIENCE, ServerProcess,
        program::{Program, find},
    },
};
use image::RgbImage;

const SIZE: (u32, u32) = (320, 180);

fn replay_options(recording: &Path, out: &Path) -> ReplayOptions {
    let scene = asset("cloister.glb");
    parse(&format!("{} --scene {} --out {}", recording.display(), scene.display(), out.display())).unwrap()
}

struct Window<'a> {
    display: &'a Display,
    client: Program,
    id: String,
    folder: &'a Path,
    kept: u32,
}

impl<'a> Window<'a> {
    fn open(display: &'a Display, folder: &'a Path, arguments: &[&str]) -> Self {
        let size = format!("{}x{}", SIZE.0, SIZE.1);
        let pictures = folder.to_str().unwrap();
        let mut all =
            vec!["--size", &size, "--out", pictures, "--allow-software", "--vsync=false", "--exit-after", "300"];
        all.extend(arguments);
        let environment = [("DISPLAY", display.name.as_str()), ("WAYLAND_DISPLAY", ""), ("TMPDIR", pictures)];
        let mut client = Program::start(&find("gnomon-client").unwrap(), &all, &environment).unwrap();
        let id = display.person("search --sync --name Gnomon");
        let id = id.lines().next().unwrap().to_owned();
        display.focus(&id);
        assert!(client.is_running().unwrap());
        Self { display, client, id, folder, kept: 0 }
    }

    fn person(&self, does: &str) {
        self.display.person(does);
    }

    /// Presses P and waits for the picture. P is repeated, since it does nothing before there is a scene.
    fn picture(&mut self) -> RgbImage {
        self.kept += 1;
        let file = self.folder.join(format!("gnomon_{:05}.png", self.kept));
        let begun = Instant::now();
        loop {
            self.person("key p");
            let pressed = Instant::now();
            while pressed.elapsed() < Duration::from_secs(3) {
                // A partly written picture does not open.
                if let Ok(picture) = image::open(&file) {
                    return picture.to_rgb8();
                }
                assert!(self.client.is_running().unwrap(), "{:?}", self.client.said());
                std::thread::sleep(Duration::from_millis(20));
            }
            assert!(begun.elapsed() < PATIENCE, "no picture: {:?}", self.client.said());
            // A repeated press may have saved a second picture.
            self.kept += u32::from(self.folder.join(format!("gnomon_{:05}.png", self.kept + 1)).exists());
        }
    }

    /// Saves pictures until one is `wanted`.
    fn picture_that(&mut self, what: &str, wanted: impl Fn(&RgbImage) -> bool) -> RgbImage {
        let begun = Instant::now();
        loop {
            let picture = self.picture();
            if wanted(&picture) {
                return picture;
            }
            assert!(begun.elapsed() < Duration::from_secs(60), "no picture that {what}: {:?}", self.client.said());
        }
    }

    /// Waits until the picture stops changing: masks have arrived and fades have ended.
    fn still_picture(&mut self) -> RgbImage {
        let mut before = self.picture();
        for _ in 0..100 {
            std::thread::sleep(Duration::from_millis(150));
            let picture = self.picture();
            if picture == before {
                return picture;
            }
            before = picture;
        }
        panic!("it never stands still");
    }

    /// Waits until the last line of the statistics is `wanted`, and returns its frame's number.
    fn last_frame(&mut self, stats: &Path, wanted: impl Fn(&serde_json::Value) -> bool) -> u64 {
        let begun = Instant::now();
        loop {
            let text = fs::read_to_string(stats).unwrap();
            let line: serde_json::Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
            if wanted(&line) {
                return line["frame"].as_u64().unwrap();
            }
            assert!(
                begun.elapsed() < PATIENCE && self.client.is_running().unwrap(),
                "{line}: {:?}",
                self.client.said()
            );
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// Holds a key until the picture is `wanted`, and waits until it stops changing.
    fn hold(&mut self, key: &str, wanted: impl Fn(&RgbImage) -> bool) -> RgbImage {
        self.person(&format!("keydown {key}"));
        self.picture_that(&format!("{key} leads to"), wanted);
        self.person(&format!("keyup {key}"));
        self.still_picture()
    }

    fn leave(self) {
        self.person("key Escape");
        self.client.finish(PATIENCE).unwrap().success().unwrap();
    }
}

/// Returns the mean difference of bytes.
fn difference(one: &RgbImage, other: &RgbImage) -> f64 {
    assert_eq!(one.dimensions(), other.dimensions());
    let sum: u64 = one.as_raw().iter().zip(other.as_raw()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / one.as_raw().len() as f64
}

/// Writes a path with one place, for comparison with a headless run.
fn standing(folder: &Path) -> PathBuf {
    let file = folder.join("standing.json");
    let text = r#"{"camera_path": {"keyframes": [{"t": 0, "pos": [-8.6, 1.6, -9.8], "target": [-2.0, 1.5, -9.2]}]}}"#;
    fs::write(&file, text).unwrap();
    file
}

#[test]
fn a_person_walks_looks_resizes_chooses_and_loses_the_server() {
    let (display, folder, certificate) = (Display::start(), tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let path = standing(folder.path());
    let (server, url) = serve("127.0.0.1:0", certificate.path());
    let stats = folder.path().join("stats.jsonl");
    // A chosen exposure: eyes that adapt never see quite the same again.
    let arguments = [&url, "--path", path.to_str().unwrap(), "--stats", stats.to_str().unwrap(), "--exposure", "1.1"];
    let mut window = Window::open(&display, folder.path(), &arguments);
    let first = window.still_picture();
    assert_eq!(first.dimensions(), SIZE);

    let walked = window.hold("w", |picture| difference(&first, picture) > 1.0);

    window.person(&format!("mousemove --window {} 160 90 mousedown 1", window.id));
    window.person(&format!("mousemove --window {} 220 100 mouseup 1", window.id));
    let looked = window.still_picture();
    assert!(difference(&walked, &looked) > 1.0, "a drag does not look");

    // A light off and on again.
    window.person("key 1");
    let darker = window.still_picture();
    assert!(difference(&looked, &darker) > 0.2, "a light does not go off");
    window.person("key 1");
    window.picture_that("has its light again", |picture| *picture == looked);

    // Display settings, once around.
    window.person("key o");
    window.person("key v");
    let unknown = window.still_picture();
    assert!(difference(&looked, &unknown) > 5.0, "V shows nothing else");
    let views = 5 + 6;
    (1..views).for_each(|_| window.person("key v"));
    window.person("key h");
    window.picture_that("has nothing of overlay, help and debug views", |picture| *picture == looked);

    // Tone curves, once around.
    window.person("key t");
    let toned = window.still_picture();
    assert!(difference(&looked, &toned) > 0.5, "T changes no colours");
    (0..3).for_each(|_| window.person("key t"));
    window.picture_that("has its first tone curve again", |picture| *picture == looked);
    window.person("key b");
    let split = window.still_picture();
    assert!(difference(&looked, &split) > 1.0, "B splits nothing");
    // Skip the local reference, which another test covers.
    (0..2).for_each(|_| window.person("key b"));
    window.person("key h");

    window.person(&format!("windowsize --sync {} 400 240", window.id));
    window.picture_that("is as large as the window", |picture| picture.dimensions() == (400, 240));
    window.person(&format!("windowsize --sync {} {} {}", window.id, SIZE.0, SIZE.1));
    window.picture_that("is as it was before the window was larger", |picture| *picture == looked);

    // The server dies; the client goes on drawing and responding.
    server.kill().unwrap();
    let alone = window.picture_that("is drawn alone", |picture| *picture != looked);
    let moved = window.hold("s", |picture| difference(&alone, picture) > 1.0);

    // A new server takes its place, and the client finds it.
    let address = url.split_once("://").unwrap().1.split_once('/').unwrap().0;
    // Where the walk ended may look the same with masks as without. The first debug view shows where masks are known.
    window.person("key v");
    let unknown = window.still_picture();
    assert!(unknown != moved, "V shows nothing else");
    let lost = window.last_frame(&stats, |line| line["link"] != "live");
    let (_server, again) = serve(address, certificate.path());
    assert_eq!(again, url);
    window.last_frame(&stats, |line| line["link"] == "live" && line["mask_frame"].as_u64() > Some(lost));
    window.picture_that("is lit by the new server", |picture| difference(&unknown, picture) > 1.0);
    window.leave();
}

#[test]
fn the_right_half_can_show_a_local_servers_masks() {
    let (display, folder, certificate) = (Display::start(), tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let path = standing(folder.path());
    let (server, url) = serve("127.0.0.1:0", certificate.path());
    let mut window = Window::open(&display, folder.path(), &[&url, "--path", path.to_str().unwrap()]);
    let lit = window.still_picture();
    server.kill().unwrap();
    window.picture_that("is drawn alone", |picture| *picture != lit);
    let alone = window.still_picture();
    assert!(!alone.enumerate_pixels().filter(|(x, ..)| x * 2 >= SIZE.0).all(|(x, y, p)| p == lit.get_pixel(x, y)));
    // Without visibility, then with it.
    (0..2).for_each(|_| window.person("key b"));
    window.picture_that("is right on the right", |picture| {
        picture.enumerate_pixels().all(|(x, y, pixel)| {
            let same_as = if x * 2 < SIZE.0 { &alone } else { &lit };
            pixel == same_as.get_pixel(x, y)
        })
    });
    let place = folder.path().to_str().unwrap().to_owned();
    assert_eq!(processes_with(&place).len(), 1);
    window.leave();
    assert_eq!(processes_with(&place), Vec::<String>::new());
    assert!(!fs::read_dir(&place).unwrap().flatten().any(|entry| entry.path().is_dir()), "something is left");
}

#[test]
fn it_can_fill_the_screen_and_be_hidden() {
    let (display, folder) = (Display::start(), tempfile::tempdir().unwrap());
    let environment = [("DISPLAY", display.name.as_str()), ("HOME", folder.path().to_str().unwrap())];
    let _manager = Program::start(Path::new("openbox"), &["--sm-disable"], &environment)
        .expect("the window is managed by openbox: run deploy/setup");
    let (path, scene, stats) = (standing(folder.path()), asset("cloister.glb"), folder.path().join("stats.jsonl"));
    let arguments = ["--offline", scene.to_str().unwrap(), "--path", path.to_str().unwrap()];
    // A chosen exposure: eyes that adapt to a larger window never see quite the same again.
    let more = ["--stats", stats.to_str().unwrap(), "--exposure", "1.1"];
    let mut window = Window::open(&display, folder.path(), &[arguments.as_slice(), &more].concat());
    let first = window.still_picture();
    window.person("key f");
    window.picture_that("fills the screen", |picture| picture.dimensions() == (800, 600));
    window.person("key f");
    window.picture_that("is as small as before", |picture| picture.dimensions() == SIZE);

    let id = window.id.clone();
    window.person(&format!("windowminimize --sync {id}"));
    std::thread::sleep(Duration::from_millis(1500));
    window.person(&format!("windowactivate --sync {id}"));
    window.picture_that("is as it was before it was hidden", |picture| *picture == first);
    window.leave();
    // A hidden window draws nothing.
    let lines = fs::read_to_string(&stats).unwrap();
    let time_ms = |line: &str| serde_json::from_str::<serde_json::Value>(line).unwrap()["t_ms"].as_f64().unwrap();
    let times: Vec<f64> = lines.lines().map(time_ms).collect();
    assert!(times.windows(2).any(|pair| pair[1] - pair[0] > 1000.0), "it is drawn while it is hidden");
}

/// Starts a server at this address, and returns its URL.
fn serve(address: &str, certificate: &Path) -> (Program, String) {
    let scene = asset("cloister.glb");
    let arguments = ["--scene", scene.to_str().unwrap(), "--listen", address, "--backend", "cpu", "--cert-dir"];
    let mut all = arguments.to_vec();
    all.push(certificate.to_str().unwrap());
    let mut server = Program::start(&find("gnomon-server").unwrap(), &all, &[]).unwrap();
    let url = server.wait_for(PATIENCE, |said| {
        let whole = said.get(..said.rfind('\n')? + 1)?;
        whole.split_whitespace().find(|word| word.starts_with("gnomon://")).map(str::to_owned)
    });
    (server, url.unwrap())
}

/// Returns the processes whose command line contains this text.
fn processes_with(text: &str) -> Vec<String> {
    let entries = fs::read_dir("/proc").unwrap().flatten();
    let lines = entries.filter_map(|entry| fs::read(entry.path().join("cmdline")).ok());
    let lines = lines.map(|line| String::from_utf8_lossy(&line).replace('\0', " "));
    lines.filter(|line| line.contains("gnomon-server") && line.contains(text)).collect()
}

#[test]
fn the_demo_starts_and_stops_its_server() {
    let (display, folder) = (Display::start(), tempfile::tempdir().unwrap());
    let place = folder.path().to_str().unwrap();
    let environment = [("DISPLAY", display.name.as_str()), ("WAYLAND_DISPLAY", ""), ("TMPDIR", place)];
    let client = find("gnomon-client").unwrap();
    let start = |seconds: &str| {
        let arguments = ["--demo", "--size", "160x90", "--allow-software", "--exit-after", seconds];
        Program::start(&client, &arguments, &environment).unwrap()
    };
    start("1").finish(PATIENCE).unwrap().success().unwrap();
    assert_eq!((processes_with(place), fs::read_dir(place).unwrap().count()), (Vec::new(), 0));

    // A killed client cannot stop its server.
    let killed = start("300");
    let begun = Instant::now();
    display.person("search --sync --name Gnomon");
    assert_eq!(processes_with(place).len(), 1, "no server runs");
    killed.kill().unwrap();
    if Path::new("/usr/bin/setpriv").is_file() {
        while !processes_with(place).is_empty() {
            assert!(begun.elapsed() < PATIENCE, "the server outlives its client");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

#[test]
fn a_certificate_is_pinned_on_the_first_visit_and_others_are_refused() {
    let (folder, certificate) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (server, url) = serve("127.0.0.1:0", certificate.path());
    let address = url.split_once("://").unwrap().1.split_once('/').unwrap().0.to_owned();
    let first_use = format!("gnomon://{address}/?cert=first-use");
    let state = folder.path().join("state");
    let run = |url: &str| {
        let arguments = [url, "--headless", "--frames", "1", "--size", "64x36", "--allow-software"];
        let environment = [("XDG_STATE_HOME", state.to_str().unwrap()), ("RUST_LOG", "warn")];
        let program = Program::start(&find("gnomon-client").unwrap(), &arguments, &environment).unwrap();
        program.finish(PATIENCE).unwrap()
    };
    let first = run(&first_use).success().unwrap();
    let pin = &url.rsplit_once('=').unwrap().1[..4];
    assert!(first.stderr.contains("first visit") && first.stderr.contains(pin), "{}", first.stderr);
    let second = run(&first_use).success().unwrap();
    assert!(!second.stderr.contains("first visit"), "{}", second.stderr);
    server.kill().unwrap();
    let other = tempfile::tempdir().unwrap();
    let (_server, _) = serve(&address, other.path());
    let third = run(&first_use);
    assert!(!third.status.success() && third.stderr.contains("than on the first visit"), "{}", third.stderr);
}

#[test]
fn a_window_shows_the_bytes_that_a_headless_run_writes() {
    let (display, folder) = (Display::start(), tempfile::tempdir().unwrap());
    let path = standing(folder.path());
    let server = ServerProcess::start(&asset("cloister.glb"), &["--backend", "cpu"]).unwrap();
    let pictures = folder.path().join("headless");
    let job = ClientJob {
        url: Some(server.url()),
        path: path.clone().into(),
        frames: 1,
        size: SIZE,
        folder: folder.path(),
        save_masks: false,
        arguments: vec!["--wait".into(), "--allow-software".into(), "--out".into(), pictures.clone().into()],
    };
    job.start().unwrap().finish(PATIENCE).unwrap().success().unwrap();
    let headless = image::open(pictures.join("frame_000000.png")).unwrap().to_rgb8();

    let url = server.url().to_owned();
    let recording = folder.path().join("window.rec");
    let arguments = [&url, "--path", path.to_str().unwrap(), "--record", recording.to_str().unwrap()];
    let mut window = Window::open(&display, folder.path(), &arguments);
    window.picture();
    // On the path, so that the camera agrees to the last bit.
    window.person("key Tab");
    window.picture_that("has the headless run's bytes", |picture| *picture == headless);
    window.leave();

    // The recording gives the same pictures.
    let again = folder.path().join("again");
    replay::run(&replay_options(&recording, &again), |line| println!("{line}")).unwrap();
    let pictures = fs::read_dir(&again).unwrap().map(|entry| image::open(entry.unwrap().path()).unwrap().to_rgb8());
    assert!(pictures.into_iter().any(|picture| picture == headless), "no frame of the recording is the picture");
}

#[test]
fn a_marked_pose_is_in_the_same_frame_whatever_the_network_does() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("marked.json");
    // The camera stands still and, in the middle of the run, turns around from one frame to the next.
    let key = |t: f64, z: f64| format!(r#"{{"t": {t}, "pos": [0, 1.6, -9.7], "target": [{z}, 1.6, -9.7]}}"#);
    let keys = [key(0.0, 1.0), key(1.49, 1.0), key(1.51, -1.0), key(3.0, -1.0)].join(", ");
    fs::write(&path, format!(r#"{{"camera_path": {{"keyframes": [{keys}]}}}}"#)).unwrap();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let server = ServerProcess::start(&asset("cloister.glb"), &["--backend", "cpu"]).unwrap();
    for one_way in ["0ms", "100ms"] {
        let mut settings = LinkSettings::default();
        settings.up.set(&format!("delay={one_way}")).unwrap();
        settings.down.set(&format!("delay={one_way}")).unwrap();
        let link =
            runtime.block_on(link::server::start("127.0.0.1:0".parse().unwrap(), server.url(), settings)).unwrap();
        let out = folder.path().join(one_way);
        let url = link.url(server.url()).unwrap();
        let job = ClientJob {
            url: Some(&url),
            path: path.clone().into(),
            frames: 90,
            size: (96, 54),
            folder: folder.path(),
            save_masks: false,
            arguments: ["--allow-software", "--fps", "30", "--out", out.to_str().unwrap()].map(Into::into).to_vec(),
        };
        job.start().unwrap().finish(PATIENCE).unwrap().success().unwrap();
        let picture = |frame: u32| image::open(out.join(format!("frame_{frame:06}.png"))).unwrap().to_rgb8();
        // The marked pose is that of frame 46, the first after 1.51 s: 46 / 30 s. Frame 45 is half-way around.
        let (before, middle, marked, last) = (picture(44), picture(45), picture(46), picture(89));
        assert!(difference(&before, &middle) > 10.0, "RTT of twice {one_way}: the pose of frame 45 is not in frame 45");
        assert!(difference(&middle, &marked) > 10.0, "RTT of twice {one_way}: the pose of frame 46 is not in frame 46");
        // After it only light changes.
        assert!(difference(&marked, &last) < difference(&before, &last) / 2.0, "RTT of twice {one_way}");
        let stats = job.stats().unwrap();
        let responses: Vec<f64> = stats.iter().filter_map(|line| line["response_ms"].as_f64()).collect();
        let soonest = responses.iter().copied().fold(f64::INFINITY, f64::min);
        // No mask arrives earlier than the network allows.
        assert!(!responses.is_empty() && (one_way == "0ms" || soonest >= 200.0), "the network was not slow: {soonest}");
    }
}

#[test]
fn a_recording_draws_the_same_pictures_again() {
    let folder = tempfile::tempdir().unwrap();
    let (out, recording) = (folder.path().join("run"), folder.path().join("run.rec"));
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let server = ServerProcess::start(&asset("cloister.glb"), &["--backend", "cpu"]).unwrap();
    let mut settings = LinkSettings::default();
    settings.down.set("delay=120ms").unwrap();
    let link = runtime.block_on(link::server::start("127.0.0.1:0".parse().unwrap(), server.url(), settings)).unwrap();
    let url = link.url(server.url()).unwrap();
    let arguments: [&str; 7] =
        ["--allow-software", "--fps", "30", "--out", out.to_str().unwrap(), "--record", recording.to_str().unwrap()];
    let job = ClientJob {
        url: Some(&url),
        path: format!("{}#walk", asset("cloister.json").display()).into(),
        frames: 60,
        size: (160, 90),
        folder: folder.path(),
        save_masks: false,
        arguments: arguments.map(Into::into).to_vec(),
    };
    job.start().unwrap().finish(PATIENCE).unwrap().success().unwrap();
    let again = folder.path().join("again");
    let mut options = replay_options(&recording, &again);
    let done = replay::run(&options, |line| println!("{line}")).unwrap();
    assert_eq!(done.frames, 60);
    let masks = job.stats().unwrap().iter().filter(|line| line["response_ms"].is_number()).count();
    assert!(masks > 3 && done.masks == masks as u64, "{done:?}, {masks} in the statistics");
    let read = |folder: &Path, frame: u32| image::open(folder.join(format!("frame_{frame:06}.png"))).unwrap().to_rgb8();
    for frame in 0..60 {
        assert!(read(&out, frame) == read(&again, frame), "frame {frame} is another picture");
    }
    assert!(read(&out, 0) != read(&out, 59));

    // Another scene is refused, and a truncated file is valid up to its end.
    options.scene.lights = Some(2);
    assert!(replay::run(&options, |_| ()).unwrap_err().to_string().contains("is of the scene"));
    options.scene.lights = None;
    let bytes = fs::read(&recording).unwrap();
    fs::write(&recording, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let cut = replay::run(&ReplayOptions { out: None, ..options.clone() }, |_| ()).unwrap();
    assert!(cut.frames > 0 && cut.frames < 60, "{cut:?}");
    fs::write(&recording, "gnomon recording 0\n").unwrap();
    assert!(
        replay::run(&options, |_| ()).unwrap_err().root_cause().to_string().contains("no recording of this version")
    );
}
