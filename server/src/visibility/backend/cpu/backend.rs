//! The back end: a prepared scene, and the threads that trace it.

use std::{num::NonZeroUsize, ops::Range, time::Instant};

use gnomon_protocol::mask::{Mask, TILE_PX};
use gnomon_scene::{Scene, SceneAt, camera::Camera};
use rayon::{
    ThreadPool, ThreadPoolBuilder,
    iter::{IntoParallelIterator, ParallelIterator},
};

use super::{
    count::{Counter, Silent, TraversalStats},
    simd::{Level, Simd, WithSimd},
    tile::{Picture, TileCost, TileScratch, trace_tile},
    world::{Posed, Stage, World},
};
use crate::visibility::{RayShares, TraceCost, backend::BackendError};

/// Most triangles that leaf and node indices can address.
const MAX_TRIANGLES: usize = (1 << 31) - 1;

/// Neighbouring tiles of a row, taken by a thread at once.
const RUN_TILES: usize = 16;

/// Traces on the processor. Each call uses all threads of the back end.
pub struct CpuBackend {
    world: World,
    origin_m: glam::DVec3,
    pool: ThreadPool,
    level: Level,
}

impl CpuBackend {
    /// Builds the tree, copies triangles and alpha pictures, and starts the threads (default: one per processor).
    ///
    /// # Errors
    /// If the threads cannot be started, the scene has more than 2³¹ − 1 triangles that stop rays, or the alpha of a
    /// MASK material is not decoded.
    pub fn new(scene: &Scene, threads: Option<NonZeroUsize>) -> Result<Self, BackendError> {
        Self::with_level(scene, threads, Level::detect())
    }

    pub(super) fn with_level(scene: &Scene, threads: Option<NonZeroUsize>, level: Level) -> Result<Self, BackendError> {
        let triangles = scene.tracing_triangles();
        if triangles.len() > MAX_TRIANGLES {
            return Err(BackendError::Triangles { found: triangles.len(), limit: MAX_TRIANGLES });
        }
        let threads = threads
            .map_or_else(|| std::thread::available_parallelism().map_or(1, NonZeroUsize::get), NonZeroUsize::get);
        let pool = ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|i| format!("trace-{i}"))
            .build()
            .map_err(|error| BackendError::Threads { threads, reason: error.to_string() })?;
        let world = pool.install(|| World::new(scene))?;
        Ok(Self { world, origin_m: scene.origin_m, pool, level })
    }

    /// What it keeps of the scene.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        self.world.memory_bytes()
    }

    /// One line for logs: instructions, threads, and the tree.
    #[must_use]
    pub fn describe(&self) -> String {
        let (world, bytes) = (&self.world.resting, self.memory_bytes());
        format!(
            "cpu: {} packets of eight, {} threads, {} triangles in {} leaves under {} nodes of eight, {:.1} MB",
            self.level.name(),
            self.pool.current_num_threads(),
            world.corners.len(),
            world.bvh.leaves.len(),
            world.bvh.nodes.len(),
            bytes as f64 / 1e6,
        )
    }

    /// Puts what moves or was edited where it is in this state of the scene; a number is a time in seconds. `None` if
    /// everything is as in the file.
    pub fn pose(&self, scene: impl Into<SceneAt>) -> Option<Posed> {
        let scene = scene.into();
        self.pool.install(|| self.world.pose(&scene))
    }

    /// Traces the view of `camera` at time 0 into `mask`, which has the camera's size and a plane for each light of the
    /// scene. Writes every word. Times are sums over the threads, divided by their number, so they exclude idle time.
    ///
    /// # Panics
    /// If the mask's shape is not the camera's and the scene's.
    pub fn trace(&self, camera: &Camera, mask: &mut Mask) -> TraceCost {
        self.trace_at(camera, 0.0, mask)
    }

    /// As [`Self::trace`], of this state of the scene; a number is a time in seconds.
    ///
    /// # Panics
    /// Those of [`Self::trace`].
    pub fn trace_at(&self, camera: &Camera, scene: impl Into<SceneAt>, mask: &mut Mask) -> TraceCost {
        let (from, rows) = (Instant::now(), 0..mask.shape().tiles_y());
        let posed = self.pose(scene);
        let pose_ms = posed.as_ref().map_or(0.0, |_| from.elapsed().as_secs_f64() * 1e3);
        TraceCost { pose_ms, ..self.trace_rows(camera, mask, rows, posed.as_ref()) }
    }

    /// As [`Self::trace`], but only for these rows of tiles, and with what moves where [`Self::pose`] has put it.
    /// Writes no other words.
    ///
    /// # Panics
    /// If the mask's shape is not the camera's and the scene's.
    pub fn trace_rows(&self, camera: &Camera, mask: &mut Mask, rows: Range<u32>, posed: Option<&Posed>) -> TraceCost {
        self.run::<Silent>(camera, mask, rows, posed).0
    }

    /// As [`Self::trace_at`], but slower. Also returns traversal counts for camera rays and for shadow rays.
    ///
    /// # Panics
    /// If the mask's shape is not the camera's and the scene's.
    pub fn trace_counted(
        &self,
        camera: &Camera,
        scene_time_s: f64,
        mask: &mut Mask,
    ) -> (TraceCost, [TraversalStats; 2]) {
        let rows = 0..mask.shape().tiles_y();
        let (cost, costs) = self.run::<TraversalStats>(camera, mask, rows, self.pose(scene_time_s).as_ref());
        let mut stats = [TraversalStats::default(); 2];
        for cost in &costs {
            stats[0].add(&cost.primary_stats);
            stats[1].add(&cost.shadow_stats);
        }
        (cost, stats)
    }

    fn run<C: Counter>(
        &self,
        camera: &Camera,
        mask: &mut Mask,
        rows: Range<u32>,
        posed: Option<&Posed>,
    ) -> (TraceCost, Vec<TileCost<C>>) {
        let stage = self.world.stage(posed);
        let shape = mask.shape();
        assert_eq!(
            (shape.width(), shape.height(), shape.lights() as usize),
            (camera.width, camera.height, self.world.lights()),
            "the mask's width, height and lights"
        );
        let picture = Picture { basis: camera.ray_basis(self.origin_m), width: camera.width, height: camera.height };
        let lines = (rows.start * TILE_PX).min(camera.height)..(rows.end * TILE_PX).min(camera.height);
        let runs = share_out(mask, rows);
        let level = self.level;
        let costs: Vec<TileCost<C>> = self.pool.install(|| {
            runs.into_par_iter()
                .map_init(Box::<TileScratch>::default, |scratch, run| {
                    level.dispatch(TraceRun {
                        stage: &stage,
                        picture: &picture,
                        run,
                        scratch,
                        cost: TileCost::default(),
                    })
                })
                .collect()
        });
        let per_thread_ms = 1e3 / self.pool.current_num_threads() as f64;
        let sum = |of: fn(&TileCost<C>) -> f64| costs.iter().map(of).sum::<f64>() * per_thread_ms;
        let shadow_rays = costs.iter().map(|cost| cost.shadow_rays).sum();
        let cost = TraceCost {
            pose_ms: 0.0,
            primary_ms: sum(|cost| cost.primary.as_secs_f64()),
            shadow_ms: sum(|cost| cost.shadow.as_secs_f64()),
            readback_ms: 0.0,
            primary_rays: u64::from(camera.width) * lines.len() as u64,
            primary_listed: 0,
            shadow_rays,
            shares: RayShares { traced: shadow_rays, ..RayShares::default() },
        };
        (cost, costs)
    }
}

