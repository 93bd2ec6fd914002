//! The back end: a device with a scene, and the buffers for its masks.

use std::{collections::VecDeque, time::Duration};

use glam::DVec3;
use gnomon_protocol::mask::MaskShape;
use gnomon_scene::{Scene, SceneAt};
use gnomon_shaders::{
    device_failure::DeviceFailure,
    gpu::{Gpu, GpuOptions},
    host::TracedLight,
};
use wgpu::util::DeviceExt as _;

use super::{
    acceleration::Structures,
    enlarge,
    geometry::Geometry,
    kernels::{self, KernelOptions, Kernels, Lists, Posers, SCENE_BUFFERS, Traversal},
    limit::{PictureLimit, binding_limit},
    movers::{Movers, Posed},
    posing::{self, Posing},
    regions::{RegionBuffers, Sizes},
    ring::{Capacity, RING_FRAMES, Ring, SLOTS},
    submission::{InFlight, Submissions},
    timing::Timing,
};
use crate::visibility::backend::BackendError;

/// A submission that takes longer than this and [`PATIENCE_PER_RAY`] for each ray of the largest frame never completes.
const ANSWER_PATIENCE: Duration = Duration::from_secs(60);

/// Software adapters trace more than half a million rays a second, even on busy machines.
const PATIENCE_PER_RAY: Duration = Duration::from_micros(2);

/// Traces masks on one device. Frames are collected in the order in which their last parts were submitted.
#[derive(Debug)]
pub struct ComputeBackend {
    pub(super) gpu: Gpu,
    traversal: Traversal,
    tests_alpha: bool,
    memory: DeviceMemory,
    pub(super) kernels: Kernels,
    /// One; or one a slot, where each has an acceleration structure of its own.
    scenes: Vec<wgpu::BindGroup>,
    /// What moves or may be edited, with the buffers that it is in.
    pub(super) moving: Box<Moving>,
    pub(super) timing: Option<Timing>,
    pub(super) origin_m: DVec3,
    pub(super) lights: u32,
    /// [`gnomon_shaders::host::TracedView::nodes`].
    pub(super) nodes: u32,
    pub(super) ring: Option<Ring>,
    pub(super) in_flight: VecDeque<InFlight>,
    pub(super) submissions: Submissions,
    failure: DeviceFailure,
    #[cfg(any(test, feature = "faults"))]
    silent_after: Option<Duration>,
}

/// What moves, and where it is on the device.
#[derive(Debug)]
pub(super) struct Moving {
    pub(super) movers: Movers,
    pub(super) buffers: RegionBuffers,
    /// `None` where our own hierarchy is walked.
    pub(super) structures: Option<Structures>,
    /// `None` where the host moves everything.
    pub(super) posing: Option<Posing>,
}

impl Moving {
    /// Puts what moves or was edited where it is in this state of the scene, in a slot without a frame.
    pub(super) fn pose(&mut self, queue: &wgpu::Queue, slot: usize, scene: &SceneAt) -> Posed {
        // Known again when the frame is submitted.
        self.movers.set(slot, None);
        let posed = self.movers.pose(queue, &self.buffers, self.posing.as_ref(), slot, scene);
        if let Some(structures) = &mut self.structures {
            structures.write(queue, slot, self.movers.triangles(posed));
        }
        posed
    }

    /// Moves what the device moves, and builds a slot's acceleration structure, if it has one. Encode before the
    /// kernels of its frame. What is moved writes these timestamps. Returns whether the device moves anything.
    pub(super) fn build(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        slot: usize,
        posed: Posed,
        timestamp_writes: Option<wgpu::ComputePassTimestampWrites<'_>>,
    ) -> bool {
        if let Some(structures) = &self.structures {
            structures.build(encoder, slot, posed.triangles);
        }
        self.movers.set(slot, Some(posed));
        let posing = self.posing.as_ref().filter(|_| posed.by_device);
        if let Some(posing) = posing {
            posing.encode(encoder, slot, timestamp_writes);
        }
        posing.is_some()
    }
}

/// Memory of a device that grows with the scene and its masks, in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DeviceMemory {
    /// Nodes of our hierarchy; 0 where the adapter has its own.
    pub hierarchy_bytes: u64,
    /// Triangles and their normals.
    pub triangle_bytes: u64,
    pub lights_bytes: u64,
    /// Alpha materials, their pictures, and texture coordinates.
    pub alpha_bytes: u64,
    /// What moves or may be edited, once for each frame that may have begun: nodes, triangles, normals and lights; and
    /// what the device moves it by. An adapter's own structures are not counted.
    pub moving_bytes: u64,
    /// Words of one mask; 0 while there are no buffers.
    pub mask_bytes: u64,
}

