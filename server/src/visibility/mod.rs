//! Which lights reach which pixels.
//!
//! # The rules that every back end follows
//!
//! 1. **Surface point.** A pixel's ray (`gnomon_scene::camera::RayBasis`) meets the nearest OPAQUE or MASK triangle.
//!    Back faces of single-sided materials are passed through. A MASK point is there when the bilinear sample of the
//!    full-size alpha picture, times the factor, is at least the cutoff. BLEND triangles are never met, nor is a
//!    triangle whose plane holds the camera as far as rounding can tell.
//! 2. **Normals.** The geometric normal is the triangle's plane's, turned towards the camera. The shading normal is
//!    interpolated from the vertices, and negated when the back face was met.
//! 3. **Relevance.** Light k matters at the point when it is not switched off (of no intensity, or black), the shading
//!    normal faces it, and the point lies within its range and inside its outer cone. Irrelevant bits are 0.
//! 4. **Facing.** Where the geometric normal faces away from a relevant light the surface hides it from itself: bit 0,
//!    no ray. It faces the light when that is above the shadow ray's start by more than rounding can account for (5
//!    rounding units of the way to the light), so that no light in a surface's own plane speckles it.
//! 5. **Shadow ray.** It starts at the point, interpolated from the vertices and pushed along the geometric normal by a
//!    proven bound on how far interpolation took it off the plane: 16 rounding units of the magnitudes that were summed
//!    (the idea of Wächter and Binder, Ray Tracing Gems, ch. 6, whose 256 are a rule of thumb). It ends at the light,
//!    or beyond the scene for a directional light. Any OPAQUE triangle, from either side, and any MASK triangle whose
//!    alpha is there, stops it, unless the start or the light lies on the triangle's plane as far as rounding can tell:
//!    6 rounding units of the distance's terms, with a plane normal computed in f64. So a lamp that sits on a surface
//!    lights what is around it, on both sides of a surface without thickness. Bit 1 when nothing stops it.

pub mod backend;
pub mod engine;
pub mod hierarchy;
pub mod schedule;
#[cfg(test)]
pub(crate) mod test_scenes;

use std::time::{Duration, Instant};

use gnomon_protocol::{ids::FrameNumber, mask::Mask, pose::Pose};
use gnomon_scene::camera::Camera;

#[derive(Debug, Clone, Copy)]
pub struct TraceRequest {
    pub frame: FrameNumber,
    /// The view, and the size of the mask.
    pub camera: Camera,
    /// The extrapolated pose of `camera`. `None`: it is the client's own pose of this frame.
    pub ahead: Option<Pose>,
    pub received_at: Instant,
    /// Recent time between the session's poses. The mask is due after it.
    pub interval: Duration,
}

/// A traced mask and its cost.
#[derive(Debug)]
pub struct TracedMask {
    pub frame: FrameNumber,
    pub mask: Mask,
    /// The extrapolated pose that it was traced for. `None`: it is the client's own pose of this frame.
    pub ahead: Option<Pose>,
    pub received_at: Instant,
    pub cost: TraceCost,
}

/// Cost of a mask: time by stage, and rays.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TraceCost {
    /// Device time to find surface points, in milliseconds.
    pub primary_ms: f64,
    /// Device time of shadow rays, in milliseconds.
    pub shadow_ms: f64,
    /// Time from the end of tracing until the bits are in host memory, in milliseconds; 0 on the CPU.
    pub readback_ms: f64,
    pub primary_rays: u64,
    /// Shadow rays: relevant bits that the surface does not hide from itself.
    pub shadow_rays: u64,
}

impl TraceCost {
    /// The sum of two parts of a mask.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            primary_ms: self.primary_ms + other.primary_ms,
            shadow_ms: self.shadow_ms + other.shadow_ms,
            readback_ms: self.readback_ms + other.readback_ms,
            primary_rays: self.primary_rays + other.primary_rays,
            shadow_rays: self.shadow_rays + other.shadow_rays,
        }
    }

    /// Device time in milliseconds.
    #[must_use]
    pub fn device_ms(&self) -> f64 {
        self.primary_ms + self.shadow_ms
    }
}
