// The G-buffer: for every pixel the nearest OPAQUE or MASK surface, as `server/src/visibility/mod.rs` defines it.

#import "shading/view.wgsl"
#import "shading/material.wgsl"

@group(0) @binding(0) var<uniform> view: View;

struct Vertex {
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) uv: vec2f,
}

struct Varying {
    @builtin(position) clip: vec4f,
    @location(0) normal: vec3f,
    @location(1) uv: vec2f,
}

struct Surface {
    // Linear base colour; the target encodes it as sRGB.
    @location(0) base_color: vec4f,
    // Packed shading normal, and 1 + the material's index; 0 where there is no surface.
    @location(1) normal_material: vec2u,
}

@vertex
fn transform(vertex: Vertex) -> Varying {
    return Varying(view.clip_from_local * vec4f(vertex.position, 1.0), vertex.normal, vertex.uv);
}

fn surface(input: Varying, front: bool) -> Surface {
    // The normal stays as the vertices have it on the front, and is negated when the back face is seen.
    let normal = normalize(select(-input.normal, input.normal, front));
    return Surface(vec4f(base_color(input.uv).rgb, 1.0), vec2u(pack_normal(normal), material.index + 1u));
}

@fragment
fn opaque(input: Varying, @builtin(front_facing) front: bool) -> Surface {
    return surface(input, front);
}

@fragment
fn masked(input: Varying, @builtin(front_facing) front: bool) -> Surface {
    let seen = surface(input, front);
    if mask_alpha(input.uv) < material.alpha_cutoff {
        discard;
    }
    return seen;
}
