// Which moving piece each pixel shows, drawn over the picture's own depth. What rests leaves 0. Four words, of which a
// picture without pieces that change their shape has the first only: the piece's index + 1; the way from the surface
// point to where it was when a mask was traced, as halves; and its triangle's normal then.

#import "shading/material.wgsl"
#import "shading/view.wgsl"

// The first field of `View`.
@group(0) @binding(0) var<uniform> clip_from_local: mat4x4f;

struct Varying {
    @builtin(position) @invariant clip: vec4f,
    @location(0) uv: vec2f,
    @location(1) alpha: f32,
    @location(2) @interpolate(flat, either) piece: u32,
    @location(3) then: vec3f,
    @location(4) way: vec3f,
}

@vertex
fn transform(
    @location(0) position: vec3f, @location(2) uv: vec2f, @location(5) color: vec4f, @location(6) piece: u32,
    @location(7) then: vec3f,
) -> Varying {
    return Varying(clip_from_local * vec4f(position, 1.0), uv, color.a, piece, then, then - position);
}

// The picture's y points down, so this normal points to the eye, as a surface that is seen.
fn drawn(input: Varying, along: vec3f, down: vec3f) -> vec4u {
    let normal = cross(down, along);
    let unit = normal / max(length(normal), 1e-30);
    let way = vec2u(pack2x16float(input.way.xy), pack2x16float(vec2f(input.way.z, 0.0)));
    return vec4u(input.piece, way, pack2x16snorm(octahedral(unit)));
}

@fragment
fn opaque(input: Varying) -> @location(0) vec4u {
    return drawn(input, dpdx(input.then), dpdy(input.then));
}

@fragment
fn masked(input: Varying) -> @location(0) vec4u {
    let along = dpdx(input.then);
    let down = dpdy(input.then);
    if mask_alpha(input.uv) * vertex_alpha(input.alpha) < material.alpha_cutoff {
        discard;
    }
    return drawn(input, along, down);
}
