//! Host types that the tracing kernels read. Their twins are in `wgsl/shared/traced_scene.wgsl`.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use gnomon_scene::{Light, LightKind, Wrap, camera::RayBasis};

/// Entries of the kernels' traversal stacks, which also bounds a hierarchy's depth.
pub const TRAVERSAL_STACK: u32 = 32;

/// Set in [`TracedTriangle::kind`] if camera rays pass through the back face.
pub const TRIANGLE_SINGLE_SIDED: u32 = 1 << 31;

/// One frame's camera, and the size of its mask and scene.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TracedView {
    /// The camera's position in local space, in metres.
    pub origin: [f32; 3],
    /// Width of the picture, in pixels.
    pub width: u32,
    /// Unit vector along the view.
    pub forward: [f32; 3],
    /// Height of the picture, in pixels.
    pub height: u32,
    /// Half the picture's width on the plane at distance 1.
    pub right: [f32; 3],
    /// Number of lights, which is the number of planes in the mask.
    pub lights: u32,
    /// Half the picture's height on the plane at distance 1.
    pub up: [f32; 3],
    /// Nodes of our hierarchy, or triangles if the adapter has its own; 0 if nothing stops rays.
    pub nodes: u32,
    /// First row of tiles in this part of the frame.
    pub first_row: u32,
    /// The row after its last.
    pub end_row: u32,
    /// Where the hierarchy begins: a node; or, if the adapter has its own, the first triangle of those that move.
    pub root: u32,
    /// The first light of the frame's time.
    pub first_light: u32,
}

impl TracedView {
    /// Size in bytes, which every device offers as immediate data.
    pub const BYTES: u32 = 80;

    /// Returns the view of a whole picture of `width`×`height` pixels, of a scene in which everything rests.
    #[must_use]
    pub fn new(basis: &RayBasis, width: u32, height: u32, lights: u32, nodes: u32) -> Self {
        Self {
            origin: basis.origin.to_array(),
            width,
            forward: basis.forward.to_array(),
            height,
            right: basis.right.to_array(),
            lights,
            up: basis.up.to_array(),
            nodes,
            first_row: 0,
            end_row: height.div_ceil(8),
            root: 0,
            first_light: 0,
        }
    }
}

/// What the kernels count of a whole frame. Twin: `wgsl/visibility/counts.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable)]
#[repr(C)]
pub struct TracedCounts {
    /// Shadow rays. The next three count some of them where blocks of pixels share lists of triangles.
    pub rays: u32,
    /// Rays that no triangle may stop.
    pub proven_lit: u32,
    /// Rays of blocks that one triangle covers.
    pub proven_dark: u32,
    /// Rays tested against a list.
    pub listed: u32,
    /// Where the next list begins.
    lists_end: u32,
    /// Primary rays tested against a list.
    pub primary_listed: u32,
    /// Blocks in the queue, of primary rays and of shadow rays.
    queued: [u32; 4],
}

/// What decides a light's relevance and the end of its shadow rays.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TracedLight {
    /// Position in local space, in metres; unused for directional lights.
    pub position: [f32; 3],
    /// 0 directional, 1 point, 2 spot.
    pub kind: u32,
    /// Unit vector in which the light travels; unused for point lights.
    pub direction: [f32; 3],
    /// Cosine of the outer cone's angle.
    pub cos_outer: f32,
    /// Square of the range, in square metres; the largest f32 without a range.
    pub range_squared: f32,
    unused_0: f32,
    unused_1: f32,
    unused_2: f32,
}

impl TracedLight {
    /// Returns the light for the kernels. When switched off, it reaches no point, and no normal faces it.
    #[must_use]
    pub fn new(light: &Light) -> Self {
        let (kind, cos_outer) = match light.kind {
            LightKind::Directional => (0, -1.0),
            LightKind::Point => (1, -1.0),
            LightKind::Spot { outer_cone_rad, .. } => (2, outer_cone_rad.cos()),
        };
        let (direction, range_squared) = if light.shines() {
            (light.direction, (light.range_m * light.range_m).min(f32::MAX))
        } else {
            (Vec3::ZERO, -1.0)
        };
        Self {
            position: light.position.to_array(),
            kind,
            direction: direction.to_array(),
            cos_outer,
            range_squared,
            unused_0: 0.0,
            unused_1: 0.0,
            unused_2: 0.0,
        }
    }
}

/// A MASK material whose alpha varies.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct AlphaMaterial {
    /// Index of the picture's first texel; texels are bytes.
    pub first_texel: u32,
    /// Width of the picture, in texels; 0 without one.
    pub width: u32,
    /// Height of the picture, in texels.
    pub height: u32,
    /// How texture coordinates outside 0 to 1 wrap: see [`wraps`].
    pub wraps: u32,
    /// A point stops rays if its texel times `factor`, times the vertices' alpha, is at least this.
    pub cutoff: f32,
    pub factor: f32,
    /// 1 if the alpha of vertices counts. It then follows a triangle's texture coordinates.
    pub vertex_alpha: u32,
    unused_0: u32,
}

impl AlphaMaterial {
    /// Returns a material without a picture.
    #[must_use]
    pub fn new(cutoff: f32, factor: f32, vertex_alpha: bool) -> Self {
        let vertex_alpha = vertex_alpha.into();
        Self { first_texel: 0, width: 0, height: 0, wraps: 0, cutoff, factor, vertex_alpha, unused_0: 0 }
    }

    /// Adds a picture, whose `size` is its width and height in texels.
    #[must_use]
    pub fn with_picture(self, first_texel: u32, (width, height): (u32, u32), wraps: u32) -> Self {
        Self { first_texel, width, height, wraps, ..self }
    }
}

/// The number of a wrap mode in the shaders (`shared/texels.wgsl`).
#[must_use]
pub fn wrap(wrap: Wrap) -> u32 {
    match wrap {
        Wrap::Repeat => 0,
        Wrap::MirroredRepeat => 1,
        Wrap::ClampToEdge => 2,
    }
}

/// Packs two wrap modes into one number: u in the low half, v in the high half.
#[must_use]
pub fn wraps(u: Wrap, v: Wrap) -> u32 {
    wrap(u) | wrap(v) << 16
}

/// A triangle. Triangles are in the order of the hierarchy's leaves.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TracedTriangle {
    /// First corner, in metres.
    pub a: [f32; 3],
    /// [`TRIANGLE_SINGLE_SIDED`], and one more than the index of its alpha material, or 0 without holes.
    pub kind: u32,
    /// Second corner, in metres.
    pub b: [f32; 3],
    /// Index of the first of its texture coordinates, for a triangle with holes.
    pub first_uv: u32,
    /// Third corner, in metres.
    pub c: [f32; 3],
    pub unused: u32,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lights_without_a_range_reach_everywhere() {
        let light = Light {
            name: String::new(),
            kind: LightKind::Spot { inner_cone_rad: 0.0, outer_cone_rad: std::f32::consts::FRAC_PI_3 },
            position: Vec3::X,
            direction: Vec3::NEG_Y,
            color: Vec3::ONE,
            intensity: 1.0,
            range_m: f32::INFINITY,
        };
        let traced = TracedLight::new(&light);
        assert_eq!((traced.kind, traced.range_squared), (2, f32::MAX));
        assert!((traced.cos_outer - 0.5).abs() < 1e-6);
    }
}
