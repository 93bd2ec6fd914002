//! Promise: a server that runs for thirty days needs nobody. It renews what browsers pin and says so beforehand, tokens
//! expire by the clock, logs rotate without a lost line, and clients that come back each day get in.
//!
//! libfaketime moves the server's wall clock a day at a time; its monotonic clock goes on as ever. The clients run in
//! this process, and judge certificates by the server's date.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod walk;

use std::{
    collections::BTreeSet,
    fs,
    io::{Read as _, Write as _},
    net::{SocketAddr, TcpStream},
    path::{Path, PathBuf},
    process::Command,
    time::{Duration, Instant, SystemTime},
};

use gnomon_client::{
    ClientError,
    app::probe::{ProbeOptions, run_probe},
};
use gnomon_lab::rig::{
    Ask, PATIENCE,
    program::{Program, find},
};
use gnomon_protocol::{
    PROTOCOL_VERSION,
    codec::{CodecId, Decoder},
    ids::FrameNumber,
    mask::{Mask, MaskShape},
    message::{self, ClientMessage, Hello, ServerMessage},
    pose::{Pose, encode_pose_packet},
    reassembler::{Policy, Progress, Reassembler},
};
use gnomon_server::tokens::{self, Scope};
use rustls::pki_types::CertificateDer;
use serde_json::{Value, json};
use time::{Date, Month};
use tokio::{runtime::Runtime, time::timeout};
use web_transport_quinn::{ClientBuilder, RecvStream, SendStream, Session};

const DAYS: u32 = 30;
const DAY: Duration = Duration::from_secs(24 * 3600);
const SIDE_PX: u16 = 32;

/// Days on which a certificate of the first one's age is 6.5, 13, 19.5 and 26 days old or a little more.
const RENEWALS: [u32; 4] = [7, 13, 20, 26];

fn faketime() -> PathBuf {
    let folders = ["x86_64-linux-gnu", "aarch64-linux-gnu"].map(|machine| format!("/usr/lib/{machine}/faketime"));
    let found = folders.iter().map(|folder| Path::new(folder).join("libfaketimeMT.so.1")).find(|path| path.exists());
    found.expect("THIRTY DAYS ARE NOT TESTED: libfaketime is not installed; run deploy/setup tests")
}

struct Server {
    program: Program,
    folder: PathBuf,
    url: String,
    web: SocketAddr,
    started_at: SystemTime,
}

impl Server {
    fn start(folder: &Path) -> Self {
        let (library, clock) = (faketime(), folder.join("clock"));
        fs::write(&clock, "+0d").unwrap();
        let arguments = [
            format!("--scene={}", gnomon_scene::testing::write_scene(folder).unwrap().display()),
            "--backend=cpu".to_owned(),
            "--listen=127.0.0.1:0".to_owned(),
            "--web=0".to_owned(),
            "--log=json".to_owned(),
            format!("--cert-dir={}", folder.join("cert").display()),
            format!("--token-file={}", folder.join("tokens.toml").display()),
            format!("--log-file={}", folder.join("log").display()),
        ];
        let environment = [
            ("LD_PRELOAD", library.to_str().unwrap()),
            ("FAKETIME_TIMESTAMP_FILE", clock.to_str().unwrap()),
            ("FAKETIME_DONT_FAKE_MONOTONIC", "1"),
            ("FAKETIME_NO_CACHE", "1"),
        ];
        let started_at = SystemTime::now();
        let mut program = Program::start(&find("gnomon-server").unwrap(), &arguments, &environment).unwrap();
        let url = program.wait_for(PATIENCE, |said| Some(said.strip_suffix('\n')?.to_owned())).unwrap();
        let web = entries(&folder.join("log"), "web address")[0]["local_addr"].as_str().unwrap().parse().unwrap();
        Self { program, folder: folder.to_owned(), url, web, started_at }
    }

