//! Tracing on a graphics adapter, with kernels in WGSL: runs on every adapter that has compute shaders.

mod frame;
mod geometry;
mod kernels;
mod ring;
#[cfg(test)]
mod tests;
mod timing;

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
};

use glam::DVec3;
use gnomon_protocol::mask::MaskShape;
use gnomon_scene::Scene;
use gnomon_shaders::{
    gpu::{Gpu, GpuOptions},
    host::TracedLight,
};
use wgpu::util::DeviceExt as _;

pub use self::{
    frame::Rest,
    ring::{RING_FRAMES, SLOTS},
};
use self::{
    frame::{InFlight, Submissions},
    geometry::Geometry,
    kernels::{Kernels, SCENE_BUFFERS},
    ring::{Capacity, Ring},
    timing::Timing,
};
use super::{BackendError, ray_query, sampling::Sampling};

/// How the kernels find the triangles on a ray's way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Traversal {
    /// They walk obvhs' compressed hierarchy: the `compute` back end.
    Hierarchy,
    /// The adapter walks a structure of its own: the `ray-query` back end.
    RayQuery,
}

/// What the kernels are compiled for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct KernelOptions {
    /// Which pixels have shadow rays of their own.
    pub sampling: Sampling,
    /// Whether visited nodes are counted, which costs time.
    pub count_nodes: bool,
    /// How far shadow rays start off their surface, in rounding units, in place of what the rule says (`primary.wgsl`).
    pub offset_roundings: Option<u16>,
}

/// Traces masks on one device. Frames are collected in the order in which their last parts were submitted.
#[derive(Debug)]
pub struct ComputeBackend {
    gpu: Gpu,
    traversal: Traversal,
    tests_alpha: bool,
    kept: Kept,
    sampling: Sampling,
    /// Of the last frame collected.
    node_visits: u64,
    kernels: Kernels,
    scene: wgpu::BindGroup,
    timing: Option<Timing>,
    origin_m: DVec3,
    lights: u32,
    nodes: u32,
    ring: Option<Ring>,
    in_flight: VecDeque<InFlight>,
    submissions: Submissions,
    failure: Failure,
}

/// What a device keeps of a scene, and for its masks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Kept {
    /// Nodes of our hierarchy, in bytes; 0 where the adapter has its own.
    pub hierarchy_bytes: u64,
    /// Triangles and their normals, in bytes.
    pub triangle_bytes: u64,
    /// The lights, in bytes.
    pub lights_bytes: u64,
    /// Alpha materials, their pictures, and texture coordinates, in bytes.
    pub alpha_bytes: u64,
    /// The words of one mask, in bytes; 0 before there are buffers.
    pub mask_bytes: u64,
}

/// The first thing that the device complained about and nobody has asked about yet.
#[derive(Debug, Clone, Default)]
struct Failure(Arc<Mutex<Option<String>>>);

impl Failure {
    fn note(&self, reason: String) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(reason);
    }

    fn take(&self) -> Option<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

/// The largest buffer of a device, known without asking the device.
#[derive(Debug, Clone)]
pub struct PictureLimit {
    bytes: u64,
    adapter: String,
}

impl PictureLimit {
    /// Whether masks of this shape can be traced.
    ///
    /// # Errors
    /// When they cannot, with the numbers.
    pub fn check(&self, shape: MaskShape) -> Result<(), BackendError> {
        let bytes = Capacity::of([shape]).largest_bytes();
        if bytes <= self.bytes {
            return Ok(());
        }
        let (width, height, lights) = shape.into();
        Err(BackendError::PictureTooLarge {
            width,
            height,
            lights,
            bytes,
            limit: self.bytes,
            adapter: self.adapter.clone(),
        })
    }
}

impl ComputeBackend {
    /// Opens an adapter, and brings the scene to it. Takes as long as building the hierarchy and compiling the kernels.
    ///
    /// # Errors
    /// When there is no such adapter, it lacks what the kernels need, or the scene does not fit it.
    pub fn open(scene: &Scene, adapter: Option<String>, allow_software: bool) -> Result<Self, BackendError> {
        Self::open_with(scene, adapter, allow_software, KernelOptions::default())
    }

