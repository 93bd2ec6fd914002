// A material: base colour, and whether a MASK point is there. Twin: `shading::Material`.

struct Material {
    // Linear RGBA factor.
    base_color: vec4f,
    // A MASK point is there when its alpha is at least this.
    alpha_cutoff: f32,
    // Index into the table of emitted light.
    index: u32,
    // What happens outside 0 to 1, along u and v: 0 repeats, 1 repeats mirrored, 2 holds the edge.
    wrap_u: u32,
    wrap_v: u32,
}

@group(1) @binding(0) var<uniform> material: Material;
@group(1) @binding(1) var picture: texture_2d<f32>;
@group(1) @binding(2) var picture_sampler: sampler;

// The filtered base colour; alpha is the factor's times the picture's.
fn base_color(uv: vec2f) -> vec4f {
    return material.base_color * textureSample(picture, picture_sampler, uv);
}

fn wrapped(place: i32, size: i32, wrap: u32) -> i32 {
    if wrap == 2u {
        return clamp(place, 0, size - 1);
    }
    if wrap == 1u {
        let period = size * 2;
        let folded = ((place % period) + period) % period;
        return min(folded, period - 1 - folded);
    }
    return ((place % size) + size) % size;
}

fn picture_alpha(x: i32, y: i32, size: vec2i) -> f32 {
    let place = vec2i(wrapped(x, size.x, material.wrap_u), wrapped(y, size.y, material.wrap_v));
    return textureLoad(picture, place, 0).a;
}

// The alpha that decides about a MASK point: bilinear in the full-size picture, exactly as the tracers read it, so that
// both ends see the same leaf. The picture's sampler must not be used: it would read a smaller mip.
fn mask_alpha(uv: vec2f) -> f32 {
    let size = vec2i(textureDimensions(picture, 0));
    let place = uv * vec2f(size) - 0.5;
    let corner = floor(place);
    let weight = place - corner;
    let x = i32(corner.x);
    let y = i32(corner.y);
    let upper = mix(picture_alpha(x, y, size), picture_alpha(x + 1, y, size), weight.x);
    let lower = mix(picture_alpha(x, y + 1, size), picture_alpha(x + 1, y + 1, size), weight.x);
    return mix(upper, lower, weight.y) * material.base_color.a;
}