impl ComputeBackend {
    /// Opens an adapter and uploads the scene. Builds the hierarchy and compiles the kernels.
    ///
    /// # Errors
    /// If there is no such adapter, it lacks what the kernels need, or the scene does not fit it.
    pub fn open(scene: &Scene, adapter: Option<String>, allow_software: bool) -> Result<Self, BackendError> {
        Self::open_with(scene, adapter, allow_software, KernelOptions::new(Traversal::Hierarchy))
    }

    /// As [`Self::open`], but blocks of pixels share lists as `lists` says.
    ///
    /// # Errors
    /// Those of [`Self::open`].
    pub fn open_with_lists(
        scene: &Scene,
        adapter: Option<String>,
        allow_software: bool,
        lists: Lists,
    ) -> Result<Self, BackendError> {
        let options = KernelOptions { lists, ..KernelOptions::new(Traversal::Hierarchy) };
        Self::open_with(scene, adapter, allow_software, options)
    }

    /// As [`Self::open`], but things are moved where `posers` says.
    ///
    /// # Errors
    /// Those of [`Self::open`].
    pub fn open_with_posers(
        scene: &Scene,
        adapter: Option<String>,
        allow_software: bool,
        posers: Posers,
    ) -> Result<Self, BackendError> {
        let options = KernelOptions { posers, ..KernelOptions::new(Traversal::Hierarchy) };
        Self::open_with(scene, adapter, allow_software, options)
    }

    /// As [`Self::open`], but shadow rays start `offset_roundings` rounding units off their surface: a fault for tests.
    ///
    /// # Errors
    /// Those of [`Self::open`].
    pub fn open_with_offset(
        scene: &Scene,
        adapter: Option<String>,
        allow_software: bool,
        offset_roundings: u16,
    ) -> Result<Self, BackendError> {
        let offset_roundings = Some(offset_roundings);
        let options = KernelOptions { offset_roundings, ..KernelOptions::new(Traversal::Hierarchy) };
        Self::open_with(scene, adapter, allow_software, options)
    }

    /// As [`Self::open`], on an open device.
    ///
    /// # Errors
    /// If the device lacks what the kernels need, or the scene does not fit it.
    pub fn new(scene: &Scene, gpu: Gpu) -> Result<Self, BackendError> {
        Self::new_with(scene, gpu, KernelOptions::new(Traversal::Hierarchy))
    }

    pub(in super::super) fn open_with(
        scene: &Scene,
        adapter: Option<String>,
        allow_software: bool,
        options: KernelOptions,
    ) -> Result<Self, BackendError> {
        let optional = kernels::TIMING | kernels::SUBGROUPS | posing::NEEDED;
        let wanted = kernels::NEEDED | optional | options.traversal.features();
        let gpu = pollster::block_on(Gpu::open(&GpuOptions { adapter, wanted, allow_software }))?;
        Self::new_with(scene, gpu, options)
    }

