//! Frames in parts, step by step: interleaved work changes no bit, and no session waits for the whole of a long frame.

use std::{
    sync::{
        Arc,
        mpsc::{SyncSender, sync_channel},
    },
    time::{Duration, Instant},
};

use glam::DVec3;
use gnomon_protocol::{
    ids::FrameNumber,
    mask::{Mask, MaskShape},
};
use gnomon_scene::camera::Camera;

use super::state::Worker;
use crate::visibility::{
    TraceRequest, TracedMask,
    backend::{
        BackendError,
        compute::{ComputeBackend, RING_FRAMES, SLOTS},
        cpu::CpuBackend,
    },
    engine::{
        port::{SessionPort, session_port},
        shared::{PendingSession, SessionPermit, Shared},
        tracer::{TraceError, Tracer},
    },
    schedule::costs::SessionCosts,
    test_scenes::{living_room, room},
};

/// Expected to take 12 ms, and so cut into parts of four of its 90 rows while there are short frames.
const LONG: (u32, u32, f64) = (1280, 720, 12.0);
const SHORT: (u32, u32, f64) = (64, 40, 0.05);

struct Rig {
    worker: Worker,
    pending: SyncSender<PendingSession>,
    shared: Arc<Shared>,
}

fn cpu() -> Tracer {
    Tracer::on_cpu(CpuBackend::new(&room(), None).unwrap())
}

fn compute() -> Tracer {
    Tracer::on_device(ComputeBackend::open(&room(), None, true).unwrap())
}

fn living_cpu() -> Tracer {
    Tracer::on_cpu(CpuBackend::new(&living_room(), None).unwrap())
}

fn living_compute() -> Tracer {
    Tracer::on_device(ComputeBackend::open(&living_room(), None, true).unwrap())
}

/// Every frame has a time of its own.
fn scene_time_s(frame: u32) -> f64 {
    f64::from(frame) * 0.37
}

fn shape((width, height, _): (u32, u32, f64)) -> MaskShape {
    MaskShape::new(width, height, 5).unwrap()
}

fn camera(frame: u32, (width, height, _): (u32, u32, f64)) -> Camera {
    let angle = f64::from(frame) * 0.7;
    let from = DVec3::new(-0.5, 1.6, 0.3);
    Camera::looking_at(from, from + DVec3::new(angle.sin(), -0.2, angle.cos()), 1.0, width, height)
}

fn ask(port: &SessionPort, frame: u32, kind: (u32, u32, f64)) {
    let received_at = Instant::now();
    // A short frame is due sooner.
    let (camera, interval) = (camera(frame, kind), Duration::from_millis(u64::from(kind.0)));
    port.request(TraceRequest {
        frame: FrameNumber(frame),
        camera,
        scene: scene_time_s(frame).into(),
        ahead: None,
        received_at,
        interval,
    });
}

impl Rig {
    fn new(tracer: Tracer) -> Self {
        let (pending, pending_end) = sync_channel(8);
        let shared = Arc::new(Shared::default());
        let reopen = Box::new(|| Err(BackendError::Setup("no other".into())));
        Self { worker: Worker::new(tracer, reopen, pending_end, Arc::clone(&shared)), pending, shared }
    }

    fn open(&mut self, kind: (u32, u32, f64)) -> SessionPort {
        // So many that no pace holds a session back.
        self.open_at(kind, Some(1e6))
    }

    fn open_at(&mut self, kind: (u32, u32, f64), rate_hz: Option<f64>) -> SessionPort {
        let costs = Arc::new(SessionCosts::new(shape(kind), rate_hz, kind.2));
        let (port, engine_port) = session_port(std::thread::current(), Arc::clone(&costs));
        let permit = SessionPermit::acquire(&self.shared, &costs, None, |_| Ok::<_, ()>(())).unwrap();
        self.pending
            .send(PendingSession { shape: shape(kind), port: engine_port, costs, permit, retry: None })
            .unwrap();
        expect(self.worker.take_up_sessions());
        port
    }

