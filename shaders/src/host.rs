//! The tracing kernels' types, as the host writes them: `wgsl/shared/traced_scene.wgsl` has their twins.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use gnomon_scene::{Light, LightKind, Wrap, camera::RayBasis};

/// Entries of the kernels' traversal stacks, and so the levels of the deepest hierarchy that they can follow.
pub const TRAVERSAL_STACK: u32 = 32;

/// [`TracedTriangle::kind`] of a triangle whose back face is not seen.
pub const TRIANGLE_SINGLE_SIDED: u32 = 1 << 31;

/// One frame's camera, and how much there is to trace.
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
    /// Lights, and so planes of the mask.
    pub lights: u32,
    /// Half the picture's height on the plane at distance 1.
    pub up: [f32; 3],
    /// Nodes of the bounding volume hierarchy, or triangles where the adapter walks its own; 0 when nothing stops a ray.
    pub nodes: u32,
    /// Row of tiles at which this part of the frame begins.
    pub first_row: u32,
    unused: [u32; 3],
}

impl TracedView {
    /// Its size in bytes, which every device offers as immediate data.
    pub const BYTES: u32 = 80;

    /// The view of a camera with this basis, whose picture has `width`×`height` pixels.
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
            unused: [0; 3],
        }
    }
}

/// What decides about a light's relevance, and where its shadow rays end.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TracedLight {
    /// Position in local space, in metres; for directional lights not used.
    pub position: [f32; 3],
    /// 0 directional, 1 point, 2 spot.
    pub kind: u32,
    /// Unit vector in which the light travels; for point lights not used.
    pub direction: [f32; 3],
    /// Cosine of the outer cone's angle.
    pub cos_outer: f32,
    /// Square of the range, in square metres; the largest f32 when there is none.
    pub range_squared: f32,
    unused_0: f32,
    unused_1: f32,
    unused_2: f32,
}

impl TracedLight {
    /// What the kernels need of a light. One that is switched off reaches no place and no normal faces it.
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

/// A MASK material whose alpha differs from place to place.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct AlphaMaterial {
    /// Index of the picture's first texel; texels are bytes.
    pub first_texel: u32,
    /// Width of the picture, in texels.
    pub width: u32,
    /// Height of the picture, in texels.
    pub height: u32,
    /// What happens outside 0 to 1, from [`wraps`].
    pub wraps: u32,
    /// A point is there when its texel times the factor is at least this.
    pub cutoff: f32,
    /// See there.
    pub factor: f32,
    unused_0: u32,
    unused_1: u32,
}

impl AlphaMaterial {
    /// A material with a picture of `size` texels, of which the first is number `first_texel`.
    #[must_use]
    pub fn new(first_texel: u32, size: (u32, u32), wraps: u32, cutoff: f32, factor: f32) -> Self {
        let (width, height) = size;
        Self { first_texel, width, height, wraps, cutoff, factor, unused_0: 0, unused_1: 0 }
    }
}

/// A wrap as the shaders number them (`shared/texels.wgsl`).
#[must_use]
pub fn wrap(wrap: Wrap) -> u32 {
    match wrap {
        Wrap::Repeat => 0,
        Wrap::MirroredRepeat => 1,
        Wrap::ClampToEdge => 2,
    }
}

/// Two wraps in one number: u in the low half, v in the high half.
#[must_use]
pub fn wraps(u: Wrap, v: Wrap) -> u32 {
    wrap(u) | wrap(v) << 16
}

/// A triangle, at the place that the hierarchy gives it.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TracedTriangle {
    /// First corner, in metres.
    pub a: [f32; 3],
    /// [`TRIANGLE_SINGLE_SIDED`], and one more than the index of its alpha material, or 0 if it has no holes.
    pub kind: u32,
    /// Second corner, in metres.
    pub b: [f32; 3],
    /// Index of the first of its three texture coordinates, if it has holes.
    pub first_uv: u32,
    /// Third corner, in metres.
    pub c: [f32; 3],
    /// Fills the last word.
    pub unused: u32,
}

#[cfg(test)]
mod tests {
    use std::mem::{offset_of, size_of};

    use super::*;
    use crate::splice::{FILES, splice, splice_ray_query};

    fn module(path: &str) -> naga::Module {
        let text = splice(path).unwrap();
        naga::front::wgsl::parse_str(&text)
            .unwrap_or_else(|error| panic!("{}", error.emit_to_string_with_path(&text, path)))
    }

