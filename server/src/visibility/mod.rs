//! Which lights reach which pixels.
//!
//! # The rules that every back end follows
//!
//! 1. **Surface point.** A pixel's ray (`gnomon_scene::camera::RayBasis`) hits the nearest OPAQUE or MASK triangle. It
//!    passes through back faces of single-sided materials. It hits a MASK triangle where the bilinear sample of the
//!    full-size alpha picture, times the factor, is at least the cutoff. It ignores BLEND triangles, and triangles
//!    whose plane contains the camera within rounding error.
//! 2. **Normals.** The geometric normal is that of the triangle's plane, turned towards the camera. The shading normal
//!    is interpolated from the vertices, and negated where the ray hit the back face.
//! 3. **Relevance.** A light is relevant at the point if it is switched on (nonzero intensity, colour not black), the
//!    shading normal faces it, and the point lies within its range and outer cone. Other lights' bits are 0.
//! 4. **Facing.** Where the geometric normal faces away from a relevant light, the surface shadows itself: bit 0, no
//!    ray. The normal faces the light if the light's height above the shadow ray's start exceeds the rounding error (5
//!    rounding units of the way to the light). So a light in a surface's own plane does not speckle it.
//! 5. **Shadow ray.** It starts at the point, interpolated from the vertices and pushed along the geometric normal by a
//!    proven bound on how far interpolation moved it off the plane: 16 rounding units of the summed magnitudes (the
//!    idea of Wächter and Binder, Ray Tracing Gems, ch. 6, whose 256 is a rule of thumb). It ends at the light, or
//!    beyond the scene for a directional light. Any OPAQUE triangle stops it, from either side, as does any MASK
//!    triangle that passes the alpha test. A triangle does not stop it if the start or the light lies in the triangle's
//!    plane within rounding error: 6 rounding units of the distance's terms, with a plane normal computed in f64. So a
//!    lamp on a surface lights its surroundings, on both sides of a zero-thickness surface. The bit is 1 if nothing
//!    stops the ray.

pub mod backend;
pub mod engine;
pub mod hierarchy;
pub mod schedule;
#[cfg(test)]
pub(crate) mod test_scenes;

use std::time::{Duration, Instant};

use gnomon_protocol::{ids::FrameNumber, mask::Mask, pose::Pose};
use gnomon_scene::{SceneAt, camera::Camera};

#[derive(Debug, Clone)]
pub struct TraceRequest {
    pub frame: FrameNumber,
    /// The view, and the size of the mask.
    pub camera: Camera,
    /// Which state of the scene: where to find what moves, and what was edited.
    pub scene: SceneAt,
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
    /// Time to move what moves, in milliseconds: on the processor, during which the engine submits nothing.
    pub pose_ms: f64,
    /// Device time to find surface points, in milliseconds.
    pub primary_ms: f64,
    /// Device time of shadow rays, in milliseconds.
    pub shadow_ms: f64,
    /// Time from the end of tracing until the bits are in host memory, in milliseconds; 0 on the CPU.
    pub readback_ms: f64,
    pub primary_rays: u64,
    /// Primary rays that were tested against the triangles that their block of pixels shares. The others were traced.
    pub primary_listed: u64,
    /// Shadow rays: relevant bits that the surface does not hide from itself.
    pub shadow_rays: u64,
    /// How the bits of these rays were found.
    pub shares: RayShares,
}

/// How the bits of shadow rays were found. The numbers sum to [`TraceCost::shadow_rays`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RayShares {
    /// No triangle lies between their block of pixels and the light.
    pub proven_lit: u64,
    /// One triangle hides the light from their block of pixels. Few of these were traced after all.
    pub proven_dark: u64,
    /// Tested against the triangles that their block of pixels shares.
    pub listed: u64,
    /// Traced one by one.
    pub traced: u64,
}

impl RayShares {
    /// Names of [`Self::counts`].
    pub const NAMES: [&str; 4] = ["proven_lit", "proven_dark", "listed", "traced"];

    #[must_use]
    pub fn counts(&self) -> [u64; 4] {
        let Self { proven_lit, proven_dark, listed, traced } = *self;
        [proven_lit, proven_dark, listed, traced]
    }

    fn plus(self, other: Self) -> Self {
        Self {
            proven_lit: self.proven_lit + other.proven_lit,
            proven_dark: self.proven_dark + other.proven_dark,
            listed: self.listed + other.listed,
            traced: self.traced + other.traced,
        }
    }
}

impl TraceCost {
    /// The sum of two parts of a mask.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            pose_ms: self.pose_ms + other.pose_ms,
            primary_ms: self.primary_ms + other.primary_ms,
            shadow_ms: self.shadow_ms + other.shadow_ms,
            readback_ms: self.readback_ms + other.readback_ms,
            primary_rays: self.primary_rays + other.primary_rays,
            primary_listed: self.primary_listed + other.primary_listed,
            shadow_rays: self.shadow_rays + other.shadow_rays,
            shares: self.shares.plus(other.shares),
        }
    }

    /// Device time in milliseconds, with that of moving what moves, which the engine's other work waits for.
    #[must_use]
    pub fn device_ms(&self) -> f64 {
        self.pose_ms + self.rays_ms()
    }

    /// Device time of all rays in milliseconds.
    #[must_use]
    pub fn rays_ms(&self) -> f64 {
        self.primary_ms + self.shadow_ms
    }
}