    /// As [`Self::open`], with other kernels.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_with(
        scene: &Scene,
        adapter: Option<String>,
        allow_software: bool,
        options: KernelOptions,
    ) -> Result<Self, BackendError> {
        Self::open_traversing(scene, adapter, allow_software, (Traversal::Hierarchy, options))
    }

    /// As [`Self::open_with`], with either way to find triangles.
    pub(super) fn open_traversing(
        scene: &Scene,
        adapter: Option<String>,
        allow_software: bool,
        (traversal, options): (Traversal, KernelOptions),
    ) -> Result<Self, BackendError> {
        let experimental = if traversal == Traversal::RayQuery { ray_query::NEEDED } else { wgpu::Features::empty() };
        let wanted = kernels::NEEDED | kernels::TIMING | experimental;
        let gpu = pollster::block_on(Gpu::open(&GpuOptions { adapter, wanted, allow_software }))?;
        Self::new_traversing(scene, gpu, (traversal, options))
    }

    /// As [`Self::open`], on a device that is already there.
    ///
    /// # Errors
    /// When the device lacks what the kernels need, or the scene does not fit it.
    pub fn new(scene: &Scene, gpu: Gpu) -> Result<Self, BackendError> {
        Self::new_traversing(scene, gpu, (Traversal::Hierarchy, KernelOptions::default()))
    }

    /// As [`Self::new`], with any kernels.
    pub(super) fn new_traversing(
        scene: &Scene,
        gpu: Gpu,
        (traversal, options): (Traversal, KernelOptions),
    ) -> Result<Self, BackendError> {
        let failure = Failure::default();
        let (on_error, on_loss) = (failure.clone(), failure.clone());
        gpu.device.on_uncaptured_error(Arc::new(move |error| on_error.note(error.to_string())));
        gpu.device.set_device_lost_callback(move |reason, text| {
            // Dropping the device is reported too.
            if reason != wgpu::DeviceLostReason::Destroyed {
                on_loss.note(format!("the device is lost: {text}"));
            }
        });
        let geometry = Geometry::build(scene, traversal)?;
        let tests_alpha = !geometry.alpha_materials.is_empty();
        let kept = Kept {
            hierarchy_bytes: size_of_val(&*geometry.nodes) as u64,
            triangle_bytes: (size_of_val(&*geometry.triangles) + size_of_val(&*geometry.normals)) as u64,
            lights_bytes: (size_of::<TracedLight>() * scene.lights.len()) as u64,
            alpha_bytes: geometry.alpha_bytes(),
            mask_bytes: 0,
        };
        let kernels = Kernels::new(&gpu, traversal, options, tests_alpha)?;
        let nodes = match traversal {
            Traversal::Hierarchy => geometry.nodes.len(),
            Traversal::RayQuery => geometry.triangles.len(),
        };
        let nodes =
            u32::try_from(nodes).map_err(|_| BackendError::Setup(format!("the hierarchy has {nodes} nodes")))?;
        let structure = match traversal {
            Traversal::Hierarchy => None,
            Traversal::RayQuery => Some(ray_query::build_structure(&gpu, &geometry.triangles)?),
        };
        let buffers = upload(&gpu, scene, geometry)?;
        let scene_group = kernels.bind_scene(&gpu.device, &buffers, structure.as_ref());
        let timing = Timing::new(&gpu.device, &gpu.queue, u32::try_from(SLOTS).unwrap_or(u32::MAX));
        if let Some(reason) = failure.take() {
            return Err(BackendError::Setup(reason));
        }
        Ok(Self {
            traversal,
            tests_alpha,
            kept,
            sampling: options.sampling,
            node_visits: 0,
            kernels,
            scene: scene_group,
            timing,
            origin_m: scene.origin_m,
            lights: u32::try_from(scene.lights.len()).unwrap_or(u32::MAX),
            nodes,
            ring: None,
            in_flight: VecDeque::with_capacity(RING_FRAMES),
            submissions: Submissions::default(),
            failure,
            gpu,
        })
    }

    /// `compute on ADAPTER (DRIVER)`, or `ray-query on` it.
    #[must_use]
    pub fn describe(&self) -> String {
        let info = &self.gpu.info;
        let name = match self.traversal {
            Traversal::Hierarchy => "compute",
            Traversal::RayQuery => "ray-query",
        };
        format!("{name} on {} ({} {}, {})", info.name, info.driver, info.driver_info, info.backend)
    }

    /// What masks must fit into.
    #[must_use]
    pub fn picture_limit(&self) -> PictureLimit {
        PictureLimit { bytes: binding_limit(&self.gpu), adapter: self.gpu.info.name.clone() }
    }

    /// Whether there are buffers for masks of this shape.
    #[must_use]
    pub fn fits(&self, shape: MaskShape) -> bool {
        self.ring.as_ref().is_some_and(|ring| ring.capacity.holds(shape))
    }

    /// Makes buffers in which masks of all these shapes fit, unless they are there already, and gives back memory when
    /// nothing is left that needs it. Frames in flight are lost, so collect them first.
    ///
    /// # Errors
    /// When the device has not enough memory: then there are no buffers at all, and nothing can be submitted.
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

    /// Destroys the device: whatever is asked of it next fails, as after a real loss.
    #[cfg(any(test, feature = "faults"))]
    pub fn lose(&self) {
        self.gpu.device.destroy();
    }

    /// Nodes that the rays of the last frame collected visited; 0 unless they are counted ([`KernelOptions`]).
    #[must_use]
    pub fn node_visits(&self) -> u64 {
        self.node_visits
    }

    /// Whether the kernels were compiled with what tests alpha: only for a scene whose triangles have holes.
    #[must_use]
    pub fn tests_alpha(&self) -> bool {
        self.tests_alpha
    }

    /// How much the device keeps of what grows with lights and holes.
    #[must_use]
    pub fn kept(&self) -> Kept {
        Kept { mask_bytes: self.ring.as_ref().map_or(0, |ring| ring.capacity.mask_bytes), ..self.kept }
    }
}

fn binding_limit(gpu: &Gpu) -> u64 {
    let limits = gpu.device.limits();
    limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
}

/// The scene's buffers, in the order of `wgsl/shared/traced_scene.wgsl`.
fn upload(gpu: &Gpu, scene: &Scene, geometry: Geometry) -> Result<[wgpu::Buffer; SCENE_BUFFERS], BackendError> {
    let usage = wgpu::BufferUsages::STORAGE;
    let lights: Vec<TracedLight> = scene.lights.iter().map(TracedLight::new).collect();
    let mut texels = geometry.alpha_texels;
    // The kernels read them four at a time.
    texels.resize(texels.len().next_multiple_of(4), 0);
    let buffer = |what: &'static str, contents: &[u8]| {
        let (bytes, limit) = (contents.len() as u64, binding_limit(gpu));
        if bytes > limit {
            return Err(BackendError::SceneTooLarge { what, bytes, limit, adapter: gpu.info.name.clone() });
        }
        // A binding may not be empty; nothing reads what fills it.
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
