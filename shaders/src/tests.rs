//! The WGSL files: all compiled in, all valid, and with the layout of the host types.

use std::mem::{offset_of, size_of};

use naga::valid::{Capabilities, ValidationFlags, Validator};
use wgpu::DeviceType;

use crate::{
    host::{
        AlphaMaterial, TRAVERSAL_STACK, TRIANGLE_SINGLE_SIDED, TracedCounts, TracedLight, TracedTriangle, TracedView,
    },
    material::{Finish, Material, TextureMap, features},
    shading::{Before, Light, Lighting, MaskLayer, Prediction, ShadowView, Tone, View},
    splice::{FILES, splice, splice_for, splice_ray_query, splice_subgroups},
    uniforms::Uniforms,
};

/// What every adapter has that browsers may use: halves of words as small floats are a part of WGSL.
const WEB_GPU: Capabilities = Capabilities::SHADER_FLOAT16_IN_FLOAT32;

/// Parses and validates a spliced text.
fn valid(path: &str, text: &str, capabilities: Capabilities) -> naga::Module {
    let module = naga::front::wgsl::parse_str(text)
        .unwrap_or_else(|error| panic!("{}", error.emit_to_string_with_path(text, path)));
    Validator::new(ValidationFlags::all(), capabilities)
        .validate(&module)
        .unwrap_or_else(|error| panic!("{}", error.emit_to_string_with_path(text, path)));
    module
}

fn module(path: &str) -> naga::Module {
    // Only the server's kernels use immediate data, and only those that move things long words.
    let capabilities = match path {
        _ if path.starts_with("visibility/pose") => Capabilities::IMMEDIATES | Capabilities::SHADER_INT64,
        _ if path.starts_with("visibility/") => Capabilities::IMMEDIATES,
        _ => WEB_GPU,
    };
    valid(path, &splice(path).unwrap(), capabilities)
}

/// Returns the names and offsets of a WGSL struct's members, and its size.
fn layout(module: &naga::Module, name: &str) -> (Vec<(String, usize)>, usize) {
    let (_, ty) = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name)).unwrap();
    let naga::TypeInner::Struct { members, span } = &ty.inner else { panic!("{name} is no struct") };
    (members.iter().map(|m| (m.name.clone().unwrap(), m.offset as usize)).collect(), *span as usize)
}

/// Compares a host type with its twin. The twin may end in padding.
macro_rules! assert_layout {
    ($module:expr, $host:ident, [$($field:ident),+]) => {
        let (members, span) = layout(&$module, stringify!($host));
        let host = vec![$((stringify!($field).to_owned(), offset_of!($host, $field))),+];
        assert_eq!(members[..host.len()], host[..]);
        assert!(members[host.len()..].iter().all(|(name, _)| name.starts_with("unused")), "{members:?}");
        assert_eq!(span, size_of::<$host>());
    };
}

#[test]
fn host_types_have_the_layout_of_their_wgsl_twins() {
    let primary = module("visibility/primary.wgsl");
    assert_layout!(
        primary,
        TracedView,
        [origin, width, forward, height, right, lights, up, nodes, first_row, end_row, root, first_light]
    );
    assert_eq!(size_of::<TracedView>(), TracedView::BYTES as usize);
    assert_layout!(primary, TracedLight, [position, kind, direction, cos_outer, range_squared]);
    assert_layout!(primary, AlphaMaterial, [first_texel, width, height, wraps, cutoff, factor, vertex_alpha]);
    // The kernels read triangles as three vec4u; these fields are their w components.
    assert_eq!(size_of::<TracedTriangle>(), 48);
    assert_eq!((offset_of!(TracedTriangle, kind), offset_of!(TracedTriangle, first_uv)), (12, 28));

    let shade = module("shading/shade.wgsl");
    assert_layout!(shade, View, [clip_from_local, origin, near_m, forward, width, right, height, up, visibility_share]);
    assert_layout!(
        shade,
        Light,
        [position, kind, direction, inverse_range, intensity, cone_scale, cone_offset, shadow_view, closest_squared]
    );
    assert_layout!(
        shade,
        Lighting,
        [
            ambient_above,
            count,
            ambient_below,
            lit_from_px,
            zenith,
            sky_seen,
            horizon,
            sky_lit,
            lights,
            harmonics,
            mirrored
        ]
    );
    let predict = module("shading/predict.wgsl");
    assert_layout!(predict, Prediction, [layers, count, predictor, unknown, lights]);
    assert_layout!(predict, MaskLayer, [view, slot, same_view, whole, same_time]);
    assert_layout!(predict, Before, [x, y, z]);
    assert_layout!(predict, ShadowView, [clip_from_local, left, top, side, texel_m]);
    let gbuffer = module("shading/gbuffer.wgsl");
    assert_layout!(
        gbuffer,
        Material,
        [
            base_color,
            alpha_cutoff,
            index,
            wrap_u,
            wrap_v,
            emissive,
            metallic,
            roughness,
            normal_scale,
            occlusion_strength,
            coat,
            coat_roughness,
            coat_normal_scale,
            transmission,
            unused,
            maps
        ]
    );
    assert_layout!(gbuffer, TextureMap, [u, second, v]);
    assert_layout!(shade, Finish, [mirrored, strength, sheen, sheen_roughness, last]);
    assert_layout!(module("shading/tone.wgsl"), Tone, [contrast, shoulder, b, c]);
}

