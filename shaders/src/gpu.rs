//! One adapter, one device: chosen the same way at both ends, and never software by accident.

use std::sync::OnceLock;

use thiserror::Error;

/// Which adapter to take.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct GpuOptions {
    /// Part of the adapter's name, in any case; `None` takes the first real GPU, or else the first adapter. `#2` at its end is the
    /// second of those that fit, best first.
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
        let (name, place) = named(options.adapter.as_deref());
        let adapter = fitting(adapters, name)
            .into_iter()
            .nth(place)
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

    /// How many real GPUs there are, of the best kind that there is, whose name has this in it.
    #[must_use]
    pub async fn count(name: Option<&str>) -> usize {
        let all = drivers().enumerate_adapters(wgpu::Backends::PRIMARY).await;
        let kinds: Vec<_> = fitting(all, named(name).0).iter().map(|adapter| rank(&adapter.get_info())).collect();
        let best = kinds.first().copied().unwrap_or(SOFTWARE);
        if best == SOFTWARE { 0 } else { kinds.iter().filter(|kind| **kind == best).count() }
    }

    /// Whether a CPU pretends to be the adapter.
    #[must_use]
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }
}

/// The rank of software that pretends to be an adapter.
const SOFTWARE: u8 = 4;

/// Real GPUs first.
fn rank(info: &wgpu::AdapterInfo) -> u8 {
    match info.device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => SOFTWARE,
    }
}

/// The adapters whose name has this in it, best first; equals keep the order of the drivers.
fn fitting(mut adapters: Vec<wgpu::Adapter>, name: &str) -> Vec<wgpu::Adapter> {
    adapters.retain(|adapter| adapter.get_info().name.to_lowercase().contains(&name.to_lowercase()));
    adapters.sort_by_key(|adapter| rank(&adapter.get_info()));
    adapters
}

/// A name and the place, from 0, in `NAME#PLACE`, which counts from 1.
fn named(wanted: Option<&str>) -> (&str, usize) {
    let wanted = wanted.unwrap_or_default();
    match wanted.rsplit_once('#').map(|(name, place)| (name, place.parse::<usize>())) {
        Some((name, Ok(place @ 1..))) => (name, place - 1),
        _ => (wanted, 0),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_adapter_is_named_by_a_part_of_its_name_and_its_place() {
        for (wanted, expected) in [
            (None, ("", 0)),
            (Some("H100"), ("H100", 0)),
            (Some("H100#2"), ("H100", 1)),
            (Some("#3"), ("", 2)),
            (Some("odd#name"), ("odd#name", 0)),
            (Some("a#0"), ("a#0", 0)),
        ] {
            assert_eq!(named(wanted), expected, "{wanted:?}");
        }
    }
}