    /// Works until a mask arrives.
    fn mask(&mut self, port: &mut SessionPort) -> TracedMask {
        loop {
            if let Ok(traced) = port.masks.try_recv() {
                return traced;
            }
            self.step();
        }
    }

    /// Does one piece of work, or waits for the device.
    fn step(&mut self) {
        if !self.work() {
            expect(self.worker.land(Duration::from_millis(1)));
        }
    }

    fn work(&mut self) -> bool {
        expect(self.worker.work())
    }

    /// Frames that have begun and are interrupted.
    fn interrupted(&self) -> usize {
        self.worker.sessions.values().filter(|session| session.partial.is_some()).count()
    }
}

/// Unwraps a result.
fn expect<T>(result: Result<T, TraceError>) -> T {
    result.unwrap_or_else(|error| match error {
        TraceError::Device { error, .. } => panic!("{error}"),
        TraceError::Panicked { .. } => panic!("tracing panicked"),
    })
}

/// The mask of a frame that is traced whole.
fn whole(tracer: &mut Tracer, frame: u32, kind: (u32, u32, f64)) -> Mask {
    let mut mask = Mask::new(shape(kind));
    assert!(tracer.trace(&camera(frame, kind), &scene_time_s(frame).into(), &mut mask).unwrap().is_some());
    mask
}

#[test]
fn short_frames_overtake_a_long_one_and_no_bit_changes() {
    for open in [cpu, compute, living_cpu, living_compute] {
        let mut reference = open();
        let mut rig = Rig::new(open());
        let (mut greedy, mut modest) = (rig.open(LONG), rig.open(SHORT));
        ask(&greedy, 1, LONG);
        // The long frame begins, and its first part is traced.
        assert!(rig.work() && rig.work());
        assert_eq!(rig.interrupted(), 1);
        for frame in 10..15 {
            ask(&modest, frame, SHORT);
            // Later frames may wait their turn: how much time they have used depends on the machine.
            if frame == 10 {
                // Until it has come, or is whole on a device: a busy host may hear of it after the long one.
                let on_device = |rig: &mut Rig| rig.worker.tracer.load().is_some_and(|load| load.in_flight > 0);
                while modest.masks.waiting() == 0 && !on_device(&mut rig) {
                    rig.step();
                }
                assert_eq!(rig.interrupted(), 1, "the short frame waited for the long one");
            }
            let traced = rig.mask(&mut modest);
            assert!(traced.frame == FrameNumber(frame) && traced.mask == whole(&mut reference, frame, SHORT));
            modest.recycle(traced.mask);
        }
        let traced = rig.mask(&mut greedy);
        let expected = whole(&mut reference, 1, LONG);
        assert!(traced.frame == FrameNumber(1) && traced.mask == expected);
        assert_eq!(traced.cost.primary_rays, 1280 * 720);
        // Alone, the same frame is traced whole, with the same bits.
        drop(modest);
        rig.worker.remove_closed();
        greedy.recycle(traced.mask);
        ask(&greedy, 1, LONG);
        assert!(rig.work() && rig.interrupted() == 0);
        let again = rig.mask(&mut greedy);
        assert!(again.mask == expected);
        assert_eq!(again.cost.shadow_rays, traced.cost.shadow_rays, "work is counted over all parts");
    }
}

#[test]
fn an_interrupted_frame_ends_with_its_session_and_restarts_when_buffers_grow() {
    for open in [cpu, compute, living_compute] {
        let mut rig = Rig::new(open());
        let (mut greedy, mut modest) = (rig.open(LONG), rig.open(SHORT));
        let leaving: Vec<SessionPort> = (0..3).map(|_| rig.open(LONG)).collect();
        for port in leaving.iter().chain([&greedy]) {
            ask(port, 3, LONG);
        }
        while rig.interrupted() < 3 {
            rig.step();
        }
        drop(leaving);
        rig.worker.remove_closed();
        // Larger than all earlier masks.
        let _larger = rig.open((1920, 1080, 20.0));
        ask(&modest, 4, SHORT);
        assert_eq!(rig.mask(&mut modest).frame, FrameNumber(4));
        let traced = rig.mask(&mut greedy);
        assert!(traced.frame == FrameNumber(3) && traced.mask == whole(&mut open(), 3, LONG));
        if let Some(load) = rig.worker.tracer.load() {
            assert_eq!(load.free_slots, SLOTS, "a slot is lost");
        }
    }
}

