//! The engine with real sessions, on both back ends.

use std::{
    sync::Arc,
    task::Poll,
    time::{Duration, Instant},
};

use glam::DVec3;
use gnomon_protocol::{
    ids::FrameNumber,
    mask::{Mask, MaskShape},
};
use gnomon_scene::{Scene, SceneAt, camera::Camera};
use gnomon_shaders::gpu::{Gpu, GpuOptions};

use super::{
    error::{EngineError, OpenError},
    faults::Fault,
    fleet::Fleet,
    handle::Engine,
    options::{BackendChoice, EngineOptions},
    port::{OUTSTANDING_MASKS, SessionPort, session_port},
    shared::{PendingSession, SessionPermit, Shared},
    tracer::Tracer,
    worker::Worker,
};
use crate::visibility::{
    TraceRequest, TracedMask,
    backend::{BackendError, compute::ComputeBackend, cpu::CpuBackend},
    schedule::{capacity::Overload, costs::SessionCosts},
    test_scenes::room,
};

const BACKENDS: [BackendChoice; 2] = [BackendChoice::Cpu, BackendChoice::Compute];

fn options(backend: BackendChoice) -> EngineOptions {
    EngineOptions {
        backend,
        adapter: None,
        allow_software: true,
        threads: None,
        max_sessions: 20,
        budget_ms: EngineOptions::DEFAULT_BUDGET_MS,
        devices: None,
    }
}

fn engine(backend: BackendChoice) -> (Engine, Arc<Scene>) {
    let scene = Arc::new(room());
    (Engine::start(Arc::clone(&scene), &options(backend)).unwrap(), scene)
}

fn camera(step: u32, width: u32, height: u32) -> Camera {
    let angle = f64::from(step) * 0.7;
    let to = DVec3::new(angle.sin(), -0.2, angle.cos());
    let from = DVec3::new(-0.5, 1.6, 0.3);
    Camera::looking_at(from, from + to, 1.0, width, height)
}

fn request(frame: u32, width: u32, height: u32) -> TraceRequest {
    TraceRequest {
        frame: FrameNumber(frame),
        camera: camera(frame, width, height),
        scene: SceneAt::default(),
        ahead: None,
        received_at: Instant::now(),
        interval: Duration::from_millis(16),
    }
}

fn shape(width: u32, height: u32) -> MaskShape {
    MaskShape::new(width, height, 5).unwrap()
}