    /// Names and offsets of the members of a WGSL struct, and its size.
    fn layout(module: &naga::Module, name: &str) -> (Vec<(String, usize)>, usize) {
        let (_, ty) = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name)).unwrap();
        let naga::TypeInner::Struct { members, span } = &ty.inner else { panic!("{name} is no struct") };
        (members.iter().map(|m| (m.name.clone().unwrap(), m.offset as usize)).collect(), *span as usize)
    }

    macro_rules! assert_layout {
        ($module:expr, $host:ident, [$($field:ident),+]) => {
            let host = vec![$((stringify!($field).to_owned(), offset_of!($host, $field))),+];
            assert_eq!(layout($module, stringify!($host)), (host, size_of::<$host>()));
        };
    }

    #[test]
    fn host_types_lie_as_wgsl_lays_them() {
        let primary = module("visibility/primary.wgsl");
        assert_layout!(&primary, TracedView, [origin, width, forward, height, right, lights, up, nodes, first_row]);
        assert_eq!(size_of::<TracedView>(), TracedView::BYTES as usize);
        assert_layout!(
            &primary,
            TracedLight,
            [position, kind, direction, cos_outer, range_squared, unused_0, unused_1, unused_2]
        );
        assert_layout!(
            &primary,
            AlphaMaterial,
            [first_texel, width, height, wraps, cutoff, factor, unused_0, unused_1]
        );
        // The kernels read triangles as vec4u: three of them, and their w's are these fields.
        assert_eq!(size_of::<TracedTriangle>(), 48);
        assert_eq!((offset_of!(TracedTriangle, kind), offset_of!(TracedTriangle, first_uv)), (12, 28));
    }

    #[test]
    fn numbers_that_both_sides_name_are_equal() {
        let primary = module("visibility/primary.wgsl");
        let constant = |name: &str| {
            let (_, constant) = primary.constants.iter().find(|(_, c)| c.name.as_deref() == Some(name)).unwrap();
            match primary.global_expressions[constant.init] {
                naga::Expression::Literal(naga::Literal::U32(value)) => value,
                ref other => panic!("{name} is {other:?}"),
            }
        };
        assert_eq!(constant("TRAVERSAL_STACK"), TRAVERSAL_STACK);
        assert_eq!(constant("TRIANGLE_SINGLE_SIDED"), TRIANGLE_SINGLE_SIDED);
        assert_eq!(constant("TRIANGLE_ALPHA"), !TRIANGLE_SINGLE_SIDED);
    }

    #[test]
    fn every_kernel_and_every_shader_is_valid() {
        // A file without an entry point of its own is only imported, and validated in its importers.
        let mut checked = Vec::new();
        for (path, text) in FILES {
            if !["@compute", "@vertex", "@fragment"].iter().any(|stage| text.contains(stage)) {
                continue;
            }
            naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::IMMEDIATES)
                .validate(&module(path))
                .unwrap_or_else(|error| {
                    panic!("{path}: {}", error.emit_to_string_with_path(&splice(path).unwrap(), path))
                });
            checked.push(*path);
        }
        for path in ["visibility/primary.wgsl", "visibility/shadow.wgsl"] {
            let text = splice_ray_query(path).unwrap();
            let module = naga::front::wgsl::parse_str(&text)
                .unwrap_or_else(|error| panic!("{}", error.emit_to_string_with_path(&text, path)));
            let capabilities = naga::valid::Capabilities::IMMEDIATES | naga::valid::Capabilities::RAY_QUERY;
            naga::valid::Validator::new(naga::valid::ValidationFlags::all(), capabilities)
                .validate(&module)
                .unwrap_or_else(|error| panic!("{path}: {}", error.emit_to_string_with_path(&text, path)));
            assert!(text.contains("rayQueryProceed") && !text.contains("node_hits"), "{path} walks our hierarchy");
        }
        assert!(checked.contains(&"visibility/primary.wgsl") && checked.contains(&"visibility/shadow.wgsl"));
    }

    #[test]
    fn every_file_of_the_folder_is_compiled_in() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("wgsl");
        let mut found = Vec::new();
        for group in std::fs::read_dir(&folder).unwrap() {
            for file in std::fs::read_dir(group.unwrap().path()).unwrap() {
                let path = file.unwrap().path();
                let name = path.strip_prefix(&folder).unwrap().to_str().unwrap().to_owned();
                let text = std::fs::read_to_string(&path).unwrap();
                assert!(FILES.contains(&(name.as_str(), text.as_str())), "{name} is missing in splice::FILES");
                found.push(name);
            }
        }
        assert_eq!(found.len(), FILES.len());
    }

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