#[test]
fn short_frames_do_not_starve_a_long_one() {
    for open in [cpu, compute] {
        let mut rig = Rig::new(open());
        let mut short: Vec<SessionPort> = (0..3).map(|_| rig.open(SHORT)).collect();
        let mut long = rig.open(LONG);
        ask(&long, 1, LONG);
        short.iter().for_each(|port| ask(port, 2, SHORT));
        let mut masks = 0;
        while long.masks.try_recv().is_err() {
            for port in &mut short {
                if let Ok(traced) = port.masks.try_recv() {
                    port.recycle(traced.mask);
                    ask(port, 3, SHORT);
                    masks += 1;
                }
            }
            assert!(masks < 5000, "it starves");
            rig.step();
        }
    }
}

#[test]
fn a_long_frame_begins_while_the_ring_is_full_of_short_ones() {
    let mut rig = Rig::new(compute());
    let modest: Vec<SessionPort> = (0..4).map(|_| rig.open(SHORT)).collect();
    let mut greedy = rig.open(LONG);
    for port in &modest {
        ask(port, 5, SHORT);
    }
    while rig.work() {}
    assert_eq!(rig.worker.tracer.load().unwrap().in_flight, RING_FRAMES, "the fourth has no room");
    ask(&greedy, 6, LONG);
    assert!(rig.work());
    assert_eq!(rig.interrupted(), 1);
    assert_eq!(rig.mask(&mut greedy).frame, FrameNumber(6));
}

#[test]
fn the_request_of_a_failed_frame_is_kept() {
    let mut rig = Rig::new(Tracer::Lost);
    let port = rig.open(SHORT);
    ask(&port, 7, SHORT);
    let Err(failure) = rig.worker.work() else { panic!("traced without a device") };
    assert!(matches!(&failure, TraceError::Device { job: Some(job), .. } if job.request.frame == FrameNumber(7)));
    assert!(!rig.worker.recover(failure), "there is no other device");
    let retries: Vec<_> = rig.worker.sessions.values().map(|session| session.opened.retry.clone()).collect();
    assert_eq!(retries[0].as_ref().map(|request| request.frame), Some(FrameNumber(7)));
}

/// Sessions that ask for more than they declared, or that declared nothing, have used little time and wait for long.
/// Even so they go after a session that asks for what it declared.
#[test]
fn sessions_beyond_their_pace_go_last() {
    let mut rig = Rig::new(cpu());
    let mut honest = rig.open(SHORT);
    let mut greedy = [Some(20.0), None].map(|rate_hz| rig.open_at(SHORT, rate_hz));
    for port in &mut greedy {
        let mut frame = 0;
        while frame < 50 {
            ask(port, frame, SHORT);
            while rig.work() {}
            frame += 1;
            while port.masks.try_recv().is_ok() {}
        }
    }
    // The first has a turn again, but has lost its place.
    std::thread::sleep(Duration::from_millis(60));
    for port in &greedy {
        ask(port, 100, SHORT);
    }
    for frame in 1..4 {
        ask(&honest, frame, SHORT);
        assert!(rig.work());
        assert_eq!(honest.masks.try_recv().unwrap().frame, FrameNumber(frame));
    }
    while rig.work() {}
    for port in &mut greedy {
        let came: Vec<u32> = std::iter::from_fn(|| port.masks.try_recv().ok()).map(|mask| mask.frame.0).collect();
        assert_eq!(came.last(), Some(&100), "it takes what is left");
    }
}
