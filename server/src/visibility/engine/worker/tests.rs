//! Frames in parts, step by step: what comes between two parts changes no bit, and nobody waits for the whole of a long frame.

use std::{
    sync::mpsc::{SyncSender, sync_channel},
    time::Instant,
};

use glam::DVec3;
use gnomon_protocol::ids::FrameNumber;

use super::*;
use crate::visibility::{
    engine::port::{SessionPort, session_port},
    test_scenes::room,
};

/// Expected to take 12 ms, and so cut into parts of four of its 90 rows beside short ones.
const LONG: (u32, u32, f64) = (1280, 720, 12.0);
const SHORT: (u32, u32, f64) = (64, 40, 0.05);

struct Rig {
    worker: Worker,
    openings: SyncSender<Opening>,
    shared: Arc<Shared>,
}

fn cpu() -> Backend {
    Backend::Cpu(Box::new(CpuBackend::new(&room(), None).unwrap()))
}

fn compute() -> Backend {
    Backend::Compute(Box::new(ComputeBackend::open(&room(), None, true).unwrap()))
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
    // A short one is due sooner.
    let (camera, interval) = (camera(frame, kind), Duration::from_millis(u64::from(kind.0)));
    port.request(TraceRequest { frame: FrameNumber(frame), camera, ahead: None, received_at, interval });
}

impl Rig {
    fn new(backend: Backend) -> Self {
        let (openings, openings_end) = sync_channel(8);
        let shared = Arc::new(Shared::default());
        let reopen = Box::new(|| Err(BackendError::Setup("no other".into())));
        Self { worker: Worker::new(backend, reopen, openings_end, Arc::clone(&shared)), openings, shared }
    }

    fn open(&mut self, kind: (u32, u32, f64)) -> SessionPort {
        let costs = Arc::new(SessionCosts::new(shape(kind), None, kind.2));
        let (port, engine_port) = session_port(std::thread::current(), Arc::clone(&costs));
        let seat = Seat::take(&self.shared, &costs, |_| Ok::<_, ()>(())).unwrap();
        self.openings.send(Opening { shape: shape(kind), port: engine_port, costs, seat, retry: None }).unwrap();
        self.worker.take_up_openings().unwrap();
        port
    }

    /// Works until there is a mask.
    fn mask(&mut self, port: &mut SessionPort) -> crate::visibility::TracedMask {
        loop {
            if let Ok(traced) = port.masks.try_recv() {
                return traced;
            }
            self.step();
        }
    }

    /// Does one piece of work, or waits for one that the device does.
    fn step(&mut self) {
        if !self.worker.work().unwrap() {
            self.worker.land(Duration::from_millis(1)).unwrap();
        }
    }

    /// Frames that have begun and are interrupted.
    fn interrupted(&self) -> usize {
        self.worker.sessions.values().filter(|session| session.begun.is_some()).count()
    }
}

/// The mask of a frame that nothing has come between.
fn whole(backend: &mut Backend, frame: u32, kind: (u32, u32, f64)) -> Mask {
    let mut mask = Mask::new(shape(kind));
    match backend {
        Backend::Compute(backend) => _ = backend.trace(&camera(frame, kind), &mut mask).unwrap(),
        Backend::Cpu(backend) => _ = backend.trace(&camera(frame, kind), &mut mask),
        Backend::Gone => panic!("it is there"),
    }
    mask
}

#[test]
fn short_frames_overtake_a_long_one_and_no_bit_changes() {
    for open in [cpu, compute] {
        let mut reference = open();
        let mut rig = Rig::new(open());
        let (mut greedy, mut modest) = (rig.open(LONG), rig.open(SHORT));
        ask(&greedy, 1, LONG);
        // It begins, and its first part is traced.
        assert!(rig.worker.work().unwrap() && rig.worker.work().unwrap());
        assert_eq!(rig.interrupted(), 1);
        for frame in 10..15 {
            ask(&modest, frame, SHORT);
            let traced = rig.mask(&mut modest);
            assert!(traced.frame == FrameNumber(frame) && traced.mask == whole(&mut reference, frame, SHORT));
            modest.recycle(traced.mask);
            // What follows may wait its turn: it has had some time, and how much the machine decides.
            if frame == 10 {
                assert_eq!(rig.interrupted(), 1, "it waited for the long one");
                assert!(greedy.masks.try_recv().is_err());
            }
        }
        let traced = rig.mask(&mut greedy);
        let expected = whole(&mut reference, 1, LONG);
        assert!(traced.frame == FrameNumber(1) && traced.mask == expected);
        assert_eq!(traced.cost.primary_rays, 1280 * 720);
        // Nobody else is there any more: it is traced whole, and is the same.
        drop(modest);
        rig.worker.remove_closed();
        greedy.recycle(traced.mask);
        ask(&greedy, 1, LONG);
        assert!(rig.worker.work().unwrap() && rig.interrupted() == 0);
        let again = rig.mask(&mut greedy);
        assert!(again.mask == expected);
        assert_eq!(again.cost.shadow_rays, traced.cost.shadow_rays, "work is counted over all parts");
    }
}

#[test]
fn an_interrupted_frame_ends_with_its_session_and_begins_anew_when_buffers_grow() {
    for open in [cpu, compute] {
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
        // Larger than all before.
        let _larger = rig.open((1920, 1080, 20.0));
        ask(&modest, 4, SHORT);
        assert_eq!(rig.mask(&mut modest).frame, FrameNumber(4));
        let traced = rig.mask(&mut greedy);
        assert!(traced.frame == FrameNumber(3) && traced.mask == whole(&mut open(), 3, LONG));
        if let Backend::Compute(backend) = &rig.worker.backend {
            assert_eq!(backend.free_slots(), crate::visibility::backend::compute::SLOTS, "none is lost");
        }
    }
}

#[test]
fn short_frames_that_always_wait_do_not_keep_a_long_one_from_its_end() {
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
fn a_long_frame_begins_while_as_many_short_ones_fly_as_may() {
    let mut rig = Rig::new(compute());
    let modest: Vec<SessionPort> = (0..4).map(|_| rig.open(SHORT)).collect();
    let mut greedy = rig.open(LONG);
    for port in &modest {
        ask(port, 5, SHORT);
    }
    while rig.worker.work().unwrap() {}
    assert_eq!(rig.worker.flying.len(), RING_FRAMES, "the fourth has no room");
    ask(&greedy, 6, LONG);
    assert!(rig.worker.work().unwrap());
    assert_eq!(rig.interrupted(), 1);
    assert_eq!(rig.mask(&mut greedy).frame, FrameNumber(6));
}
