//! One adapter, one device: chosen the same way at both ends, and never software by accident.

use std::sync::OnceLock;

use thiserror::Error;

/// Which adapter to take.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct GpuOptions {
    /// Part of the adapter's name, in any case; `None` takes the first real GPU, or else the first adapter.
    pub adapter: Option<String>,
    /// Features to ask for where the adapter has them.
    pub wanted: wgpu::Features,
    /// Whether a software adapter will do.
    pub allow_software: bool,
}

/// A device, its queue, and what it is.
#[derive(Debug, Clone)]
pub struct Gpu {
    /// Name, driver and kind of the adapter.
    pub info: wgpu::AdapterInfo,
    /// The device, with the adapter's own limits.
    pub device: wgpu::Device,
    /// The device's queue.
    pub queue: wgpu::Queue,
}

/// Why there is no device.
#[derive(Debug, Error)]
pub enum GpuError {
    /// No adapter fits.
    #[error(
        "no graphics adapter{}: found {}; install a Vulkan driver (Debian: libvulkan1 mesa-vulkan-drivers)",
        wanted.as_ref().map(|name| format!(" named {name:?}")).unwrap_or_default(),
        if found.is_empty() { "none".to_owned() } else { found.join(", ") }
    )]
    NoAdapter {
        /// The name asked for.
        wanted: Option<String>,
        /// The adapters that there are.
        found: Vec<String>,
    },
    /// Only a software adapter fits, and it was not allowed.
    #[error("only the software adapter {0:?} is there: allow it with --allow-software, or mend the GPU's driver")]
    SoftwareOnly(String),
    /// The adapter gives no device.
    #[error("adapter {name:?} gives no device: {reason}")]
    Device {
        /// The adapter's name.
        name: String,
        /// The driver's reason.
        reason: wgpu::RequestDeviceError,
    },
}

impl Gpu {
    /// Opens the adapter that `options` ask for, with all of its limits.
    ///
    /// # Errors
    /// When no adapter fits, only a disallowed software adapter does, or the driver refuses a device.
    pub async fn open(options: &GpuOptions) -> Result<Self, GpuError> {
        Self::from_adapters(drivers().enumerate_adapters(wgpu::Backends::PRIMARY).await, options).await
    }

    /// As [`Self::open`], of the given adapters.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub async fn from_adapters(adapters: Vec<wgpu::Adapter>, options: &GpuOptions) -> Result<Self, GpuError> {
        let found = adapters.iter().map(|adapter| adapter.get_info().name).collect();
        let wanted = options.adapter.as_ref().map(|name| name.to_lowercase());
        let adapter = adapters
            .into_iter()
            .filter(|adapter| {
                wanted.as_ref().is_none_or(|name| adapter.get_info().name.to_lowercase().contains(name.as_str()))
            })
            .min_by_key(|adapter| match adapter.get_info().device_type {
                wgpu::DeviceType::DiscreteGpu => 0,
                wgpu::DeviceType::IntegratedGpu => 1,
                wgpu::DeviceType::VirtualGpu => 2,
                wgpu::DeviceType::Other => 3,
                wgpu::DeviceType::Cpu => 4,
            })
            .ok_or(GpuError::NoAdapter { wanted: options.adapter.clone(), found })?;
        let info = adapter.get_info();
        if info.device_type == wgpu::DeviceType::Cpu && !options.allow_software {
            return Err(GpuError::SoftwareOnly(info.name));
        }
        let required_features = adapter.features() & options.wanted;
        let (device, queue) = adapter
            .request_device(&wgpu::DeviceDescriptor {
                label: Some("gnomon"),
                required_features,
                required_limits: adapter.limits(),
                experimental_features: experimental(required_features),
                ..wgpu::DeviceDescriptor::default()
            })
            .await
            .map_err(|reason| GpuError::Device { name: info.name.clone(), reason })?;
        Ok(Self { info, device, queue })
    }

    /// Whether a CPU pretends to be the adapter.
    #[must_use]
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }
}

/// The drivers of this process. They are loaded once: a process that has loaded and left a driver often enough is not let in
/// again (seen with NVIDIA's, after some dozens of times), and devices are opened anew whenever one was lost.
fn drivers() -> &'static wgpu::Instance {
    static DRIVERS: OnceLock<wgpu::Instance> = OnceLock::new();
    DRIVERS.get_or_init(|| {
        wgpu::Instance::new(wgpu::InstanceDescriptor {
            backends: wgpu::Backends::PRIMARY,
            ..wgpu::InstanceDescriptor::new_without_display_handle_from_env()
        })
    })
}

/// The consent that wgpu wants before it enables an experimental feature.
fn experimental(features: wgpu::Features) -> wgpu::ExperimentalFeatures {
    if !features.intersects(wgpu::Features::all_experimental_mask()) {
        return wgpu::ExperimentalFeatures::disabled();
    }
    // SAFETY: wgpu asks its users to know that experimental features may have bugs that its checks do not catch. They are
    // only ever asked for by the ray-query back end, whose kernels and structures are ours and never a peer's.
    #[expect(unsafe_code, reason = "the only way to ray queries")]
    unsafe {
        wgpu::ExperimentalFeatures::enabled()
    }
}
