// Debug views: a light's visibility, what is unknown, the age of masks, depth, normals.
//
// The colours also differ in brightness, and are safe for colour-blind people (Okabe and Ito, 2008).

#import "shading/view.wgsl"

// Twin: `render::debug_view::Choice`.
struct Choice {
    kind: u32,
    // The light to show.
    light: u32,
    unused_0: u32,
    unused_1: u32,
    // Age of each mask relative to the picture, in frames, newest first.
    lags: array<vec4u, 2>,
}

const LIGHT: u32 = 0u;
const UNKNOWN: u32 = 1u;
const AGE: u32 = 2u;
const DEPTH: u32 = 3u;
const NORMALS: u32 = 4u;

const SKY = vec3f(0.0);
const LIT = vec3f(0.94, 0.89, 0.26);
const SHADOWED = vec3f(0.0, 0.27, 0.43);
const MISSING = vec3f(0.90, 0.62, 0.0);

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> choice: Choice;
@group(0) @binding(2) var visibility_picture: texture_2d<u32>;
@group(0) @binding(3) var depth_picture: texture_depth_2d;
@group(0) @binding(4) var normal_material_picture: texture_2d<u32>;

@vertex
fn cover(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return covering_triangle(index);
}

// Colours from blue (0) through green to yellow (1), of increasing brightness.
fn ramp(x: f32) -> vec3f {
    let t = saturate(x);
    return mix(mix(SHADOWED, vec3f(0.0, 0.62, 0.45), saturate(2.0 * t)), LIT, saturate(2.0 * t - 1.0));
}

@fragment
fn look(@builtin(position) place: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(place.xy);
    let normal_material = textureLoad(normal_material_picture, pixel, 0).xy;
    if material_plus_1(normal_material.y) == 0u {
        return vec4f(SKY, 1.0);
    }
    let normal = unpack_normal(normal_material.x);
    // A little shading by the normal, to make shapes visible.
    let relief = 0.55 + 0.45 * abs(dot(normal, normalize(ray_of_pixel(view, pixel))));
    let visibility = textureLoad(visibility_picture, pixel, 0).xy;
    // At a share of 1, y is 1 + the oldest layer that a light needed, or 0; see `predict.wgsl`.
    let known = select(visibility.x != visibility.y, visibility.y != 0u, view.visibility_share >= 1.0);
    switch choice.kind {
        case LIGHT: {
            return vec4f(relief * select(SHADOWED, LIT, ((visibility.x >> choice.light) & 1u) == 1u), 1.0);
        }
        case UNKNOWN: {
            return vec4f(relief * select(MISSING, vec3f(0.35), known), 1.0);
        }
        case AGE: {
            let layer = (visibility.y - 1u) & 7u;
            let lag = choice.lags[layer / 4u][layer % 4u];
            return vec4f(relief * select(MISSING, ramp(log2(1.0 + f32(lag)) / 6.0), known), 1.0);
        }
        case DEPTH: {
            // 1 m is a third of the ramp, 10 m two thirds, 100 m all of it.
            let distance_m = view.near_m / textureLoad(depth_picture, pixel, 0);
            return vec4f(ramp((log2(distance_m) / log2(10.0) + 1.0) / 3.0), 1.0);
        }
        default: {
            return vec4f(normal * 0.5 + 0.5, 1.0);
        }
    }
}