    /// Moves its clock, in one step.
    fn set_day(&self, day: u32) {
        let scratch = self.folder.join("clock.new");
        fs::write(&scratch, format!("+{day}d")).unwrap();
        fs::rename(scratch, self.folder.join("clock")).unwrap();
    }

    /// Rotates the log, as logrotate does.
    fn rotate(&self, day: u32) {
        let log = self.folder.join("log");
        fs::rename(&log, self.rotated(day)).unwrap();
        assert!(Command::new("kill").args(["-HUP", &self.program.id().to_string()]).status().unwrap().success());
        wait_until(|| log.exists() && !entries(&log, "certificate reloaded").is_empty());
    }

    fn rotated(&self, day: u32) -> PathBuf {
        self.folder.join(format!("log.{day}"))
    }

    /// `GET /gnomon.json`, as a page of another origin asks.
    fn hashes(&self) -> [String; 2] {
        let mut stream = TcpStream::connect(self.web).unwrap();
        let ask = ["GET /gnomon.json HTTP/1.1", "Host: edge", "Origin: https://a.example", "Connection: close", "", ""];
        stream.write_all(ask.join("\r\n").as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        assert!(head.contains("access-control-allow-origin: *") && head.contains("cache-control: no-store"), "{head}");
        let page: Value = serde_json::from_str(body).unwrap();
        assert_eq!((&page["protocol_version"], &page["scene"]), (&json!(PROTOCOL_VERSION), &json!("scene")), "{page}");
        assert!(self.url.contains(&format!(":{}/", page["port"])), "{page}");
        ["current", "next"].map(|which| page["certificate_sha256"][which].as_str().unwrap().to_owned())
    }
}

fn wait_until(mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// The fields of a log's events of one kind.
fn entries(log: &Path, message: &str) -> Vec<Value> {
    let text = fs::read_to_string(log).unwrap();
    // The last line may be half written.
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    let lines = whole.lines().map(|line| serde_json::from_str::<Value>(line).unwrap()["fields"].take());
    lines.filter(|fields| fields["message"] == message).collect()
}

/// A page's session: pins hashes as a browser does, and gets one mask.
struct Browser {
    session: Session,
    send: SendStream,
    receive: RecvStream,
}

impl Browser {
    /// Errors if the server's certificate has none of the hashes. Panics if a browser would refuse it on that date.
    async fn connect(url: &str, hashes: &[String], now: SystemTime) -> Result<Self, String> {
        let bytes = |hex: &String| -> Vec<u8> {
            (0..64).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap()).collect()
        };
        let pins = hashes.iter().map(bytes).collect();
        let client = ClientBuilder::new().with_server_certificate_hashes(pins).unwrap();
        let authority = url.strip_prefix("gnomon://").unwrap().split('/').next().unwrap();
        let url: url::Url = format!("https://{authority}/").parse().unwrap();
        let session = timeout(PATIENCE, client.connect(url)).await.unwrap().map_err(|error| error.to_string())?;
        let chain = session.peer_identity().unwrap().downcast::<Vec<CertificateDer<'static>>>().unwrap();
        let [from, to] = validity(&chain[0]);
        assert!(
            to.duration_since(from).unwrap() <= 14 * DAY && (from..to).contains(&now),
            "{from:?} to {to:?} at {now:?}"
        );
        // prime256v1, RFC 5480.
        assert!(chain[0].windows(10).any(|part| part == [6, 8, 0x2A, 0x86, 0x48, 0xCE, 0x3D, 3, 1, 7]));
        let (send, receive) = session.open_bi().await.unwrap();
        Ok(Self { session, send, receive })
    }

    async fn receive(&mut self) -> Option<ServerMessage> {
        let mut prefix = [0; 4];
        timeout(PATIENCE, self.receive.read_exact(&mut prefix)).await.unwrap().ok()?;
        let mut bytes = vec![0; message::decode_length(prefix).unwrap()];
        self.receive.read_exact(&mut bytes).await.unwrap();
        Some(message::decode(&bytes).unwrap())
    }

    /// Returns how many of the mask's bits are set. Errors with the refusal.
    async fn mask(&mut self, token: &str) -> Result<u32, ServerMessage> {
        let hello = Hello {
            version: PROTOCOL_VERSION,
            token: Some(token.into()),
            client: "a page".into(),
            width: SIDE_PX.into(),
            height: SIDE_PX.into(),
            codec: CodecId::PlanesLz4,
            rate_hz: 0,
            wrong_ppm: 0,
            resume: None,
        };
        self.send.write_all(&message::encode(&ClientMessage::Hello(hello)).unwrap()).await.unwrap();
        let lights = match self.receive().await.unwrap() {
            ServerMessage::Welcome(welcome) => welcome.lights,
            other => return Err(other),
        };
        self.send.write_all(&message::encode(&ClientMessage::Start).unwrap()).await.unwrap();
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let pose = Pose {
            position_m: [0.0, 2.5, 0.0],
            orientation: [-half, 0.0, 0.0, half],
            yfov_rad: 1.2,
            scene_time_s: 0.0,
            client_time_ms: 0,
            mask_px: [SIDE_PX; 2],
            look_ahead_ms: 0,
            revision: 0,
        };
        let (mut reassembler, mut decoder) = (Reassembler::new(Policy::WholeFrame), Decoder::new());
        let mut mask = Mask::new(MaskShape::new(SIDE_PX.into(), SIDE_PX.into(), lights).unwrap());
        let start = Instant::now();
        for sequence in 0.. {
            assert!(start.elapsed() < PATIENCE, "no mask");
            // The server may not have read Start yet.
            self.session.send_datagram(encode_pose_packet(sequence, FrameNumber(0), &pose).to_vec().into()).unwrap();
            while let Ok(packet) = timeout(Duration::from_millis(300), self.session.read_datagram()).await {
                if reassembler.push(&packet.unwrap()).unwrap() == Progress::Complete {
                    decoder.decode(reassembler.frame().unwrap().body, &mut mask).unwrap();
                    self.session.close(0, b"until tomorrow");
                    return Ok(mask.words().iter().map(|word| word.count_ones()).sum());
                }
            }
        }
        unreachable!("numbers do not end")
    }
}

/// The two UTCTimes of a certificate's validity, RFC 5280, 4.1.2.5.
fn validity(certificate: &[u8]) -> [SystemTime; 2] {
    let head = [0x30, 0x1E, 0x17, 0x0D];
    let start = certificate.windows(4).position(|part| part == head).expect("two UTCTimes") + 4;
    [start, start + 15].map(|at| {
        let text = std::str::from_utf8(&certificate[at..at + 12]).unwrap();
        let [year, month, day, hour, minute, second] =
            [0, 2, 4, 6, 8, 10].map(|at| text[at..at + 2].parse::<u8>().unwrap());
        let date = Date::from_calendar_date(2000 + i32::from(year), Month::try_from(month).unwrap(), day).unwrap();
        date.with_hms(hour, minute, second).unwrap().assume_utc().into()
    })
}

#[test]
fn a_server_runs_for_thirty_days() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    let token = |name, days| tokens::make(name, days, &[Scope::Session], false).unwrap();
    let [(week, week_entry), (ever, ever_entry)] = [token("week", Some(7)), token("ever", None)];
    fs::write(folder.join("tokens.toml"), week_entry + &ever_entry).unwrap();
    let server = Server::start(folder);
    let (runtime, path) = (Runtime::new().unwrap(), walk::path(folder));
    let native = |token: &str| -> Result<u64, ClientError> {
        let ask = Ask { size: (SIDE_PX.into(), SIDE_PX.into()), fps: None, frames: 2 };
        let options = ProbeOptions { token: Some(token.to_owned()), ..ask.of(&server.url.parse().unwrap()) };
        run_probe(runtime.handle(), &options, &path).map(|report| report.masks)
    };
    let browse = |token: &str, hashes: &[String], day: u32| {
        runtime.block_on(async {
            let mut browser = Browser::connect(&server.url, hashes, server.started_at + day * DAY).await?;
            browser.mask(token).await.map_err(|refused| format!("{refused:?}"))
        })
    };
    let mut known = server.hashes();
    let mut ever_known = BTreeSet::from(known.clone());
    let lit = browse(&ever, &known, 0).unwrap();
    assert!(lit > 0);
    let (mut sessions, mut renewals) = (1, Vec::new());
    for day in 1..=DAYS {
        server.set_day(day);
        if RENEWALS.contains(&day) {
            // Before anybody comes.
            wait_until(|| !entries(&folder.join("log"), "browser certificate renewed").is_empty());
        }
        // A page that has been open since yesterday, then one that asks.
        assert_eq!(browse(&ever, &known, day).unwrap(), lit, "day {day}");
        let asked = server.hashes();
        assert_eq!(asked == known, !RENEWALS.contains(&day), "day {day}");
        assert!(asked[0] == known[0] || asked[0] == known[1], "the next hash was announced, day {day}");
        let wrong = browse(&ever, &asked[1..], day).unwrap_err();
        assert!(wrong.contains("certificate"), "the next certificate is not in use yet: {wrong}");
        known = asked;
        ever_known.extend(known.clone());
        assert_eq!(browse(&ever, &known, day).unwrap(), lit, "day {day}");
        assert_eq!(native(&ever).unwrap(), 2, "day {day}");
        sessions += 3;
        if day < 7 {
            assert_eq!(native(&week).unwrap(), 2, "day {day}");
            sessions += 1;
        } else {
            let expired = native(&week).unwrap_err().to_string();
            assert!(expired.contains("token"), "day {day}: {expired}");
            let expired = browse(&week, &known, day).unwrap_err();
            assert!(expired.contains("Refused(Token)"), "day {day}: {expired}");
        }
        // Every session has ended, so that its line is in this day's log.
        let log = folder.join("log");
        wait_until(|| entries(&log, "session ended").len() == entries(&log, "session started").len());
        server.rotate(day);
    }
    server.program.terminate().unwrap();
    server.program.finish(PATIENCE).unwrap().success().unwrap();

