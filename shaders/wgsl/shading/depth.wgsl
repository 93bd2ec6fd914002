// Depth only, of the G-buffer's surfaces: for the picture itself, for views that visibility was traced for, and for the
// lights' views.

#import "shading/material.wgsl"

// The first field of `View` and of `ShadowView`.
@group(0) @binding(0) var<uniform> clip_from_local: mat4x4f;

struct Varying {
    @builtin(position) @invariant clip: vec4f,
    @location(0) uv: vec2f,
    @location(1) alpha: f32,
}

@vertex
fn transform(@location(0) position: vec3f) -> @builtin(position) @invariant vec4f {
    return clip_from_local * vec4f(position, 1.0);
}

@vertex
fn transform_masked(@location(0) position: vec3f, @location(2) uv: vec2f, @location(5) color: vec4f) -> Varying {
    return Varying(clip_from_local * vec4f(position, 1.0), uv, color.a);
}

@fragment
fn masked(input: Varying) {
    if mask_alpha(input.uv) * vertex_alpha(input.alpha) < material.alpha_cutoff {
        discard;
    }
}
