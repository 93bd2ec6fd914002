// A shaft: a volume that holds all rays of a block of pixels. For shadow rays to one light it is a pyramid with its tip
// at the light, or a beam to a directional light, cut off behind the points where the rays start. For primary rays it
// is a pyramid with its tip at the camera, cut off behind a triangle that hides the rest.
//
// What the shaft misses, none of its rays hits. "Hit" means that the triangle test of shared/ray.wgsl says so, with its
// rounding. So a triangle is missed only by a margin. u is the rounding unit, 2⁻²⁴. Vectors' sizes are sums of
// magnitudes.
//
// The kernel that imports this declares `view`.

#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "visibility/lanes_workgroup.wgsl"

// Margin of places and heights, as a share of the distances involved: 48 u. The triangle test may see a corner 5 u of
// its distance from the ray's start away from its true place, in each of three coordinates: 9 u along a vector of
// length 1, and as much again along the axis, times a bound of at most 1. This picture: 4 u for a place, 5 u for its
// comparison. Quantised boxes: 2 u of their own distance and of their node's. The ray's direction: 2 u. That makes 31.
const SHAFT_SLACK: f32 = 2.86102294921875e-6;

// Margin of the volume that two corners span with a ray, as a share of the corners' distance, their edge, and the
// distances that the triangle test rounds, over the depth of the hit: 64 u. Corners that seem to lie elsewhere (9 u
// each), the products (11 u, three times) and the ray's direction (2 u) make 53.
const EDGE_SLACK: f32 = 3.814697265625e-6;

// A triangle whose nearest corner is this close to the apex, as a share of its distances, is not tested by its edges.
const LEAST_NEARNESS: f32 = 0.0009765625;

// The picture of the scene from the apex: places across the shaft and depth along it. The vectors are not exactly of
// length 1 or at right angles. They need not be: all places are measured with the same.
struct Shaft {
    // The light, or the camera; among the starts for a directional light. Everything is relative to it.
    apex: vec3f,
    side: vec3f,
    upright: vec3f,
    // From the light to the starts, or into the picture.
    axis: vec3f,
    // Whether the light is directional.
    is_beam: bool,
    // Whether rays start from points in `depth`, `reach`, `base` and the box, and end at the apex. Primary rays start
    // at the apex, and do not end.
    has_starts: bool,
    // Bounds of the starts' places in the picture, or of the rays'.
    low: vec2f,
    high: vec2f,
    // Bound of their depths, and of their distances. Primary rays have none, until a triangle hides the rest.
    depth: f32,
    reach: f32,
    // A plane behind which no start lies, nor the light.
    base: vec3f,
    base_height: f32,
    // Box around the starts.
    centre: vec3f,
    half: vec3f,
}

var<private> shaft: Shaft;

fn size_of(vector: vec3f) -> f32 {
    return dot(vec3f(1.0), abs(vector));
}

fn picture(to_point: vec3f) -> vec3f {
    return vec3f(dot(shaft.side, to_point), dot(shaft.upright, to_point), dot(shaft.axis, to_point));
}

// By what a place in the picture is divided.
fn scale_of(depth: f32) -> f32 {
    return select(depth, 1.0, shaft.is_beam);
}

// True if the shaft misses a box. Its node's corner, from which it was measured, is `away`.
fn misses_box(centre: vec3f, half: vec3f, away: f32) -> bool {
    let slack = SHAFT_SLACK * (dot(vec3f(1.0), abs(centre) + half) + away + shaft.reach);
    let place = picture(centre);
    let extent = vec3f(dot(abs(shaft.side), half), dot(abs(shaft.upright), half), dot(abs(shaft.axis), half)) + slack;
    let scale = scale_of(place.z);
    let spread = select(extent.z, 0.0, shaft.is_beam);
    let above_low = place.xy + extent.xy - shaft.low * scale + abs(shaft.low) * spread;
    let below_high = shaft.high * scale + abs(shaft.high) * spread - place.xy + extent.xy;
    return any(above_low < vec2f(0.0)) || any(below_high < vec2f(0.0))
        || place.z - extent.z > shaft.depth
        || (!shaft.is_beam && place.z + extent.z < 0.0)
        || dot(shaft.base, centre) + dot(abs(shaft.base), half) + slack < shaft.base_height;
}

// −1, 0 or 1: on which side of a plane something lies whose height above it is at most `half` off. 0 is both or unsure.
fn side_of(height: f32, half: f32) -> f32 {
    return select(select(0.0, 1.0, height > half), -1.0, height < -half);
}

// What a triangle may do to the rays.
const MISSES: u32 = 0u;
const MAY_STOP: u32 = 1u;
// It probably stops all of them.
const COVERS: u32 = 2u;

struct Blocking {
    kind: u32,
    // A depth that no ray passes where the triangle stops it.
    depth: f32,
}

const NO_BLOCKING: Blocking = Blocking(MISSES, FARTHEST);

