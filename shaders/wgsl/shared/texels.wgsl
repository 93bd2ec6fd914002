// Which texels of a picture a texture coordinate falls between.

// The texel inside the picture that stands for texel `place` of the endless one. Wraps: 0 repeats, 1 repeats mirrored,
// 2 holds the edge.
fn wrapped(place: i32, size: i32, wrap: u32) -> i32 {
    if wrap == 2u {
        return clamp(place, 0, size - 1);
    }
    if wrap == 1u {
        let period = 2 * size;
        let folded = ((place % period) + period) % period;
        return min(folded, period - 1 - folded);
    }
    return ((place % size) + size) % size;
}

// The upper left one of four texels of the endless picture, and the weights of those to its right and below it.
struct Texels {
    corner: vec2i,
    weight: vec2f,
}

// Farther out than 2³⁰ texels an f32 has no place between texels anyway.
fn texels_around(uv: vec2f, size: vec2f) -> Texels {
    let place = clamp(uv * size - 0.5, vec2f(-1073741824.0), vec2f(1073741824.0));
    let corner = floor(place);
    return Texels(vec2i(corner), place - corner);
}