    pub(in super::super) fn new_with(scene: &Scene, gpu: Gpu, options: KernelOptions) -> Result<Self, BackendError> {
        let traversal = options.traversal;
        let failure = DeviceFailure::watch(&gpu.device);
        let mut geometry = Geometry::build(scene, traversal)?;
        let movers = Movers::new(scene, &mut geometry, traversal);
        let tests_alpha = !geometry.alpha_materials.is_empty();
        let mut memory = DeviceMemory {
            hierarchy_bytes: size_of_val(&*geometry.nodes) as u64,
            triangle_bytes: (size_of_val(&*geometry.triangles) + size_of_val(&*geometry.normals)) as u64,
            lights_bytes: (size_of::<TracedLight>() * scene.lights.len()) as u64,
            alpha_bytes: geometry.alpha_bytes(),
            moving_bytes: movers.room_bytes(),
            mask_bytes: 0,
        };
        let kernels = Kernels::new(&gpu, &geometry.alpha_materials, options)?;
        let (nodes, structures) = match traversal {
            Traversal::Hierarchy => (geometry.nodes.len(), None),
            Traversal::RayQuery => {
                let most_moving = movers.most_triangles();
                let greatest = enlarge::greatest_moving(scene);
                (
                    geometry.triangles.len(),
                    Some(Structures::new(&gpu, &geometry.triangles, (most_moving, SLOTS), greatest)?),
                )
            }
        };
        let nodes =
            u32::try_from(nodes).map_err(|_| BackendError::Setup(format!("the hierarchy has {nodes} nodes")))?;
        let buffers = upload(&gpu, scene, geometry, movers.room())?;
        let scenes = match &structures {
            Some(structures) => {
                let bind = |top| kernels.bind_scene(&gpu.device, &buffers, Some(top));
                structures.tops().iter().map(bind).collect()
            }
            None => vec![kernels.bind_scene(&gpu.device, &buffers, None)],
        };
        let [nodes_buffer, triangles, lights, _, _, _, normals] = buffers;
        let regions = RegionBuffers { nodes: nodes_buffer, triangles, lights, normals };
        if let Some(reason) = failure.take() {
            return Err(BackendError::Setup(reason));
        }
        let mut posing = Posing::new(&gpu, scene, movers.pieces(), &regions, (traversal, options.posers))?;
        if let Some(reason) = failure.take() {
            tracing::warn!(%reason, "the processor moves what moves, since the device cannot");
            posing = None;
        }
        memory.moving_bytes += posing.as_ref().map_or(0, Posing::bytes);
        let moving = Box::new(Moving { movers, buffers: regions, structures, posing });
        let timing = Timing::new(&gpu.device, &gpu.queue, u32::try_from(SLOTS).unwrap_or(u32::MAX));
        if let Some(reason) = failure.take() {
            return Err(BackendError::Setup(reason));
        }
        Ok(Self {
            traversal,
            tests_alpha,
            memory,
            kernels,
            scenes,
            moving,
            timing,
            origin_m: scene.origin_m,
            lights: u32::try_from(scene.lights.len()).unwrap_or(u32::MAX),
            nodes,
            ring: None,
            in_flight: VecDeque::with_capacity(RING_FRAMES),
            submissions: Submissions::default(),
            failure,
            #[cfg(any(test, feature = "faults"))]
            silent_after: None,
            gpu,
        })
    }

    /// `compute on ADAPTER (DRIVER)`, or `ray-query on …`.
    #[must_use]
    pub fn describe(&self) -> String {
        let info = &self.gpu.info;
        let name = match self.traversal {
            Traversal::Hierarchy => "compute",
            Traversal::RayQuery => "ray-query",
        };
        format!("{name} on {} ({} {}, {})", info.name, info.driver, info.driver_info, info.backend)
    }

    /// The largest mask that the device can hold.
    #[must_use]
    pub fn picture_limit(&self) -> PictureLimit {
        PictureLimit::of(&self.gpu)
    }

    /// Returns whether there are buffers for masks of this shape.
    #[must_use]
    pub fn fits(&self, shape: MaskShape) -> bool {
        self.ring.as_ref().is_some_and(|ring| ring.capacity.holds(shape))
    }

    /// Makes buffers that just fit masks of all these shapes, or none without a shape. Does nothing if they exist
    /// already. Frames in flight are lost, so collect them first.
    ///
    /// # Errors
    /// If the device has too little memory. Then there are no buffers, and nothing can be submitted.
    pub fn fit(&mut self, shapes: impl IntoIterator<Item = MaskShape>) -> Result<(), BackendError> {
        let needed = Capacity::of(shapes);
        if self.ring.as_ref().map(|ring| ring.capacity).unwrap_or_default() == needed {
            return Ok(());
        }
        self.in_flight.clear();
        self.ring = None;
        if needed != Capacity::default() {
            let ring = Ring::new(&self.gpu.device, &self.kernels, needed);
            if let Some(reason) = self.failure.take() {
                return Err(BackendError::Setup(reason));
            }
            self.ring = Some(ring);
        }
        Ok(())
    }

    /// Errors if the device has reported a failure since the last call.
    pub(super) fn check_device(&self) -> Result<(), BackendError> {
        self.failure.take().map_or(Ok(()), |reason| Err(BackendError::Device(reason)))
    }