fn blocking_of(triangle: u32) -> Blocking {
    let first = triangles[triangle * 3u];
    let corner_a = bitcast<vec3f>(first.xyz);
    let corner_b = bitcast<vec3f>(triangles[triangle * 3u + 1u].xyz);
    let corner_c = bitcast<vec3f>(triangles[triangle * 3u + 2u].xyz);
    let to_a = corner_a - shaft.apex;
    let to_b = corner_b - shaft.apex;
    let to_c = corner_c - shaft.apex;
    let farthest = max(max(size_of(to_a), size_of(to_b)), size_of(to_c));
    let reach = farthest + shaft.reach;
    let slack = SHAFT_SLACK * reach;
    let a = picture(to_a);
    let b = picture(to_b);
    let c = picture(to_c);
    let height = max(max(dot(shaft.base, to_a), dot(shaft.base, to_b)), dot(shaft.base, to_c));
    let is_behind_apex = !shaft.is_beam && max(max(a.z, b.z), c.z) + slack < 0.0;
    let may_stop = Blocking(MAY_STOP, max(max(a.z, b.z), c.z) + slack);
    if min(min(a.z, b.z), c.z) - slack > shaft.depth || is_behind_apex || height + slack < shaft.base_height {
        return NO_BLOCKING;
    }
    let scales = vec3f(scale_of(a.z), scale_of(b.z), scale_of(c.z));
    let above_low =
        max(max(a.xy - shaft.low * scales.x, b.xy - shaft.low * scales.y), c.xy - shaft.low * scales.z);
    let above_high =
        min(min(a.xy - shaft.high * scales.x, b.xy - shaft.high * scales.y), c.xy - shaft.high * scales.z);
    if any(above_low + slack < vec2f(0.0)) || any(above_high - slack > vec2f(0.0)) {
        return NO_BLOCKING;
    }

    // If starts and light are on one side of the triangle's plane, the quotient of heights that the triangle test takes
    // for the hit's place is negative, or at least 1 because the light's height exceeds the rounding of both (10 u).
    let normal = plane_normal(triangle);
    let light_height = select(-dot(normal, to_a), -dot(normal, shaft.axis), shaft.is_beam);
    let light_side = side_of(light_height, 16.0 * ROUNDING * select(size_of(to_a) + reach, 1.0, shaft.is_beam));
    let starts_half = dot(abs(normal), shaft.half) + 16.0 * ROUNDING * reach;
    let starts_side = side_of(dot(normal, shaft.centre - to_a), starts_half);
    if shaft.has_starts && light_side * starts_side > 0.0 {
        return NO_BLOCKING;
    }

    // The volume that an edge spans with a ray from the apex has one sign on the triangle's side of the edge: that of
    // the whole triangle's volume. It is linear in the ray's place, so its maximum is at a corner of the bounds.
    let nearest = min(min(scales.x, scales.y), scales.z);
    if nearest < LEAST_NEARNESS * reach {
        return may_stop;
    }
    let flatten = vec3f(1.0, 1.0, select(1.0, 0.0, shaft.is_beam));
    let along_a = picture(corner_c - corner_b) * flatten;
    let along_b = picture(corner_a - corner_c) * flatten;
    let along_c = picture(corner_b - corner_a) * flatten;
    let at_a = vec3f(a.xy, scales.x);
    let whole = dot(at_a, cross(along_b, along_c));
    let longest = max(max(size_of(along_a), size_of(along_b)), size_of(along_c));
    // Seen edge-on, a triangle has no side that rounding cannot change.
    if !(abs(whole) > 2.0 * EDGE_SLACK * reach * longest * select(farthest, 1.0, shaft.is_beam)) {
        return may_stop;
    }
    // Seen from the apex, which side is front is as sure as the sign of the whole.
    if !shaft.has_starts && light_side < 0.0 && (first.w & TRIANGLE_SINGLE_SIDED) != 0u {
        return NO_BLOCKING;
    }
    let edge_slack = EDGE_SLACK * longest * reach * select(farthest / nearest, 1.0, shaft.is_beam);
    let edge_a = sign(whole) * cross(vec3f(b.xy, scales.y), along_a);
    let edge_b = sign(whole) * cross(vec3f(c.xy, scales.z), along_b);
    let edge_c = sign(whole) * cross(at_a, along_c);
    if min(min(greatest_at(edge_a), greatest_at(edge_b)), greatest_at(edge_c)) < -edge_slack {
        return NO_BLOCKING;
    }
    let covers = min(min(least_at(edge_a), least_at(edge_b)), least_at(edge_c)) > edge_slack
        && light_side != 0.0 && (!shaft.has_starts || light_side * starts_side < 0.0)
        && (first.w & TRIANGLE_ALPHA) == 0u;
    return Blocking(select(MAY_STOP, COVERS, covers), may_stop.depth);
}

fn greatest_at(edge: vec3f) -> f32 {
    let most = max(edge.xy * shaft.low, edge.xy * shaft.high);
    return most.x + most.y + edge.z;
}

fn least_at(edge: vec3f) -> f32 {
    let fewest = min(edge.xy * shaft.low, edge.xy * shaft.high);
    return fewest.x + fewest.y + edge.z;
}
