//! The `cpu` back end: tiles shared out to threads, rays traced in groups of 64 as packets of eight.
//!
//! A tile's way: [`tile`] aims its 64 camera rays → [`group`] makes them points of a plane → [`traverse`] takes the group
//! through the tree, testing eight boxes against all rays at once ([`frustum`]), then eight triangles ([`leaf`]), then packets →
//! [`surface`] finds points and normals → [`light`] picks the rays that matter → [`regroup`] sorts those that end far apart →
//! [`traverse`] again, from the light.
//!
//! Every result depends on its own ray and the triangles alone, not on the other rays of its group or on threads, so
//! masks are the same from run to run and for any number of threads. They may differ in single bits between
//! processors with and without AVX2 (see [`simd`]).

use std::{num::NonZeroUsize, ops::Range};

use gnomon_protocol::mask::{Mask, TILE_PX};
use gnomon_scene::{AlphaMode, Scene, camera::Camera};
use rayon::{
    ThreadPool, ThreadPoolBuilder,
    iter::{IntoParallelIterator, ParallelIterator},
};

use self::{
    alpha::Alpha,
    count::{Counter, Silent},
    light::PreparedLight,
    simd::{Level, Simd},
    surface::Corners,
    tile::{Picture, TileCost, TileScratch, World, trace_tile},
};
use super::{BackendError, sampling::Sampling};
use crate::visibility::{
    TraceCost,
    hierarchy::bvh::{TriangleFlags, WideBvh},
};

mod alpha;
mod count;
mod frustum;
mod group;
mod leaf;
mod light;
mod regroup;
mod simd;
mod surface;
#[cfg(test)]
mod tests;
mod tile;
mod traverse;
mod vector;

pub use count::Work;

/// Most triangles that leaf and node indices can name.
const MAX_TRIANGLES: usize = (1 << 31) - 1;

/// Tiles that a thread takes at a time, side by side.
const RUN_TILES: usize = 16;

/// Traces on the processor. Shared between threads as it is; each call uses all of the back end's threads.
pub struct CpuBackend {
    world: World,
    origin_m: glam::DVec3,
    pool: ThreadPool,
    level: Level,
}

impl CpuBackend {
    /// Builds what tracing `scene` needs: the tree, copies of its triangles, its alpha pictures. `threads` is the number of
    /// threads, by default one for each processor.
    ///
    /// # Errors
    /// When the threads cannot be had, the scene has more than 2³¹ − 1 triangles that stop rays, or the alpha of a MASK
    /// material is not decoded.
    pub fn new(scene: &Scene, threads: Option<NonZeroUsize>) -> Result<Self, BackendError> {
        Self::with_level(scene, threads, Level::detect())
    }

    fn with_level(scene: &Scene, threads: Option<NonZeroUsize>, level: Level) -> Result<Self, BackendError> {
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
        let flags = triangle_flags(scene);
        let bvh = pool.install(|| WideBvh::build(&scene.positions, triangles, &|t| flags[t as usize]));
        let middle = (scene.bounds.min + scene.bounds.max) * 0.5;
        let size_m = (scene.bounds.max - scene.bounds.min).max_element() * 2.0;
        let world = World {
            bvh,
            corners: Corners::of(scene),
            alpha: Alpha::new(scene)?,
            lights: scene.lights.iter().map(|light| PreparedLight::new(light, middle, size_m)).collect(),
            sampling: Sampling::All,
            middle,
            size_m,
        };
        Ok(Self { world, origin_m: scene.origin_m, pool, level })
    }

    /// The same back end, with shadow rays for these pixels only.
    #[must_use]
    pub fn with_sampling(mut self, sampling: Sampling) -> Self {
        self.world.sampling = sampling;
        self
    }