#[test]
fn constants_of_host_and_wgsl_are_equal() {
    let primary = module("visibility/primary.wgsl");
    let gbuffer = module("shading/gbuffer.wgsl");
    let constant_of = |module: &naga::Module, name: &str| {
        let (_, constant) = module.constants.iter().find(|(_, c)| c.name.as_deref() == Some(name)).unwrap();
        match module.global_expressions[constant.init] {
            naga::Expression::Literal(naga::Literal::U32(value)) => value,
            ref other => panic!("{name} is {other:?}"),
        }
    };
    let constant = |name| constant_of(&primary, name);
    assert_eq!(constant("TRAVERSAL_STACK"), TRAVERSAL_STACK);
    assert_eq!(constant("TRIANGLE_SINGLE_SIDED"), TRIANGLE_SINGLE_SIDED);
    assert_eq!(constant("TRIANGLE_ALPHA"), !TRIANGLE_SINGLE_SIDED);
    for (name, value) in [
        ("BASE_COLOR", features::BASE_COLOR),
        ("METALLIC_ROUGHNESS", features::METALLIC_ROUGHNESS),
        ("NORMAL", features::NORMAL),
        ("OCCLUSION", features::OCCLUSION),
        ("EMISSIVE", features::EMISSIVE),
        ("COAT", features::COAT),
        ("COAT_NORMAL", features::COAT_NORMAL),
        ("TINT", features::TINT),
        ("TRANSMISSION", features::TRANSMISSION),
        ("MAPPED", features::MAPPED),
        ("OCCLUSION_IN_RED", features::OCCLUSION_IN_RED),
        ("TANGENTS", features::TANGENTS),
        ("COLORS", features::COLORS),
        ("UNLIT", features::UNLIT),
    ] {
        assert_eq!(constant_of(&gbuffer, name), value, "{name}");
    }
}

/// Files without an entry point are validated in their importers.
fn with_entry_points() -> Vec<&'static str> {
    let has_one = |text: &str| ["@compute", "@vertex", "@fragment"].iter().any(|stage| text.contains(stage));
    FILES.into_iter().flatten().filter(|(_, text)| has_one(text)).map(|(path, _)| *path).collect()
}

#[test]
fn every_shader_is_valid() {
    let checked = with_entry_points();
    for path in &checked {
        module(path);
    }
    for path in ["visibility/primary.wgsl", "visibility/shadow.wgsl"] {
        assert!(checked.contains(&path), "{path} was not checked");
        let text = splice_ray_query(path).unwrap();
        valid(path, &text, Capabilities::IMMEDIATES | Capabilities::RAY_QUERY);
        assert!(text.contains("rayQueryProceed") && !text.contains("node_hits"), "{path} traverses our hierarchy");
    }
    for path in ["visibility/primary_lists.wgsl", "visibility/shadow_lists.wgsl"] {
        let text = splice_subgroups(path).unwrap();
        let module = valid(path, &text, Capabilities::IMMEDIATES | Capabilities::SUBGROUP);
        assert!(text.contains("subgroupBallot") && !text.contains("lane_bits"), "{path} has no subgroups");
        let named = |global: &naga::GlobalVariable| global.name.as_deref() == Some("counts");
        let counts = module.global_variables.iter().find(|(_, global)| named(global)).unwrap().1;
        assert_eq!(module.types[counts.ty].inner.size(module.to_ctx()) as usize, size_of::<TracedCounts>());
    }
    for name in
        ["gbuffer", "depth", "mask_words", "predict", "shade", "blend", "tone", "meter", "debug_view", "present"]
    {
        assert!(checked.contains(&format!("shading/{name}.wgsl").as_str()), "{name} was not checked");
    }
}

/// WebGPU's default `maxStorageBuffersPerShaderStage`.
const STORAGE_BUFFERS: usize = 8;

#[test]
fn software_adapters_read_no_uniform_buffer() {
    let globals = |module: &naga::Module, wanted: fn(naga::AddressSpace) -> bool| -> Vec<String> {
        let all = module.global_variables.iter().filter(|(_, global)| wanted(global.space));
        all.map(|(_, global)| global.name.clone().unwrap()).collect()
    };
    let is_uniform = |space| space == naga::AddressSpace::Uniform;
    let is_read_only = |space| space == naga::AddressSpace::Storage { access: naga::StorageAccess::LOAD };
    let is_storage = |space| matches!(space, naga::AddressSpace::Storage { .. });
    let mut moved = Vec::new();
    for path in with_entry_points().into_iter().filter(|path| path.starts_with("shading/")) {
        let [real, software] = [DeviceType::DiscreteGpu, DeviceType::Cpu]
            .map(|kind| valid(path, &splice_for(Uniforms::of(kind), path).unwrap(), WEB_GPU));
        assert_eq!(globals(&software, is_uniform), Vec::<String>::new(), "{path}");
        let (uniforms, read_only) = (globals(&real, is_uniform), globals(&software, is_read_only));
        assert!(uniforms.iter().all(|name| read_only.contains(name)), "{path}: {uniforms:?} {read_only:?}");
        assert!(globals(&software, is_storage).len() <= STORAGE_BUFFERS, "{path}");
        // The host writes the same bytes into both.
        let structs = real.types.iter().filter(|(_, ty)| matches!(ty.inner, naga::TypeInner::Struct { .. }));
        for name in structs.map(|(_, ty)| ty.name.as_deref().unwrap()) {
            assert_eq!(layout(&real, name), layout(&software, name), "{path}: {name}");
        }
        moved.extend(uniforms);
    }
    for name in ["view", "lighting", "material", "prediction", "clip_from_local", "size", "tone", "choice", "screen_px"]
    {
        assert!(moved.iter().any(|other| other == name), "{name} is no uniform buffer of a real GPU");
    }
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
            let compiled = FILES.into_iter().flatten().any(|file| *file == (name.as_str(), text.as_str()));
            assert!(compiled, "{name} is missing in splice::FILES");
            found.push(name);
        }
    }
    assert_eq!(found.len(), FILES.into_iter().flatten().count());
}
