// Which of the pixels around show a pixel's own surface. Importers declare `view` and `depth_picture`.

#import "shading/view.wgsl"

// The nine pixels around one: place 3·row + column. Beyond the picture its border is repeated.
fn neighbour(pixel: vec2u, place: u32) -> vec2u {
    let size = vec2i(i32(view.width), i32(view.height));
    let at = vec2i(pixel) + vec2i(i32(place % 3u), i32(place / 3u)) - 1;
    return vec2u(clamp(at, vec2i(0), size - 1));
}

// Side of a pixel at a point's distance, in metres.
fn footprint_of(point: vec3f) -> f32 {
    return dot(point - view.origin, view.forward) * 2.0 * length(view.up) / f32(view.height);
}

// Whether the surface at pixel `other` goes on in the plane of a point nearby. As `quad_at` of `predict.wgsl`: allows
// for the packed normal's error, and for curved surfaces.
fn is_on_plane(other: vec2u, point: vec3f, plane_normal: vec3f, footprint_m: f32) -> bool {
    let depth = textureLoad(depth_picture, other, 0);
    let away = point_at_depth(view, other, max(depth, 1e-30)) - point;
    let on_plane = abs(dot(away, plane_normal)) <= 0.2 * footprint_m + 0.02 * length(away);
    return depth > 0.0 && on_plane;
}
