// Shadow edges: the share of a pixel that a light reaches, from its bit and those of the eight pixels around it.
//
// A bit says whether a light reaches the centre of a pixel. Where bits differ, a shadow's edge runs between centres,
// and is nearly straight there. `edge_shares` has, for each of the 512 patterns, the mean share over all straight edges
// that make it (`shaders/src/edge_shares.rs`). Pixels of other surfaces count as the pixel itself.

#import "shading/inputs.wgsl"

// False draws hard edges.
override smooth_edges: bool = true;

@group(0) @binding(7) var<storage, read> edge_shares: array<f32, 512>;

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

fn neighbour(pixel: vec2u, place: u32) -> vec2u {
    let size = vec2i(i32(view.width), i32(view.height));
    let at = vec2i(pixel) + vec2i(i32(place % 3u), i32(place / 3u)) - 1;
    return vec2u(clamp(at, vec2i(0), size - 1));
}

fn surroundings(pixel: vec2u, point: vec3f, plane_normal: vec3f) -> Surroundings {
    let own = visibility_of(pixel);
    var found = Surroundings(pixel, own, vec2u(0u), 0u);
    if !smooth_edges {
        return found;
    }
    for (var place = 0u; place < 9u; place++) {
        found.disputed |= own ^ visibility_of(neighbour(pixel, place));
    }
    // At a share of 1 the second word is not visibility (`predict.wgsl`).
    found.disputed.y = select(found.disputed.y, 0u, view.visibility_share >= 1.0);
    if all(found.disputed == vec2u(0u)) {
        return found;
    }
    // As `quad_at` of `predict.wgsl`: allows for the packed normal's error, and for curved surfaces.
    let footprint_m = dot(point - view.origin, view.forward) * 2.0 * length(view.up) / f32(view.height);
    for (var place = 0u; place < 9u; place++) {
        let other = neighbour(pixel, place);
        let depth = textureLoad(depth_picture, other, 0);
        let away = point_at_depth(view, other, max(depth, 1e-30)) - point;
        let on_plane = abs(dot(away, plane_normal)) <= 0.2 * footprint_m + 0.02 * length(away);
        found.same_surface |= select(0u, 1u << place, depth > 0.0 && on_plane);
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
