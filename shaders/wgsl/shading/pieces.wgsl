// Which moving piece each pixel shows, drawn over the picture's own depth: its index + 1. What rests leaves 0.

#import "shading/material.wgsl"

// The first field of `View`.
@group(0) @binding(0) var<uniform> clip_from_local: mat4x4f;

struct Varying {
    @builtin(position) @invariant clip: vec4f,
    @location(0) uv: vec2f,
    @location(1) alpha: f32,
    @location(2) @interpolate(flat, either) piece: u32,
}

@vertex
fn transform(
    @location(0) position: vec3f, @location(2) uv: vec2f, @location(5) color: vec4f, @location(6) piece: u32,
) -> Varying {
    return Varying(clip_from_local * vec4f(position, 1.0), uv, color.a, piece);
}

@fragment
fn opaque(input: Varying) -> @location(0) vec4u {
    return vec4u(input.piece, 0u, 0u, 0u);
}

@fragment
fn masked(input: Varying) -> @location(0) vec4u {
    if mask_alpha(input.uv) * vertex_alpha(input.alpha) < material.alpha_cutoff {
        discard;
    }
    return vec4u(input.piece, 0u, 0u, 0u);
}
