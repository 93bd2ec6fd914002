// The G-buffer: the nearest OPAQUE or MASK surface of every pixel, as `server/src/visibility/mod.rs` defines it.

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
    // Relative to the eye: small numbers, so that their differences stay precise.
    @location(2) from_eye: vec3f,
}

struct Surface {
    // Linear base colour; the target encodes it as sRGB.
    @location(0) base_color: vec4f,
    // Packed shading normal; packed material and plane normal. 0 where there is no surface.
    @location(1) normal_material: vec2u,
}

@vertex
fn transform(vertex: Vertex) -> Varying {
    let clip = view.clip_from_local * vec4f(vertex.position, 1.0);
    return Varying(clip, vertex.normal, vertex.uv, vertex.position - view.origin);
}

fn surface(input: Varying, front: bool) -> Surface {
    // Negated on back faces.
    let normal = normalize(select(-input.normal, input.normal, front));
    let across = cross(dpdx(input.from_eye), dpdy(input.from_eye));
    // Scaled before it is normalised: the product of two small differences may be too small to be squared.
    let plane = normalize(across / max(max(abs(across.x), abs(across.y)), max(abs(across.z), 1e-37)));
    // A triangle seen edge-on has no such product; its shading normal is used instead.
    let plane_or_normal = select(normal, plane, any(across != vec3f(0.0)));
    let toward_eye = select(plane_or_normal, -plane_or_normal, dot(plane_or_normal, input.from_eye) > 0.0);
    let packed = vec2u(pack_normal(normal), pack_material(material.index, toward_eye));
    return Surface(vec4f(base_color(input.uv).rgb, 1.0), packed);
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
