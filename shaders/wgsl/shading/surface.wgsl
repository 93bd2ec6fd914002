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
    @location(1) normal: vec3f,
    @location(2) uv: vec2f,
    @location(3) uv_1: vec2f,
    // Unit vector and handedness, or zeros.
    @location(4) tangent: vec4f,
    @location(5) color: vec4f,
}

struct Varying {
    @builtin(position) clip: vec4f,
    @location(0) normal: vec3f,
    @location(1) uv: vec2f,
    // Relative to the eye: small numbers, so that their differences stay precise.
    @location(2) from_eye: vec3f,
    @location(3) uv_1: vec2f,
    @location(4) tangent: vec4f,
    @location(5) color: vec4f,
}

fn projected(vertex: Vertex, clip_from_local: mat4x4f, eye: vec3f) -> Varying {
    let clip = clip_from_local * vec4f(vertex.position, 1.0);
    let from_eye = vertex.position - eye;
    return Varying(clip, vertex.normal, vertex.uv, from_eye, vertex.uv_1, vertex.tangent, vertex.color);
}

fn has(feature: u32) -> bool {
    return (FEATURES & feature) != 0u;
}

// Texture coordinates of the texture with this map.
fn mapped(input: Varying, map: u32) -> vec2f {
    if !has(MAPPED) {
        return input.uv;
    }
    let uv = vec3f(select(input.uv, input.uv_1, material.maps[map].second == 1u), 1.0);
    return vec2f(dot(material.maps[map].u, uv), dot(material.maps[map].v, uv));
}

// Linear base colour and alpha, filtered.
fn base_color(input: Varying) -> vec4f {
    var color = material.base_color;
    if has(BASE_COLOR) {
        color *= textureSample(picture, picture_sampler, input.uv);
    }
    if has(COLORS) {
        color *= input.color;
    }
    return color;
}

// The texel of a normal map, turned from its tangent space. `normal` is the front's interpolated normal.
//
// Without tangents the space follows from derivatives of position and texture coordinates (Schüler, "Normal Mapping
// Without Precomputed Tangents", ShaderX5, 2006; three.js does so). Tangents point along u, bitangents against v.
fn turned(texel: vec3f, scale: f32, uv: vec2f, normal: vec3f, input: Varying, front: bool) -> vec3f {
    let across = dpdx(input.from_eye);
    let down = dpdy(input.from_eye);
    let uv_across = dpdx(uv);
    let uv_down = dpdy(uv);
    let one = cross(down, normal);
    let other = cross(normal, across);
    // Pictures run downwards: seen from the front, across × down points away from the eye.
    let side = select(1.0, -1.0, front);
    var tangent = (one * uv_across.x + other * uv_down.x) * side;
    var bitangent = (one * uv_across.y + other * uv_down.y) * -side;
    let longest = max(dot(tangent, tangent), dot(bitangent, bitangent));
    let shrink = select(inverseSqrt(longest), 0.0, longest == 0.0);
    tangent *= shrink;
    bitangent *= shrink;
    if has(TANGENTS) && dot(input.tangent.xyz, input.tangent.xyz) > 1e-6 {
        tangent = normalize(input.tangent.xyz);
        bitangent = normalize(cross(normal, tangent)) * sign(input.tangent.w);
    }
    let bent = texel * 2.0 - 1.0;
    return normalize(tangent * (bent.x * scale) + bitangent * (bent.y * scale) + normal * bent.z);
}

struct Surface {
    color: vec4f,
    // Towards the side that is seen.
    normal: vec3f,
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

fn surface_of(input: Varying, front: bool) -> Surface {
    let side = select(-1.0, 1.0, front);
    let smooth_normal = normalize(input.normal);
    let across = cross(dpdx(input.from_eye), dpdy(input.from_eye));
    // Scaled before it is normalised: the product of two small differences may be too small to be squared.
    let plane = normalize(across / max(max(abs(across.x), abs(across.y)), max(abs(across.z), 1e-37)));
    // A triangle seen edge-on has no such product; its shading normal is used instead.
    let plane_or_normal = select(smooth_normal * side, plane, any(across != vec3f(0.0)));
    let toward_eye = select(plane_or_normal, -plane_or_normal, dot(plane_or_normal, input.from_eye) > 0.0);

    var surface = Surface(
        base_color(input), smooth_normal * side, smooth_normal * side, toward_eye, material.roughness,
        material.metallic, 1.0, material.coat, material.coat_roughness, material.transmission, vec4f(1.0),
        material.emissive,
    );
    if has(METALLIC_ROUGHNESS) {
        let texel = textureSample(metallic_roughness_picture, metallic_roughness_sampler, mapped(input, 0u));
        surface.roughness *= texel.g;
        surface.metallic *= texel.b;
        if has(OCCLUSION_IN_RED) {
            surface.occlusion = 1.0 + material.occlusion_strength * (texel.r - 1.0);
        }
    }
    if has(NORMAL) {
        let uv = mapped(input, 1u);
        let texel = textureSample(normal_picture, normal_sampler, uv).xyz;
        surface.normal = side * turned(texel, material.normal_scale, uv, smooth_normal, input, front);
    }
    if has(OCCLUSION) {
        let texel = textureSample(occlusion_picture, occlusion_sampler, mapped(input, 2u)).r;
        surface.occlusion = 1.0 + material.occlusion_strength * (texel - 1.0);
    }
    if has(EMISSIVE) {
        surface.emitted *= textureSample(emissive_picture, emissive_sampler, mapped(input, 3u)).rgb;
    }
    if has(COAT) {
        let texel = textureSample(coat_picture, coat_sampler, mapped(input, 4u));
        surface.coat *= texel.r;
        surface.coat_roughness *= texel.g;
    }
    if has(COAT_NORMAL) {
        let uv = mapped(input, 5u);
        let texel = textureSample(coat_normal_picture, coat_normal_sampler, uv).xyz;
        surface.coat_normal = side * turned(texel, material.coat_normal_scale, uv, smooth_normal, input, front);
    }
    if has(TINT) {
        surface.tint = textureSample(tint_picture, tint_sampler, mapped(input, 6u));
    }
    if has(TRANSMISSION) {
        surface.transmission *= textureSample(transmission_picture, transmission_sampler, mapped(input, 7u)).r;
    }
    if has(UNLIT) {
        surface.emitted = surface.color.rgb;
        surface.color = vec4f(vec3f(0.0), surface.color.a);
    }
    return surface;
}
