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
    // Planes of the mask that fits this picture, or 0 when there is none: then every light reaches every pixel.
    mask_lights: u32,
}

// The direction of a pixel's ray, of which one unit is one metre of depth.
fn ray_of_pixel(view: View, pixel: vec2u) -> vec3f {
    let x = 2.0 * (f32(pixel.x) + 0.5) / f32(view.width) - 1.0;
    let y = 1.0 - 2.0 * (f32(pixel.y) + 0.5) / f32(view.height);
    return view.forward + x * view.right + y * view.up;
}

// A unit vector in two 16-bit numbers: the octahedral map of Meyer et al., "On Floating-Point Normal Vectors" (2010).
fn pack_normal(n: vec3f) -> u32 {
    var flat = n.xy / (abs(n.x) + abs(n.y) + abs(n.z));
    if n.z < 0.0 {
        flat = (1.0 - abs(flat.yx)) * select(vec2f(-1.0), vec2f(1.0), flat >= vec2f(0.0));
    }
    return pack2x16snorm(flat);
}

fn unpack_normal(bits: u32) -> vec3f {
    let flat = unpack2x16snorm(bits);
    let z = 1.0 - abs(flat.x) - abs(flat.y);
    let fold = max(-z, 0.0);
    return normalize(vec3f(flat - select(vec2f(-fold), vec2f(fold), flat >= vec2f(0.0)), z));
}

// A triangle that covers the picture.
fn covering_triangle(index: u32) -> vec4f {
    return vec4f(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}