/// Neighbouring tiles of a row, and their words in every plane.
struct Run<'a> {
    tile_x: u32,
    tile_y: u32,
    words: Vec<&'a mut [u64]>,
}

/// Splits these rows of the mask into runs, so that threads write words in place.
fn share_out(mask: &mut Mask, rows: Range<u32>) -> Vec<Run<'_>> {
    let shape = mask.shape();
    let (tiles_x, lights) = (shape.tiles_x() as usize, shape.lights() as usize);
    let mut runs = Vec::with_capacity(rows.len() * tiles_x.div_ceil(RUN_TILES));
    let rows = rows.start..rows.end.min(shape.tiles_y());
    for tile_y in rows.clone() {
        for tile_x in (0..shape.tiles_x()).step_by(RUN_TILES) {
            runs.push(Run { tile_x, tile_y, words: Vec::with_capacity(lights) });
        }
    }
    for plane in mask.words_mut().chunks_mut(shape.tiles()) {
        let pieces = plane.chunks_mut(tiles_x).skip(rows.start as usize).flat_map(|row| row.chunks_mut(RUN_TILES));
        for (run, piece) in runs.iter_mut().zip(pieces) {
            run.words.push(piece);
        }
    }
    runs
}

struct TraceRun<'a, C> {
    stage: &'a Stage<'a>,
    picture: &'a Picture,
    run: Run<'a>,
    scratch: &'a mut TileScratch,
    cost: TileCost<C>,
}

impl<C: Counter> WithSimd for TraceRun<'_, C> {
    type Output = TileCost<C>;

    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) -> TileCost<C> {
        let tiles = self.run.words.first().map_or(0, |words| words.len());
        for (tile_x, tile) in (self.run.tile_x..).zip(0..tiles) {
            let words = &mut self.run.words;
            let place = (tile_x, self.run.tile_y);
            trace_tile(s, self.stage, self.picture, place, self.scratch, &mut self.cost, |plane, word| {
                words[plane][tile] = word;
            });
        }
        self.cost
    }
}
