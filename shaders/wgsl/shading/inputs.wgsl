// Inputs of the shading passes, and lookups for a pixel. Bound by `client/core/src/render/shade.rs`.

#import "shading/view.wgsl"
#import "shading/lighting.wgsl"
#import "shading/finish.wgsl"

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> lighting: Lighting;
// Output of `predict.wgsl`: bit k of x and of y is light k.
@group(0) @binding(2) var visibility_picture: texture_2d<u32>;
// Of every material.
@group(0) @binding(3) var<storage, read> finishes: array<Finish>;
@group(0) @binding(4) var depth_picture: texture_depth_2d;
@group(0) @binding(5) var color_picture: texture_2d<f32>;
// See `packed_surface` of `gbuffer.wgsl`.
@group(0) @binding(6) var normal_material_picture: texture_2d<u32>;

// A pixel's visibility. All lights reach it in the columns that show the scene without visibility.
fn visibility_of(pixel: vec2u) -> vec2u {
    return select(textureLoad(visibility_picture, pixel, 0).xy, vec2u(0xffffffffu), pixel.x >= lighting.lit_from_px);
}

// Share of light k that reaches a pixel's surface: 0 or 1, and in between while one source fades into the other.
fn reached(k: u32, visibility: vec2u) -> f32 {
    return mix(f32((visibility.y >> k) & 1u), f32((visibility.x >> k) & 1u), view.visibility_share);
}

// A pixel's surface point in local space.
fn surface_point(pixel: vec2u) -> vec3f {
    return point_at_depth(view, pixel, textureLoad(depth_picture, pixel, 0));
}

// Clamps to half the largest finite 16-bit float, since two are added: a surface close to a lamp would become infinite,
// and be shown as black.
fn kept(light: vec3f) -> vec3f {
    return min(light, vec3f(32752.0));
}