    let logs: Vec<_> = (1..=DAYS).map(|day| folder.join(format!("log.{day}"))).chain([folder.join("log")]).collect();
    let all = |message: &str| -> Vec<Value> { logs.iter().flat_map(|log| entries(log, message)).collect() };
    assert_eq!((all("session started").len(), all("session ended").len()), (sessions, sessions));
    let problems: BTreeSet<_> = all("token refused").iter().map(|refused| refused["problem"].to_string()).collect();
    assert_eq!(problems, BTreeSet::from(["\"an expired token\"".to_owned()]));
    assert!(all("log lines were lost").is_empty());
    for renewed in all("browser certificate renewed") {
        renewals.push(renewed["sha256"].as_str().unwrap().to_owned());
        ever_known.insert(renewed["next_sha256"].as_str().unwrap().to_owned());
    }
    assert_eq!((renewals.len(), ever_known.len()), (RENEWALS.len(), RENEWALS.len() + 2), "{renewals:?}");
    // Threads log at once, so only dates are in order.
    let dates: Vec<String> = (logs.iter())
        .flat_map(|log| fs::read_to_string(log).unwrap().lines().map(str::to_owned).collect::<Vec<_>>())
        .map(|line| serde_json::from_str::<Value>(&line).unwrap()["timestamp"].as_str().unwrap()[..10].to_owned())
        .collect();
    assert!(dates.is_sorted(), "{dates:?}");
    assert_eq!(BTreeSet::from_iter(&dates).len(), DAYS as usize + 1);
}
