// The texels of a picture around a texture coordinate.

// Returns the picture's texel for texel `place` of the wrapped picture. `wrap`: 0 repeats, 1 repeats mirrored, 2 clamps
// to the edge.
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

// The upper left of four texels of the wrapped picture, and the weights of those to its right and below it.
struct Texels {
    corner: vec2i,
    weight: vec2f,
}

// Clamped to 2³⁰ texels: farther out an f32 cannot tell texels apart.
fn texels_around(uv: vec2f, size: vec2f) -> Texels {
    let place = clamp(uv * size - 0.5, vec2f(-1073741824.0), vec2f(1073741824.0));
    let corner = floor(place);
    return Texels(vec2i(corner), place - corner);
}
