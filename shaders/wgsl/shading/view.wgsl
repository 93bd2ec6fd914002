// The camera as the shading passes see it. Twin: `shading::View`.

struct View {
    // Reversed-Z clip space from local space.
    clip_from_local: mat4x4f,
    // The camera's position in local space, in metres.
    origin: vec3f,
    // Distance of the near plane, in metres.
    near_m: f32,
    // Unit vector along the view.
    forward: vec3f,
    // Width of the picture, in pixels.
    width: u32,
    // Half the picture's width on the plane at distance 1.
    right: vec3f,
    // Height of the picture, in pixels.
    height: u32,
    // Half the picture's height on the plane at distance 1.
    up: vec3f,
    // Weight of predicted visibility, 0 to 1, against the client's own shadow maps.
    visibility_share: f32,
}

// The direction of a pixel's ray; its length is one metre of depth.
fn ray_of_pixel(view: View, pixel: vec2u) -> vec3f {
    let x = 2.0 * (f32(pixel.x) + 0.5) / f32(view.width) - 1.0;
    let y = 1.0 - 2.0 * (f32(pixel.y) + 0.5) / f32(view.height);
    return view.forward + x * view.right + y * view.up;
}

// A pixel's surface point in local space, from its depth.
fn point_at_depth(view: View, pixel: vec2u, depth: f32) -> vec3f {
    return view.origin + ray_of_pixel(view, pixel) * (view.near_m / depth);
}

// A unit vector on a square: the octahedral map of Meyer et al., "On Floating-Point Normal Vectors" (2010).
fn octahedral(n: vec3f) -> vec2f {
    let flat = n.xy / (abs(n.x) + abs(n.y) + abs(n.z));
    if n.z < 0.0 {
        return (1.0 - abs(flat.yx)) * select(vec2f(-1.0), vec2f(1.0), flat >= vec2f(0.0));
    }
    return flat;
}

fn from_octahedral(flat: vec2f) -> vec3f {
    let z = 1.0 - abs(flat.x) - abs(flat.y);
    let fold = max(-z, 0.0);
    return normalize(vec3f(flat - select(vec2f(-fold), vec2f(fold), flat >= vec2f(0.0)), z));
}

// Packs a unit vector into two 16-bit numbers.
fn pack_normal(n: vec3f) -> u32 {
    return pack2x16snorm(octahedral(n));
}

fn unpack_normal(bits: u32) -> vec3f {
    return from_octahedral(unpack2x16snorm(bits));
}

// Packs a unit vector into 24 bits and a number from 0 to 1 into 8.
fn pack_smooth(n: vec3f, number: f32) -> u32 {
    let flat = vec2u(round((octahedral(n) * 0.5 + 0.5) * 4095.0));
    return flat.x | (flat.y << 12u) | (u32(round(saturate(number) * 255.0)) << 24u);
}

fn unpack_smooth(bits: u32) -> vec4f {
    let flat = vec2f(f32(bits & 0xfffu), f32((bits >> 12u) & 0xfffu)) / 2047.5 - 1.0;
    return vec4f(from_octahedral(flat), f32(bits >> 24u) / 255.0);
}

// The second word of the G-buffer. Lower half: 1 + the material's index, or 0 where there is no surface. Upper half:
// the triangle's own normal, towards the eye, in two 8-bit numbers; `predict.wgsl` allows for its error of up to 1/100.
fn pack_material(material: u32, plane_normal: vec3f) -> u32 {
    return (material + 1u) | (pack4x8snorm(vec4f(octahedral(plane_normal), 0.0, 0.0)) << 16u);
}

fn material_plus_1(word: u32) -> u32 {
    return word & 0xffffu;
}

fn unpack_plane_normal(word: u32) -> vec3f {
    return from_octahedral(unpack4x8snorm(word >> 16u).xy);
}

// A triangle that covers the picture.
fn covering_triangle(index: u32) -> vec4f {
    return vec4f(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}
