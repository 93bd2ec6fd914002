// Shadow edges: the share of a pixel that a light reaches, from its bit and those of the eight pixels around it.
//
// A bit says whether a light reaches the centre of a pixel. Where bits differ, a shadow's edge runs between centres,
// and is nearly straight there. `edge_shares` has, for each of the 512 patterns, the mean share over all straight edges
// that make it (`shaders/src/edge_shares.rs`). Pixels of other surfaces count as the pixel itself.

#import "shading/inputs.wgsl"
#import "shading/same_surface.wgsl"

// False draws hard edges.
override smooth_edges: bool = true;

@group(0) @binding(7) var<storage, read> edge_shares: array<f32, 512>;
@group(0) @binding(10) var nearest_texel: sampler;

// A pixel's visibility, and what is around it.
struct Surroundings {
    pixel: vec2u,
    // As of `visibility_of`.
    visibility: vec2u,
    // Lights whose bits are not the same in all nine pixels.
    disputed: vec2u,
    // Bit 3·row + column is 1 if the pixel there shows the same surface.
    same_surface: u32,
}

// Ones where not all four are the same.
fn differing(words: vec4u) -> u32 {
    return (words.x | words.y | words.z | words.w) & ~(words.x & words.y & words.z & words.w);
}

// Whether some light's bit is not the same in the nine pixels around. Also true beside columns that show the scene
// without visibility.
fn is_disputed(pixel: vec2u) -> bool {
    if pixel.x > lighting.lit_from_px {
        return false;
    }
    if pixel.x + 1u >= lighting.lit_from_px {
        return true;
    }
    let texel = 1.0 / vec2f(f32(view.width), f32(view.height));
    // Corners of the pixel: four squares of two by two, which repeat the border beyond it.
    let low = vec2f(pixel) * texel;
    let high = low + texel;
    let a = textureGather(0, visibility_picture, nearest_texel, low);
    let b = textureGather(0, visibility_picture, nearest_texel, vec2f(high.x, low.y));
    let c = textureGather(0, visibility_picture, nearest_texel, vec2f(low.x, high.y));
    let d = textureGather(0, visibility_picture, nearest_texel, high);
    return (differing(a) | differing(b) | differing(c) | differing(d)) != 0u;
}

fn surroundings(pixel: vec2u, point: vec3f, plane_normal: vec3f) -> Surroundings {
    let own = visibility_of(pixel);
    var found = Surroundings(pixel, own, vec2u(0u), 0u);
    for (var place = 0u; place < 9u; place++) {
        found.disputed |= own ^ visibility_of(neighbour(pixel, place));
    }
    // At a share of 1 the second word is not visibility (`predict.wgsl`).
    found.disputed.y = select(found.disputed.y, 0u, view.visibility_share >= 1.0);
    if all(found.disputed == vec2u(0u)) {
        return found;
    }
    let footprint_m = footprint_of(point);
    for (var place = 0u; place < 9u; place++) {
        let on_plane = is_on_plane(neighbour(pixel, place), point, plane_normal, footprint_m);
        found.same_surface |= select(0u, 1u << place, on_plane);
    }
    return found;
}

// The share of the pixel that light k reaches, by one of the two words.
fn edge_share(around: Surroundings, k: u32, second: u32) -> f32 {
    let own = (around.visibility[second] >> k) & 1u;
    if ((around.disputed[second] >> k) & 1u) == 0u {
        return f32(own);
    }
    var pattern = 0u;
    for (var place = 0u; place < 9u; place++) {
        let its = (visibility_of(neighbour(around.pixel, place))[second] >> k) & 1u;
        pattern |= select(own, its, ((around.same_surface >> place) & 1u) == 1u) << place;
    }
    return edge_shares[pattern];
}

// The share of the pixel that light k reaches: between 0 and 1 along a shadow's edge, and while one source of
// visibility fades into the other.
fn smooth_share(around: Surroundings, k: u32) -> f32 {
    if (((around.disputed.x | around.disputed.y) >> k) & 1u) == 0u {
        return reached(k, around.visibility);
    }
    return mix(edge_share(around, k, 1u), edge_share(around, k, 0u), view.visibility_share);
}