    /// Errors if the oldest submission has taken far longer than any work takes: the device will never answer. The
    /// largest masks may take minutes on software adapters.
    pub(super) fn check_answers(&self) -> Result<(), BackendError> {
        let bits = self.ring.as_ref().map_or(0, |ring| ring.capacity.mask_bytes * 8);
        let patience = ANSWER_PATIENCE + PATIENCE_PER_RAY * u32::try_from(bits).unwrap_or(u32::MAX);
        #[cfg(any(test, feature = "faults"))]
        let patience = self.silent_after.unwrap_or(patience);
        let age = self.submissions.oldest_age();
        if age <= patience {
            return Ok(());
        }
        Err(BackendError::Device(format!("it has not answered for {:.1} s", age.as_secs_f64())))
    }

    /// From now on the device seems to complete nothing. It is given up after `patience`.
    #[cfg(any(test, feature = "faults"))]
    pub fn stop_answering(&mut self, patience: Duration) {
        self.silent_after = Some(patience);
    }

    /// Returns whether [`Self::stop_answering`] was called.
    pub(super) const fn is_silent(&self) -> bool {
        #[cfg(any(test, feature = "faults"))]
        return self.silent_after.is_some();
        #[cfg(not(any(test, feature = "faults")))]
        false
    }

    /// Destroys the device. All later requests fail, as after a real loss.
    #[cfg(any(test, feature = "faults"))]
    pub fn destroy_device(&self) {
        self.gpu.device.destroy();
    }

    /// The scene's bind group for frames of a slot.
    pub(super) fn scene(&self, slot: usize) -> &wgpu::BindGroup {
        &self.scenes[slot % self.scenes.len()]
    }

    /// Returns whether the kernels test alpha: only if the scene's triangles have holes.
    #[must_use]
    pub fn tests_alpha(&self) -> bool {
        self.tests_alpha
    }

    /// Returns whether blocks of pixels share lists of triangles in pictures of this size.
    #[must_use]
    pub fn uses_lists(&self, pixels: usize) -> bool {
        self.kernels.lists.as_ref().is_some_and(|lists| pixels >= lists.least_pixels)
    }

    /// Device memory of the scene and one mask.
    #[must_use]
    pub fn memory(&self) -> DeviceMemory {
        DeviceMemory { mask_bytes: self.ring.as_ref().map_or(0, |ring| ring.capacity.mask_bytes), ..self.memory }
    }
}

/// The scene's buffers, in the order of `wgsl/shared/traced_scene.wgsl`, with room for what moves behind what rests.
fn upload(
    gpu: &Gpu,
    scene: &Scene,
    mut geometry: Geometry,
    room: Sizes,
) -> Result<[wgpu::Buffer; SCENE_BUFFERS], BackendError> {
    // Tests read what the device has written.
    let read = if cfg!(test) { wgpu::BufferUsages::COPY_SRC } else { wgpu::BufferUsages::empty() };
    let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | read;
    let mut lights: Vec<TracedLight> = scene.lights.iter().map(TracedLight::new).collect();
    extend(&mut geometry.nodes, room.nodes);
    extend(&mut geometry.triangles, room.triangles);
    extend(&mut geometry.normals, room.triangles);
    extend(&mut lights, room.lights);
    let mut texels = geometry.alpha_texels;
    // The kernels read them four at a time.
    texels.resize(texels.len().next_multiple_of(4), 0);
    let buffer = |what: &'static str, contents: &[u8]| {
        let (bytes, limit) = (contents.len() as u64, binding_limit(gpu));
        if bytes > limit {
            return Err(BackendError::SceneTooLarge { what, bytes, limit, adapter: gpu.info.name.clone() });
        }
        // A binding must not be empty. Nothing reads this filler.
        let contents = if contents.is_empty() { &[0; 64] } else { contents };
        Ok(gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: Some(what), contents, usage }))
    };
    Ok([
        buffer("bounding volume hierarchy", bytemuck::cast_slice(&geometry.nodes))?,
        buffer("list of triangles", bytemuck::cast_slice(&geometry.triangles))?,
        buffer("list of lights", bytemuck::cast_slice(&lights))?,
        buffer("list of alpha materials", bytemuck::cast_slice(&geometry.alpha_materials))?,
        buffer("set of alpha pictures", &texels)?,
        buffer("list of texture coordinates", bytemuck::cast_slice(&geometry.alpha_uvs))?,
        buffer("list of normals", bytemuck::cast_slice(&geometry.normals))?,
    ])
}

/// Adds entries that are written later.
fn extend<T: bytemuck::Zeroable + Clone>(list: &mut Vec<T>, room: usize) {
    list.resize(list.len() + room, T::zeroed());
}