    /// One line for logs: instructions, threads, and the tree.
    #[must_use]
    pub fn describe(&self) -> String {
        let world = &self.world;
        let bytes = world.bvh.memory_bytes() + size_of_val(&*world.corners) + world.alpha.memory_bytes();
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

    /// Traces what `camera` sees into `mask`, which has the camera's size and a plane for each light of the scene. Writes every
    /// word. The times are sums over the threads, divided by their number; the stages of a tile follow each other, so
    /// with idle threads both are less than what a clock on the wall shows.
    ///
    /// # Panics
    /// When the mask's shape is not the camera's and the scene's.
    pub fn trace(&self, camera: &Camera, mask: &mut Mask) -> TraceCost {
        let rows = 0..mask.shape().tiles_y();
        self.run::<Silent>(camera, mask, rows).0
    }

    /// [`Self::trace`] of these rows of tiles only: writes their words, and no others.
    ///
    /// # Panics
    /// When the mask's shape is not the camera's and the scene's.
    pub fn trace_rows(&self, camera: &Camera, mask: &mut Mask, rows: Range<u32>) -> TraceCost {
        self.run::<Silent>(camera, mask, rows).0
    }

    /// [`Self::trace`], and what traversal did for camera rays and for shadow rays. Slower.
    ///
    /// # Panics
    /// When the mask's shape is not the camera's and the scene's.
    pub fn trace_counted(&self, camera: &Camera, mask: &mut Mask) -> (TraceCost, [Work; 2]) {
        let rows = 0..mask.shape().tiles_y();
        let (cost, costs) = self.run::<Work>(camera, mask, rows);
        let mut work = [Work::default(); 2];
        for cost in &costs {
            work[0].add(&cost.primary_work);
            work[1].add(&cost.shadow_work);
        }
        (cost, work)
    }

    fn run<C: Counter>(&self, camera: &Camera, mask: &mut Mask, rows: Range<u32>) -> (TraceCost, Vec<TileCost<C>>) {
        let shape = mask.shape();
        assert_eq!(
            (shape.width(), shape.height(), shape.lights() as usize),
            (camera.width, camera.height, self.world.lights.len()),
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
                        world: &self.world,
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
        let cost = TraceCost {
            primary_ms: sum(|cost| cost.primary.as_secs_f64()),
            shadow_ms: sum(|cost| cost.shadow.as_secs_f64()),
            readback_ms: 0.0,
            primary_rays: u64::from(camera.width) * lines.len() as u64,
            shadow_rays: costs.iter().map(|cost| cost.shadow_rays).sum(),
        };
        (cost, costs)
    }
}

/// A run of tiles of one row, and their words in every plane.
struct Run<'a> {
    tile_x: u32,
    tile_y: u32,
    words: Vec<&'a mut [u64]>,
}

/// Shares the words of these rows of the mask out, so that threads write to where they belong.
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
    world: &'a World,
    picture: &'a Picture,
    run: Run<'a>,
    scratch: &'a mut TileScratch,
    cost: TileCost<C>,
}

impl<C: Counter> simd::Work for TraceRun<'_, C> {
    type Output = TileCost<C>;

    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) -> TileCost<C> {
        let tiles = self.run.words.first().map_or(0, |words| words.len());
        for (tile_x, tile) in (self.run.tile_x..).zip(0..tiles) {
            let words = &mut self.run.words;
            let place = (tile_x, self.run.tile_y);
            trace_tile(s, self.world, self.picture, place, self.scratch, &mut self.cost, |plane, word| {
                words[plane][tile] = word;
            });
        }
        self.cost
    }
}

/// How each triangle's material treats rays.
fn triangle_flags(scene: &Scene) -> Vec<TriangleFlags> {
    let mut flags = Vec::with_capacity(scene.tracing_triangles().len());
    for draw in &scene.draws {
        let material = &scene.materials[draw.material as usize];
        if material.alpha == AlphaMode::Blend {
            break;
        }
        // Without a picture alpha is the same everywhere: what is there need not be asked.
        let masked = matches!(material.alpha, AlphaMode::Mask { cutoff }
            if material.base_color_texture.is_some() || material.base_color.w < cutoff);
        let of_draw = TriangleFlags { single_sided: !material.double_sided, masked };
        flags.extend(std::iter::repeat_n(of_draw, draw.triangles as usize));
    }
    flags
}
