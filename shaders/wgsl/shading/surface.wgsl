// A point of a drawn surface: what the material's factors, textures and vertices make of it.

#import "shading/material.wgsl"

// Which textures and vertex attributes the material has. What it lacks is compiled out. Twin: `material::features`.
override FEATURES: u32 = 0u;

const BASE_COLOR: u32 = 1u;
const METALLIC_ROUGHNESS: u32 = 2u;
const NORMAL: u32 = 4u;
const OCCLUSION: u32 = 8u;
const EMISSIVE: u32 = 16u;
const COAT: u32 = 32u;
const COAT_NORMAL: u32 = 64u;
// Colour and strength of what is mirrored, or colour and roughness of the sheen.
const TINT: u32 = 128u;
const TRANSMISSION: u32 = 256u;
// Some texture has coordinates of its own.
const MAPPED: u32 = 512u;
// Occlusion is in the red of the metallic-roughness texture.
const OCCLUSION_IN_RED: u32 = 1024u;
const TANGENTS: u32 = 2048u;
const COLORS: u32 = 4096u;
// Emits its base colour and answers no light.
const UNLIT: u32 = 8192u;

@group(1) @binding(3) var metallic_roughness_picture: texture_2d<f32>;
@group(1) @binding(4) var metallic_roughness_sampler: sampler;
@group(1) @binding(5) var normal_picture: texture_2d<f32>;
@group(1) @binding(6) var normal_sampler: sampler;
@group(1) @binding(7) var occlusion_picture: texture_2d<f32>;
@group(1) @binding(8) var occlusion_sampler: sampler;
@group(1) @binding(9) var emissive_picture: texture_2d<f32>;
@group(1) @binding(10) var emissive_sampler: sampler;
@group(1) @binding(11) var coat_picture: texture_2d<f32>;
@group(1) @binding(12) var coat_sampler: sampler;
@group(1) @binding(13) var coat_normal_picture: texture_2d<f32>;
@group(1) @binding(14) var coat_normal_sampler: sampler;
@group(1) @binding(15) var tint_picture: texture_2d<f32>;
@group(1) @binding(16) var tint_sampler: sampler;
@group(1) @binding(17) var transmission_picture: texture_2d<f32>;
@group(1) @binding(18) var transmission_sampler: sampler;

struct Vertex {
    @location(0) position: vec3f,
    // Unit vector; lean (`finish.wgsl`).
    @location(1) normal: vec4f,
    @location(2) uv: vec2f,
}

// What few materials need of a vertex.
struct MoreOfVertex {
    @location(3) uv_1: vec2f,
    // Unit vector and handedness, or zeros.
    @location(4) tangent: vec4f,
    @location(5) color: vec4f,
}

struct Varying {
    // As in `depth.wgsl`, to the last bit: depth is drawn first.
    @builtin(position) @invariant clip: vec4f,
    @location(0) normal: vec4f,
    @location(1) uv: vec2f,
    // Relative to the eye: small numbers, so that their differences stay precise.
    @location(2) from_eye: vec3f,
}

struct MoreVarying {
    @builtin(position) @invariant clip: vec4f,
    @location(0) normal: vec4f,
    @location(1) uvs: vec4f,
    @location(2) from_eye: vec3f,
    @location(3) tangent: vec4f,
    @location(4) color: vec4f,
}

// A vertex between others.
struct Point {
    normal: vec4f,
    uv: vec2f,
    from_eye: vec3f,
    uv_1: vec2f,
    tangent: vec4f,
    color: vec4f,
}

fn projected(vertex: Vertex, clip_from_local: mat4x4f, eye: vec3f) -> Varying {
    let clip = clip_from_local * vec4f(vertex.position, 1.0);
    return Varying(clip, vertex.normal, vertex.uv, vertex.position - eye);
}

fn projected_more(vertex: Vertex, more: MoreOfVertex, clip_from_local: mat4x4f, eye: vec3f) -> MoreVarying {
    let clip = clip_from_local * vec4f(vertex.position, 1.0);
    let uvs = vec4f(vertex.uv, more.uv_1);
    return MoreVarying(clip, vertex.normal, uvs, vertex.position - eye, more.tangent, more.color);
}

fn point_of(input: Varying) -> Point {
    return Point(input.normal, input.uv, input.from_eye, vec2f(0.0), vec4f(0.0), vec4f(1.0));
}

fn point_of_more(input: MoreVarying) -> Point {
    return Point(input.normal, input.uvs.xy, input.from_eye, input.uvs.zw, input.tangent, input.color);
}

fn has(feature: u32) -> bool {
    return (FEATURES & feature) != 0u;
}

// Texture coordinates, and their differences to the next pixels across and down.
struct Place {
    uv: vec2f,
    across: vec2f,
    down: vec2f,
}

// Where the texture with this map is read. Differences are taken before they are mapped: software adapters read zeros
// from a storage buffer beside a triangle's edge, and a difference to one would choose the smallest mip.
fn place_of(map: u32, input: Point) -> Place {
    if !has(MAPPED) {
        return Place(input.uv, dpdx(input.uv), dpdy(input.uv));
    }
    let second = material.maps[map].second == 1u;
    let u = material.maps[map].u;
    let v = material.maps[map].v;
    let uv = vec3f(select(input.uv, input.uv_1, second), 1.0);
    let across = select(dpdx(input.uv), dpdx(input.uv_1), second);
    let down = select(dpdy(input.uv), dpdy(input.uv_1), second);
    return Place(
        vec2f(dot(u, uv), dot(v, uv)),
        vec2f(dot(u.xy, across), dot(v.xy, across)),
        vec2f(dot(u.xy, down), dot(v.xy, down)),
    );
}

