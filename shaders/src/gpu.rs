//! Opens an adapter's device. Both ends choose it the same way, and use software only if allowed.

use std::sync::OnceLock;

use thiserror::Error;

use crate::uniforms::Uniforms;

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct GpuOptions {
    /// Part of the adapter's name, in any case. `#2` at the end takes the second match, best first. `None` takes the
    /// first real GPU, or else the first adapter.
    pub adapter: Option<String>,
    /// Features to enable where the adapter has them.
    pub wanted: wgpu::Features,
    pub allow_software: bool,
}

#[derive(Debug, Clone)]
pub struct Gpu {
    /// Name, driver and kind of the adapter.
    pub info: wgpu::AdapterInfo,
    /// The device, with the adapter's full limits.
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
}

/// Why there is no device.
#[derive(Debug, Error)]
pub enum GpuError {
    #[error(
        "no graphics adapter{}: found {}; install a Vulkan driver (Debian: libvulkan1 mesa-vulkan-drivers)",
        wanted.as_ref().map(|name| format!(" named {name:?}")).unwrap_or_default(),
        if found.is_empty() { "none".to_owned() } else { found.join(", ") }
    )]
    NoAdapter { wanted: Option<String>, found: Vec<String> },
    /// Only a software adapter matches, and it is not allowed.
    #[error("the only matching adapter is software ({0:?}): allow it with --allow-software, or fix the GPU's driver")]
    SoftwareOnly(String),
    #[error("adapter {name:?} cannot open a device: {reason}")]
    Device { name: String, reason: wgpu::RequestDeviceError },
}

impl Gpu {
    /// Opens the adapter that `options` describe, with its full limits.
    ///
    /// # Errors
    /// Errors if no adapter matches, only a disallowed software adapter does, or the driver refuses a device.
    pub async fn open(options: &GpuOptions) -> Result<Self, GpuError> {
        Self::from_adapters(drivers().enumerate_adapters(wgpu::Backends::PRIMARY).await, options).await
    }

    /// As [`Self::open`], from these adapters.
    ///
    /// # Errors
    /// Those of [`Self::open`].
    pub async fn from_adapters(adapters: Vec<wgpu::Adapter>, options: &GpuOptions) -> Result<Self, GpuError> {
        let found = adapters.iter().map(|adapter| adapter.get_info().name).collect();
        let (name, place) = parse_name(options.adapter.as_deref());
        let adapter = matching(adapters, name)
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

    /// Counts the real GPUs of the best kind whose name contains `name`.
    #[must_use]
    pub async fn count(name: Option<&str>) -> usize {
        let all = drivers().enumerate_adapters(wgpu::Backends::PRIMARY).await;
        let kinds: Vec<_> = matching(all, parse_name(name).0).iter().map(|adapter| rank(&adapter.get_info())).collect();
        let best = kinds.first().copied().unwrap_or(SOFTWARE);
        if best == SOFTWARE { 0 } else { kinds.iter().filter(|kind| **kind == best).count() }
    }

    /// Returns whether the adapter is emulated on the CPU.
    #[must_use]
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }

    /// Where the shading shaders read their uniforms on this adapter.
    #[must_use]
    pub fn uniforms(&self) -> Uniforms {
        Uniforms::of(self.info.device_type)
    }
}

/// The rank of software adapters.
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

/// Returns the adapters whose name contains `name`, best first. Equals keep the drivers' order.
fn matching(mut adapters: Vec<wgpu::Adapter>, name: &str) -> Vec<wgpu::Adapter> {
    adapters.retain(|adapter| adapter.get_info().name.to_lowercase().contains(&name.to_lowercase()));
    adapters.sort_by_key(|adapter| rank(&adapter.get_info()));
    adapters
}

/// Splits `NAME#PLACE`, counted from 1, into the name and the place counted from 0.
fn parse_name(wanted: Option<&str>) -> (&str, usize) {
    let wanted = wanted.unwrap_or_default();
    match wanted.rsplit_once('#').map(|(name, place)| (name, place.parse::<usize>())) {
        Some((name, Ok(place @ 1..))) => (name, place - 1),
        _ => (wanted, 0),
    }
}

/// The drivers of this process, loaded once. Lost devices are reopened, and a process that loads a driver some dozens
/// of times is refused (seen with NVIDIA's).
fn drivers() -> &'static wgpu::Instance {
    static DRIVERS: OnceLock<wgpu::Instance> = OnceLock::new();
    DRIVERS.get_or_init(|| {
        wgpu::Instance::new(wgpu::InstanceDescriptor {
            backends: wgpu::Backends::PRIMARY,
            ..wgpu::InstanceDescriptor::new_without_display_handle_from_env()
        })
    })
}

/// The consent that wgpu requires for experimental features.
fn experimental(features: wgpu::Features) -> wgpu::ExperimentalFeatures {
    if !features.intersects(wgpu::Features::all_experimental_mask()) {
        return wgpu::ExperimentalFeatures::disabled();
    }
    // SAFETY: wgpu warns that its checks may miss bugs in experimental features. Only the ray-query back end enables
    // them, and its kernels and structures are ours, never a peer's.
    #[expect(unsafe_code, reason = "the only way to ray queries")]
    unsafe {
        wgpu::ExperimentalFeatures::enabled()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn adapter_names_may_end_in_a_place() {
        for (wanted, expected) in [
            (None, ("", 0)),
            (Some("H100"), ("H100", 0)),
            (Some("H100#2"), ("H100", 1)),
            (Some("#3"), ("", 2)),
            (Some("odd#name"), ("odd#name", 0)),
            (Some("a#0"), ("a#0", 0)),
        ] {
            assert_eq!(parse_name(wanted), expected, "{wanted:?}");
        }
    }
}
