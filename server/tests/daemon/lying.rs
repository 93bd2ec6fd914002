//! Promise: clients that lie harm themselves only. Honest clients beside them keep at least 95 % of the masks that they
//! get without them.

use std::{
    collections::BTreeSet,
    net::{IpAddr, Ipv4Addr},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use gnomon_protocol::{
    acknowledgement::Acknowledgement,
    codec::CodecId,
    header::HEADER_BYTES,
    ids::{FrameNumber, ReferenceName, ResumeToken},
    loss::{LossFeedback, LossTotals},
    message::{ClientMessage, Hello, Refusal, ServerMessage, Welcome},
    pose::{Pose, encode_pose_packet},
    reassembler::{Policy, Progress, Reassembler},
};
use gnomon_server::{
    config::ServerConfig,
    visibility::schedule::pace::{BURST, TOLERANCE},
};
use tokio::{task::JoinSet, time::MissedTickBehavior};
use web_transport_quinn::Session;

use super::{
    Rig,
    client::{Control, hello, pose},
    peer::{self, Protocol},
    soon,
};

/// Refusals of a client that comes back every half second.
const MOST_REFUSALS: u32 = 40;

/// Time for which honest clients are watched, once without liars and once beside them.
const WATCHED: Duration = Duration::from_secs(4);

/// Twice the rates of honest clients. The first at which they get [`ENOUGH`] without liars is taken, since other
/// programs may leave the server less of the processor. Half of it is more than an equal share of the tracing thread,
/// if all liars got what they ask for; the other half is there for what liars have declared.
const TWICE_HONEST_HZ: [u16; 4] = [40, 20, 10, 4];

/// A server that is at its limit without liars says nothing about them.
const ENOUGH: f64 = 0.95;

/// Masks of this size cost some milliseconds each, so that a few liars could take all of the tracing thread.
const SIZE: [u16; 2] = [480, 270];

/// A server for honest clients and liars. What they do once they are admitted is tested here, not what they declare, so
/// the budgets of time are large.
async fn rig(change: impl FnOnce(&mut ServerConfig)) -> Arc<Rig> {
    let rig = Rig::start(|config, _| {
        (config.device_budget_ms, config.cores_budget_ms) = (100_000, Some(100_000));
        change(config);
    });
    Arc::new(rig.await)
}

impl Rig {
    async fn peer(&self, protocol: Protocol) -> Peer {
        let endpoint = peer::endpoint(IpAddr::V4(Ipv4Addr::LOCALHOST), protocol);
        let connection = peer::connect(&endpoint, self.address()).await.unwrap();
        let session = peer::session(connection, protocol).await;
        let control = peer::control(&session).await;
        Peer { session, control, size: SIZE, next: 0, _endpoint: endpoint }
    }

    /// A client that has sent Start. One that is refused as busy comes back, as real ones do: beside other programs a
    /// first mask may take so long that the next client does not seem to fit.
    async fn started(&self, protocol: Protocol, hello: Hello) -> (Peer, Welcome) {
        let mut refusals = 0;
        loop {
            let mut peer = self.peer(protocol).await;
            peer.control.send(&ClientMessage::Hello(hello.clone())).await;
            match peer.control.receive().await {
                Some(ServerMessage::Welcome(welcome)) => {
                    peer.control.send(&ClientMessage::Start).await;
                    return (peer, welcome);
                }
                Some(ServerMessage::Refused(Refusal::Busy { .. })) if refusals < MOST_REFUSALS => refusals += 1,
                other => panic!("no welcome: {other:?}"),
            }
            tokio::time::sleep(Duration::from_millis(500)).await;
        }
    }
}

struct Peer {
    session: Session,
    control: Control,
    size: [u16; 2],
    /// Number of its next frame.
    next: u32,
    _endpoint: quinn::Endpoint,
}

impl Peer {
    fn send(&self, datagram: &[u8]) {
        // Fails once the server has closed the connection, as it may for a liar.
        let _ = self.session.send_datagram(datagram.to_vec().into());
    }

    fn ask(&mut self) {
        let pose = Pose { mask_px: self.size, ..pose() };
        self.send(&encode_pose_packet(self.next, FrameNumber(self.next), &pose));
        self.next += 1;
    }

    /// Asks for masks at this rate until `ends`. Returns the number asked, and the numbers of those that came whole.
    async fn watch(&mut self, rate_hz: u16, ends: impl Future<Output = ()>) -> (u32, BTreeSet<u32>) {
        let mut frames = Reassembler::new(Policy::WholeFrame);
        let (mut asked, mut came) = (0, BTreeSet::new());
        let mut tick = tokio::time::interval(Duration::from_secs(1) / u32::from(rate_hz));
        // Two poses at once would ask for one mask.
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut ends = std::pin::pin!(ends);
        loop {
            tokio::select! {
                () = &mut ends => break,
                _ = tick.tick() => {
                    self.ask();
                    asked += 1;
                }
                datagram = self.session.read_datagram() => match datagram {
                    Ok(datagram) => note(&mut frames, &datagram, &mut came),
                    Err(_) => break,
                },
            }
        }
        // The last ones may be on their way.
        let rest = async {
            while let Ok(datagram) = self.session.read_datagram().await {
                note(&mut frames, &datagram, &mut came);
            }
        };
        let _ = tokio::time::timeout(Duration::from_millis(300), rest).await;
        (asked, came)
    }

    /// Waits for the server's last message, and returns its reason.
    async fn closing(&mut self) -> String {
        loop {
            match self.control.receive().await {
                Some(ServerMessage::Closing { reason, .. }) => return reason.to_string(),
                Some(_) => {}
                None => panic!("closed without a reason"),
            }
        }
    }
}

fn note(frames: &mut Reassembler, datagram: &[u8], came: &mut BTreeSet<u32>) {
    if frames.push(datagram).is_ok_and(|progress| progress == Progress::Complete) {
        came.insert(frames.frame().unwrap().frame.0);
    }
}

fn sized(rate_hz: u16) -> Hello {
    Hello { width: SIZE[0].into(), height: SIZE[1].into(), rate_hz, ..hello() }
}

/// Two honest clients, one of each protocol, for [`WATCHED`] after their first mask. Returns the share of the
/// masks that they asked for and got.
async fn honest_share(rig: &Arc<Rig>, rate_hz: u16) -> f64 {
    let mut clients = JoinSet::new();
    for protocol in Protocol::BOTH {
        let rig = Arc::clone(rig);
        clients.spawn(async move {
            let (mut client, _) = rig.started(protocol, sized(rate_hz)).await;
            while client.watch(rate_hz, tokio::time::sleep(Duration::from_millis(200))).await.1.is_empty() {}
            let before = client.next;
            let (asked, came) = client.watch(rate_hz, tokio::time::sleep(WATCHED)).await;
            (asked, came.range(before..).count())
        });
    }
    let watched = clients.join_all().await;
    println!("honest clients at {rate_hz} Hz asked for and got {watched:?}");
    let (asked, came) = watched.into_iter().fold((0, 0), |(asked, came), (more, got)| (asked + more, came + got));
    #[expect(clippy::cast_precision_loss, reason = "some masks")]
    let share = came as f64 / f64::from(asked.max(1));
    share
}

/// Other programs may take the processor between two measurements, but not each time. Liars that do harm do it each
/// time.
const ATTEMPTS: usize = 4;

/// Time after which most liars have begun.
const SOON: Duration = Duration::from_millis(500);

/// Watches honest clients without liars, and beside `liars` that have `begun` for so long and go on until the flag is
/// set. Liars are told the honest clients' rate.
async fn honest_clients_keep_their_masks<L, F>(rig: &Arc<Rig>, begun: Duration, liars: L)
where
    L: Fn(Arc<Rig>, u16, Arc<AtomicBool>) -> F,
    F: Future<Output = ()> + Send + 'static,
{
    let mut attempts = Vec::new();
    while attempts.len() < ATTEMPTS {
        let (rate_hz, alone) = share_alone(rig).await;
        let stop = Arc::new(AtomicBool::new(false));
        let lying = tokio::spawn(liars(Arc::clone(rig), rate_hz, Arc::clone(&stop)));
        tokio::time::sleep(begun).await;
        let beside = honest_share(rig, rate_hz).await;
        stop.store(true, Ordering::Relaxed);
        soon(lying).await.unwrap();
        if beside >= alone * 0.95 {
            return;
        }
        attempts.push((alone, beside));
        rig.sessions(0).await;
    }
    panic!("shares of their masks without and beside liars: {attempts:.2?}");
}

/// Returns a rate at which honest clients leave half of the server without liars, and the share that they get.
async fn share_alone(rig: &Arc<Rig>) -> (u16, f64) {
    let mut shares = Vec::new();
    for rate_hz in TWICE_HONEST_HZ {
        let share = honest_share(rig, rate_hz).await;
        if share >= ENOUGH {
            return (rate_hz / 2, share);
        }
        shares.push(share);
    }
    panic!("only {shares:.2?} of their masks without any liar");
}

async fn stopped(stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

/// One after the other, since they would disturb each other.
#[tokio::test(flavor = "multi_thread")]
async fn clients_that_lie_harm_themselves_only() {
    about_a_low_rate().await;
    about_no_rate().await;
    about_sizes().await;
    about_resuming().await;
    about_what_they_have_and_lose().await;
    about_the_scene().await;
}

/// They declare 1 Hz and ask for 40.
async fn about_a_low_rate() {
    let rig = rig(|_| {}).await;
    // The masks that each may have at once are nobody's lie. At the rate that is left they take five seconds.
    let begun = Duration::from_secs_f64(BURST / TOLERANCE) + SOON;
    honest_clients_keep_their_masks(&rig, begun, |rig, honest_hz, stop| async move {
        let mut liars = JoinSet::new();
        // So many that what they declared, and a quarter more, is no more than the other half.
        for number in 0..(usize::from(2 * honest_hz) * 4 / 5).min(14) {
            let (rig, stop) = (Arc::clone(&rig), Arc::clone(&stop));
            liars.spawn(async move {
                let (mut liar, _) = rig.started(Protocol::BOTH[number % 2], sized(1)).await;
                let began = Instant::now();
                let (_, came) = liar.watch(40, stopped(&stop)).await;
                (came.len(), began.elapsed())
            });
        }
        for (came, lasted) in liars.join_all().await {
            // A quarter more than declared, and a burst.
            let most = lasted.as_secs() * 13 / 10 + 10;
            assert!(came as u64 <= most, "{came} masks in {lasted:?} for one a second");
        }
    })
    .await;
    rig.sessions(0).await;
}

/// They declare nothing and ask for 40 masks a second, so they get what the others leave.
async fn about_no_rate() {
    let rig = rig(|_| {}).await;
    honest_clients_keep_their_masks(&rig, SOON, |rig, _, stop| async move {
        let mut liars = JoinSet::new();
        for protocol in Protocol::BOTH {
            let (rig, stop) = (Arc::clone(&rig), Arc::clone(&stop));
            liars.spawn(async move {
                let (mut liar, _) = rig.started(protocol, sized(0)).await;
                liar.watch(40, stopped(&stop)).await.1.len()
            });
        }
        assert!(liars.join_all().await.iter().all(|came| *came > 0), "they are served, too");
    })
    .await;
    rig.sessions(0).await;
}

/// They ask for larger masks than agreed, and for sessions that would need more memory than there is.
async fn about_sizes() {
    let rig = rig(|config| config.memory_budget_mb = Some(100)).await;
    honest_clients_keep_their_masks(&rig, SOON, |rig, _, stop| async move {
        let (mut liar, _) = rig.started(Protocol::Native, sized(40)).await;
        liar.size = [4000, 2000];
        let largest = Hello { width: 3840, height: 2160, codec: CodecId::TilesSmall, ..hello() };
        let (mut admitted, mut refused) = (Vec::new(), 0);
        for number in 0..8 {
            let mut other = rig.peer(Protocol::BOTH[number % 2]).await;
            other.control.send(&ClientMessage::Hello(largest.clone())).await;
            match other.control.receive().await {
                Some(ServerMessage::Welcome(_)) => admitted.push(other),
                Some(ServerMessage::Refused(Refusal::Busy { reason, .. })) => {
                    let reason = reason.to_string();
                    // Beside other programs such a frame may take longer than the honest clients tolerate.
                    assert!(reason.contains("MB of memory") || reason.contains("frame would take"), "{reason}");
                    refused += 1;
                }
                other => panic!("{other:?}"),
            }
        }
        // 46 MB each.
        assert!(admitted.len() <= 2 && refused >= 6, "{} were admitted", admitted.len());
        let (_, came) = liar.watch(40, stopped(&stop)).await;
        assert!(came.is_empty());
        // Beyond a rate, invalid poses end their session.
        let session = liar.session.clone();
        let flooding = tokio::spawn(async move {
            let mut tick = tokio::time::interval(Duration::from_millis(1));
            loop {
                tokio::select! {
                    _ = tick.tick() => drop(session.send_datagram(vec![7; 90].into())),
                    _ = session.closed() => return,
                }
            }
        });
        assert!(liar.closing().await.contains("invalid datagrams"));
        soon(flooding).await.unwrap();
    })
    .await;
    rig.sessions(0).await;
}

/// They guess secrets, use one twice, and race for one.
async fn about_resuming() {
    let rig = rig(|_| {}).await;
    honest_clients_keep_their_masks(&rig, SOON, |rig, _, stop| async move {
        while !stop.load(Ordering::Relaxed) {
            let (victim, welcome) = rig.started(Protocol::Native, sized(1)).await;
            let guess = Some(ResumeToken([7; 16]));
            let (guesser, _) = rig.started(Protocol::Web, Hello { resume: guess, ..sized(1) }).await;
            let mut racing = JoinSet::new();
            for protocol in [Protocol::Native, Protocol::Web, Protocol::Native] {
                let (rig, hello) = (Arc::clone(&rig), Hello { resume: Some(welcome.resume), ..sized(1) });
                racing.spawn(async move { rig.started(protocol, hello).await.0 });
            }
            let won = soon(racing.join_all()).await;
            // The victim was replaced once; the other two are new clients.
            soon(victim.session.closed()).await;
            let (again, _) = rig.started(Protocol::Web, Hello { resume: Some(welcome.resume), ..sized(1) }).await;
            drop((guesser, won, again));
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
    })
    .await;
    rig.sessions(0).await;
}

/// They acknowledge frames that were never sent, and report losses that cannot be.
async fn about_what_they_have_and_lose() {
    let rig = rig(|_| {}).await;
    honest_clients_keep_their_masks(&rig, SOON, |rig, _, stop| async move {
        let mut liars = JoinSet::new();
        for (number, protocol) in Protocol::BOTH.into_iter().cycle().take(4).enumerate() {
            let (rig, stop) = (Arc::clone(&rig), Arc::clone(&stop));
            liars.spawn(async move {
                let hello = Hello { codec: CodecId::TilesSmall, ..sized(10) };
                let (mut liar, _) = rig.started(protocol, hello).await;
                let mut round = u32::try_from(number).unwrap();
                let (mut asked, mut came) = (0, 0);
                while !stop.load(Ordering::Relaxed) {
                    for lie in lies(round) {
                        liar.send(&lie);
                        round = round.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    }
                    let (more, got) = liar.watch(10, tokio::time::sleep(Duration::from_millis(200))).await;
                    (asked, came) = (asked + more, came + got.len());
                }
                (asked, came)
            });
        }
        for (asked, came) in liars.join_all().await {
            assert!(asked > 0 && came > 0, "{came} of {asked}: a liar is served all the same");
        }
    })
    .await;
    rig.sessions(0).await;
}

/// Acknowledgements and loss reports of many kinds, none of them true.
fn lies(round: u32) -> Vec<Vec<u8>> {
    let acknowledge = |sequence, mask| Acknowledgement { sequence, mask }.encode().to_vec();
    let name = |frame: u32, digest| Some(ReferenceName { frame: FrameNumber(frame), digest });
    let report = |sequence, expected, lost, runs| {
        LossFeedback { sequence, totals: LossTotals { expected, lost, runs } }.encode().to_vec()
    };
    let mut garbage = acknowledge(round, name(round, round));
    let place = (round as usize) % garbage.len();
    garbage[place] ^= 0x55;
    vec![
        acknowledge(round, name(0, round)),
        acknowledge(round.wrapping_add(1), name(u32::MAX - 1, round)),
        acknowledge(round.wrapping_add(1 << 30), None),
        garbage,
        report(round, 1, u32::MAX, 0),
        report(round.wrapping_add(1), u32::MAX, u32::MAX, u32::MAX),
        report(round.wrapping_add(2), 0, 5, 9),
        report(round.wrapping_add(1 << 30), round, round / 2, round / 3),
        vec![0x5a; HEADER_BYTES],
    ]
}

/// They fetch what is not there, and the same again and again.
async fn about_the_scene() {
    let rig = rig(|config| config.network_budget_mbit = Some(100)).await;
    honest_clients_keep_their_masks(&rig, SOON, |rig, _, stop| async move {
        let mut number = 0;
        // Each kind of offset at least once.
        while number < 3 || !stop.load(Ordering::Relaxed) {
            let mut liar = rig.peer(Protocol::BOTH[number % 2]).await;
            let welcome = liar.control.welcome(sized(1)).await;
            let (offsets, expected): (Vec<u64>, _) = match number % 3 {
                0 => (vec![welcome.scene_bytes + 1], "does not exist"),
                1 => (vec![u64::MAX], "does not exist"),
                _ => (vec![0; 8], "a few times"),
            };
            for offset in offsets {
                liar.control.send(&ClientMessage::FetchScene { offset }).await;
            }
            let reason = liar.closing().await;
            assert!(reason.contains(expected), "{reason}");
            number += 1;
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    })
    .await;
    rig.sessions(0).await;
}