// A texture's value at the point, filtered.
fn texel(map: u32, read: texture_2d<f32>, read_by: sampler, input: Point) -> vec4f {
    if !has(MAPPED) {
        return textureSample(read, read_by, input.uv);
    }
    let place = place_of(map, input);
    return textureSampleGrad(read, read_by, place.uv, place.across, place.down);
}

// Linear base colour and alpha, filtered.
fn base_color(input: Point) -> vec4f {
    var color = material.base_color;
    if has(BASE_COLOR) {
        color *= textureSample(picture, picture_sampler, input.uv);
    }
    if has(COLORS) {
        color *= input.color;
    }
    return color;
}

// A normal map's vector, turned from its tangent space. `normal` is the front's interpolated normal.
//
// Without tangents the space follows from derivatives of position and texture coordinates (Schüler, "Normal Mapping
// Without Precomputed Tangents", ShaderX5, 2006; three.js does so). Tangents point along u, bitangents against v.
fn turned(bent: vec3f, scale: f32, place: Place, normal: vec3f, input: Point, front: bool) -> vec3f {
    let across = dpdx(input.from_eye);
    let down = dpdy(input.from_eye);
    let one = cross(down, normal);
    let other = cross(normal, across);
    // Pictures run downwards: seen from the front, across × down points away from the eye.
    let side = select(1.0, -1.0, front);
    var tangent = (one * place.across.x + other * place.down.x) * side;
    var bitangent = (one * place.across.y + other * place.down.y) * -side;
    let longest = max(dot(tangent, tangent), dot(bitangent, bitangent));
    let shrink = select(inverseSqrt(longest), 0.0, longest == 0.0);
    tangent *= shrink;
    bitangent *= shrink;
    if has(TANGENTS) && dot(input.tangent.xyz, input.tangent.xyz) > 1e-6 {
        tangent = normalize(input.tangent.xyz);
        bitangent = normalize(cross(normal, tangent)) * sign(input.tangent.w);
    }
    return normalize(tangent * (bent.x * scale) + bitangent * (bent.y * scale) + normal * bent.z);
}

struct Surface {
    color: vec4f,
    // Towards the side that is seen.
    normal: vec3f,
    // Without normal map.
    smooth_normal: vec3f,
    lean: f32,
    coat_normal: vec3f,
    // The triangle's own, towards the eye.
    plane_normal: vec3f,
    roughness: f32,
    metallic: f32,
    occlusion: f32,
    coat: f32,
    coat_roughness: f32,
    transmission: f32,
    tint: vec4f,
    // Exposed.
    emitted: vec3f,
}

fn surface_of(input: Point, front: bool) -> Surface {
    let side = select(-1.0, 1.0, front);
    let smooth_normal = normalize(input.normal.xyz);
    let across = cross(dpdx(input.from_eye), dpdy(input.from_eye));
    // Scaled before it is normalised: the product of two small differences may be too small to be squared.
    let plane = normalize(across / max(max(abs(across.x), abs(across.y)), max(abs(across.z), 1e-37)));
    // A triangle seen edge-on has no such product; its shading normal is used instead.
    let plane_or_normal = select(smooth_normal * side, plane, any(across != vec3f(0.0)));
    let toward_eye = select(plane_or_normal, -plane_or_normal, dot(plane_or_normal, input.from_eye) > 0.0);

    var surface = Surface(
        base_color(input), smooth_normal * side, smooth_normal * side, input.normal.w, smooth_normal * side,
        toward_eye, material.roughness, material.metallic, 1.0, material.coat, material.coat_roughness,
        material.transmission, vec4f(1.0), material.emissive,
    );
    if has(METALLIC_ROUGHNESS) {
        let found = texel(0u, metallic_roughness_picture, metallic_roughness_sampler, input);
        surface.roughness *= found.g;
        surface.metallic *= found.b;
        if has(OCCLUSION_IN_RED) {
            surface.occlusion = 1.0 + material.occlusion_strength * (found.r - 1.0);
        }
    }
    if has(NORMAL) {
        let bent = texel(1u, normal_picture, normal_sampler, input).xyz * 2.0 - 1.0;
        let place = place_of(1u, input);
        surface.normal = side * turned(bent, material.normal_scale, place, smooth_normal, input, front);
    }
    if has(OCCLUSION) {
        let found = texel(2u, occlusion_picture, occlusion_sampler, input).r;
        surface.occlusion = 1.0 + material.occlusion_strength * (found - 1.0);
    }
    if has(EMISSIVE) {
        surface.emitted *= texel(3u, emissive_picture, emissive_sampler, input).rgb;
    }
    if has(COAT) {
        let found = texel(4u, coat_picture, coat_sampler, input);
        surface.coat *= found.r;
        surface.coat_roughness *= found.g;
    }
    if has(COAT_NORMAL) {
        let bent = texel(5u, coat_normal_picture, coat_normal_sampler, input).xyz * 2.0 - 1.0;
        let place = place_of(5u, input);
        surface.coat_normal = side * turned(bent, material.coat_normal_scale, place, smooth_normal, input, front);
    }
    if has(TINT) {
        surface.tint = texel(6u, tint_picture, tint_sampler, input);
    }
    if has(TRANSMISSION) {
        surface.transmission *= texel(7u, transmission_picture, transmission_sampler, input).r;
    }
    if has(UNLIT) {
        surface.emitted = surface.color.rgb;
        surface.color = vec4f(vec3f(0.0), surface.color.a);
    }
    return surface;
}