/// Waits until `condition` holds, with a time limit.
fn eventually(what: &str, mut condition: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !condition() {
        assert!(begin.elapsed() < Duration::from_secs(60), "{what} did not happen");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn next_mask(port: &mut SessionPort) -> TracedMask {
    let mut mask = None;
    eventually("a mask", || {
        mask = port.masks.try_recv().ok();
        mask.is_some()
    });
    mask.unwrap()
}

#[test]
fn twenty_sessions_of_different_sizes_each_get_their_own_frames() {
    for backend in BACKENDS {
        let (engine, scene) = engine(backend);
        let cpu = CpuBackend::new(&scene, None).unwrap();
        let sizes: Vec<(u32, u32)> = (0..20).map(|index| (24 + 4 * index, 40 - index)).collect();
        let mut ports: Vec<SessionPort> =
            sizes.iter().map(|&(width, height)| engine.open_session(shape(width, height)).unwrap()).collect();
        assert_eq!(engine.sessions(), 20);
        assert!(matches!(engine.open_session(shape(8, 8)), Err(OpenError::Full(20))));
        for frame in [3, 8] {
            for (port, &(width, height)) in ports.iter().zip(&sizes) {
                port.request(request(frame + width, width, height));
            }
            for (port, &(width, height)) in ports.iter_mut().zip(&sizes) {
                let traced = next_mask(port);
                assert_eq!(traced.frame, FrameNumber(frame + width));
                let mut expected = Mask::new(shape(width, height));
                cpu.trace(&camera(frame + width, width, height), &mut expected);
                let wrong: u32 =
                    traced.mask.words().iter().zip(expected.words()).map(|(a, b)| (a ^ b).count_ones()).sum();
                assert!(wrong <= 8, "{wrong} bits of {width}×{height} differ");
                assert!(traced.cost.shadow_rays > 100);
                port.recycle(traced.mask);
            }
        }
        drop(ports);
        eventually("the end of all sessions", || engine.sessions() == 0);
        drop(engine.open_session(shape(8, 8)).unwrap());
        engine.shutdown();
        assert!(matches!(engine.open_session(shape(8, 8)), Err(OpenError::Stopped(_))));
    }
}

#[test]
fn the_newest_pose_wins_and_an_idle_reader_blocks_no_other() {
    for backend in BACKENDS {
        let (engine, _) = engine(backend);
        let mut sleeper = engine.open_session(shape(64, 48)).unwrap();
        let mut reader = engine.open_session(shape(40, 40)).unwrap();
        // The reader's channel fills while poses keep coming.
        for frame in 0..200 {
            sleeper.request(request(frame, 64, 48));
            if frame % 40 == 0 {
                reader.request(request(frame, 40, 40));
                assert_eq!(next_mask(&mut reader).frame, FrameNumber(frame));
            }
        }
        eventually("two masks for the sleeper", || sleeper.masks.waiting() == OUTSTANDING_MASKS);
        let older = [next_mask(&mut sleeper).frame, next_mask(&mut sleeper).frame];
        // Reading made room. The waiting pose is the last one sent.
        assert_eq!(next_mask(&mut sleeper).frame, FrameNumber(199));
        assert!(older[0] < older[1] && older[1] < FrameNumber(199), "{older:?}");
        assert!(sleeper.masks.try_recv().is_err());
    }
}

#[test]
fn a_session_that_closes_in_mid_frame_disturbs_no_other() {
    for backend in BACKENDS {
        let (engine, _) = engine(backend);
        let mut reader = engine.open_session(shape(40, 40)).unwrap();
        for round in 0..6 {
            let leaver = engine.open_session(shape(80 + 8 * round, 60)).unwrap();
            leaver.request(request(round, 80 + 8 * round, 60));
            reader.request(request(round, 40, 40));
            // Dropping either end closes the session.
            let SessionPort { requests, masks, .. } = leaver;
            if round % 2 == 0 {
                drop(requests);
            } else {
                drop(masks);
            }
            assert_eq!(next_mask(&mut reader).frame, FrameNumber(round));
            eventually("the leaver's end", || engine.sessions() == 1);
        }
    }
}

#[test]
fn shutdown_closes_ports_even_with_frames_in_flight() {
    for backend in BACKENDS {
        let (engine, _) = engine(backend);
        let mut ports: Vec<SessionPort> = (0..4).map(|_| engine.open_session(shape(160, 90)).unwrap()).collect();
        for port in &ports {
            port.request(request(1, 160, 90));
        }
        engine.shutdown();
        assert_eq!(engine.sessions(), 0);
        for port in &mut ports {
            while port.masks.blocking_recv().is_some() {}
        }
    }
}

#[test]
fn waiting_for_the_end_returns_its_reason() {
    let (engine, _) = engine(BackendChoice::Cpu);
    pollster::block_on(async {
        let mut ended = std::pin::pin!(engine.ended());
        assert!(std::future::poll_fn(|context| Poll::Ready(ended.as_mut().poll(context).is_pending())).await);
        engine.shutdown();
        assert_eq!(ended.await, "it was shut down");
    });
    assert_eq!(pollster::block_on(engine.ended()), "it was shut down", "asked again later");
}

#[test]
fn masks_wake_an_async_session() {
    let (engine, _) = engine(BackendChoice::Cpu);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
    runtime.block_on(async {
        let mut port = engine.open_session(shape(32, 32)).unwrap();
        for frame in 0..5 {
            port.request(request(frame, 32, 32));
            let mask = tokio::time::timeout(Duration::from_secs(60), port.masks.recv()).await.unwrap().unwrap();
            assert_eq!(mask.frame, FrameNumber(frame));
        }
    });
}

#[test]
fn poses_of_another_size_are_dropped() {
    let (engine, _) = engine(BackendChoice::Cpu);
    let mut port = engine.open_session(shape(32, 32)).unwrap();
    port.request(request(1, 64, 32));
    std::thread::sleep(Duration::from_millis(50));
    port.request(request(2, 32, 32));
    assert_eq!(next_mask(&mut port).frame, FrameNumber(2));
}

#[test]
fn impossible_sessions_and_engines_are_refused_with_reasons() {
    let (engine, scene) = engine(BackendChoice::Cpu);
    let error = engine.open_session(MaskShape::new(8, 8, 3).unwrap()).unwrap_err();
    assert!(matches!(error, OpenError::Lights { expected: 5, found: 3 }), "{error}");
    let missing = EngineOptions { adapter: Some("no such adapter".into()), ..options(BackendChoice::Compute) };
    for backend in [BackendChoice::Compute, BackendChoice::Auto] {
        let error = Engine::start(Arc::clone(&scene), &EngineOptions { backend, ..missing.clone() }).unwrap_err();
        assert!(matches!(error, EngineError::Backend(BackendError::Gpu(_))), "{error}");
        assert!(error.to_string().contains("no such adapter"), "{error}");
    }
}

#[test]
fn auto_never_takes_a_software_adapter() {
    // On a machine with a GPU it takes the GPU.
    let engine = Engine::start(Arc::new(room()), &options(BackendChoice::Auto)).unwrap();
    assert!(engine.description().starts_with("cpu") || !engine.description().contains("llvmpipe"));
}

/// A worker with one session on a device that the test may destroy and the worker may reopen `reopened` times.
fn worker_on(gpu: &Gpu, reopened: u32) -> (SessionPort, Arc<Shared>, std::thread::JoinHandle<()>) {
    let scene = room();
    let first = Tracer::on_device(ComputeBackend::new(&scene, gpu.clone()).unwrap());
    let (pending, pending_end) = std::sync::mpsc::sync_channel(4);
    let shared = Arc::new(Shared::default());
    let mut left = reopened;
    let reopen = Box::new(move || {
        left = left.checked_sub(1).ok_or_else(|| BackendError::Setup("no more devices".into()))?;
        Ok(Tracer::on_device(ComputeBackend::new(&room(), open_gpu()).unwrap()))
    });
    let thread = std::thread::spawn({
        let shared = Arc::clone(&shared);
        move || Worker::new(first, reopen, pending_end, shared).run()
    });
    let costs = Arc::new(SessionCosts::new(shape(64, 64), None, 0.0));
    let (port, engine_port) = session_port(thread.thread().clone(), Arc::clone(&costs));
    let permit = SessionPermit::acquire(&shared, &costs, None, |_| Ok::<_, ()>(())).unwrap();
    pending.send(PendingSession { shape: shape(64, 64), port: engine_port, costs, permit, retry: None }).unwrap();
    (port, shared, thread)
}

fn open_gpu() -> Gpu {
    let wanted = wgpu::Features::IMMEDIATES;
    pollster::block_on(Gpu::open(&GpuOptions { adapter: None, wanted, allow_software: true })).unwrap()
}

#[test]
fn a_device_that_is_lost_for_good_closes_all_ports_and_leaves_its_reason() {
    let gpu = open_gpu();
    let (mut port, shared, thread) = worker_on(&gpu, 0);
    port.request(request(1, 64, 64));
    assert_eq!(next_mask(&mut port).frame, FrameNumber(1));
    gpu.device.destroy();
    port.request(request(2, 64, 64));
    assert!(port.masks.blocking_recv().is_none(), "a mask from a destroyed device");
    thread.join().unwrap();
    assert!(shared.end_reason().is_some_and(|reason| reason.contains("no more devices")));
}

#[test]
fn sessions_and_their_poses_survive_a_lost_device() {
    let gpu = open_gpu();
    let (mut port, shared, thread) = worker_on(&gpu, 1);
    port.request(request(1, 64, 64));
    let before = next_mask(&mut port);
    gpu.device.destroy();
    // The pose that was lost with the device is traced on the new one without a new request.
    port.request(request(2, 64, 64));
    assert_eq!(next_mask(&mut port).frame, FrameNumber(2));
    port.request(request(1, 64, 64));
    assert_eq!(next_mask(&mut port).mask, before.mask);
    assert!(shared.is_well());
    shared.stop.store(true, std::sync::atomic::Ordering::Release);
    drop(port);
    thread.join().unwrap();
}

#[test]
fn losses_with_masks_in_between_are_survived() {
    for backend in BACKENDS {
        let (engine, _) = engine(backend);
        let mut port = engine.open_session(shape(40, 40)).unwrap();
        for frame in 0..6 {
            engine.inject(Fault::DeviceLost);
            port.request(request(frame, 40, 40));
            assert_eq!(next_mask(&mut port).frame, FrameNumber(frame));
        }
        eventually("six losses", || engine.losses() == 6);
        assert!(engine.is_well());
    }
}

#[test]
fn a_panic_closes_its_session_and_no_other() {
    for backend in BACKENDS {
        let (engine, _) = engine(backend);
        let mut stays = engine.open_session(shape(40, 40)).unwrap();
        for frame in 0..20 {
            let mut leaves = engine.open_session(shape(32, 32)).unwrap();
            engine.inject(Fault::Panic);
            leaves.request(request(frame, 32, 32));
            assert!(leaves.masks.blocking_recv().is_none(), "a mask in spite of a panic");
            stays.request(request(frame, 40, 40));
            assert_eq!(next_mask(&mut stays).frame, FrameNumber(frame));
        }
        assert_eq!((engine.losses(), engine.sessions()), (0, 1));
    }
}

#[test]
fn sessions_spread_over_devices_and_move_when_one_is_lost() {
    let two = EngineOptions { devices: std::num::NonZeroUsize::new(2), ..options(BackendChoice::Compute) };
    let fleet = Fleet::start(&Arc::new(room()), &two).unwrap();
    let mut ports: Vec<SessionPort> = (0..4).map(|_| fleet.open(shape(40, 40), Some(10.0)).unwrap()).collect();
    let sessions = || fleet.engines().iter().map(Engine::sessions).collect::<Vec<_>>();
    assert_eq!(sessions(), [2, 2]);
    for frame in 0..3 {
        for port in &mut ports {
            port.request(request(frame, 40, 40));
            assert_eq!(next_mask(port).frame, FrameNumber(frame));
        }
        if frame == 0 {
            fleet.engines()[0].inject(Fault::DeviceLost);
            eventually("the move", || sessions() == [0, 4]);
        }
    }
    // The lost device came back, and takes new sessions.
    eventually("its return", || fleet.engines()[0].is_well());
    let _new = fleet.open(shape(40, 40), Some(10.0)).unwrap();
    assert_eq!(sessions(), [1, 4]);
    fleet.shutdown();
    assert!(pollster::block_on(fleet.ended()).contains("shut down"));
}

/// A submission that never completes costs its device, not the session: the request is traced again.
#[test]
fn a_device_that_does_not_answer_is_opened_again() {
    let (engine, _) = engine(BackendChoice::Compute);
    let mut port = engine.open_session(shape(40, 40)).unwrap();
    port.request(request(1, 40, 40));
    assert_eq!(next_mask(&mut port).frame, FrameNumber(1));
    engine.inject(Fault::NoAnswer);
    port.request(request(2, 40, 40));
    assert_eq!(next_mask(&mut port).frame, FrameNumber(2));
    assert_eq!(engine.losses(), 1);
    assert!(engine.is_well() && engine.answers());
}

#[test]
fn a_call_that_does_not_return_is_noticed_and_delays_no_stop() {
    let (engine, _) = engine(BackendChoice::Cpu);
    eventually("rest", || engine.answers_within(Duration::from_millis(1)));
    engine.inject(Fault::StuckCall);
    eventually("silence", || !engine.answers_within(Duration::from_millis(50)));
    assert!(engine.answers(), "a round may take a while");
    assert!(!engine.shutdown_within(Duration::from_millis(10)), "the thread is left behind");
    assert!(!engine.is_well());
    assert!(pollster::block_on(engine.ended()).contains("does not answer"));
}

/// A client that does not take its masks gets no turns. That is no sign of a stuck engine.
#[test]
fn a_slow_client_does_not_make_the_engine_look_stuck() {
    let (engine, _) = engine(BackendChoice::Cpu);
    let port = engine.open_session(shape(40, 40)).unwrap();
    for frame in 1..=10 {
        port.request(request(frame, 40, 40));
        std::thread::sleep(Duration::from_millis(10));
    }
    eventually("two masks", || port.masks.waiting() == OUTSTANDING_MASKS);
    port.request(request(11, 40, 40));
    eventually("rest", || engine.answers_within(Duration::from_millis(1)));
}

#[test]
fn a_session_beyond_the_budget_is_refused() {
    let (engine, _) = engine(BackendChoice::Cpu);
    // The first is always admitted, even though it exceeds the budget.
    let first = engine.open(shape(400, 300), Some(60_000.0)).unwrap();
    let refused = engine.open(shape(400, 300), Some(1.0)).unwrap_err();
    assert!(matches!(refused, OpenError::Overload(Overload::Time { .. })), "{refused}");
    drop(first);
    eventually("its end", || engine.sessions() == 0);
    engine.open(shape(400, 300), Some(1.0)).unwrap();
}

#[test]
fn a_mask_has_a_plane_for_every_light_of_a_scene() {
    assert_eq!(gnomon_scene::limits::MAX_LIGHTS, gnomon_protocol::limits::MAX_LIGHTS as usize);
}
