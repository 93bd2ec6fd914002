// What the passes that shade read, and what the visibility and the G-buffer say about a pixel.
// `client/core/src/render/shade.rs` binds it.

#import "shading/view.wgsl"
#import "shading/lighting.wgsl"

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> lighting: Lighting;
// What `predict.wgsl` found: bit k of x, and of y, is light k.
@group(0) @binding(2) var visibility_picture: texture_2d<u32>;
// Emitted light of every material, exposed.
@group(0) @binding(3) var<storage, read> emitted: array<vec4f>;
@group(0) @binding(4) var depth_picture: texture_depth_2d;
@group(0) @binding(5) var color_picture: texture_2d<f32>;
@group(0) @binding(6) var normal_material_picture: texture_2d<u32>;

// What is known of a pixel's lights; in columns that show the scene without visibility, that all of them reach it.
fn visibility_of(pixel: vec2u) -> vec2u {
    return select(textureLoad(visibility_picture, pixel, 0).xy, vec2u(0xffffffffu), pixel.x >= lighting.lit_from_px);
}

// How much of light k reaches the surface in a pixel: 0 or 1, and in between while the one source fades into the other.
fn reached(k: u32, visibility: vec2u) -> f32 {
    return mix(f32((visibility.y >> k) & 1u), f32((visibility.x >> k) & 1u), view.visibility_share);
}

// The point of the surface in a pixel, in local space.
fn surface_point(pixel: vec2u) -> vec3f {
    return point_at_depth(view, pixel, textureLoad(depth_picture, pixel, 0));
}

// Light as its picture can hold it, whose 16-bit numbers end here: a surface close to a lamp would become infinitely
// bright, and black when it is shown.
fn kept(light: vec3f) -> vec3f {
    return min(light, vec3f(65504.0));
}
