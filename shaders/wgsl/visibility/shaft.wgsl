// A shaft: a volume that holds all shadow rays from a block of pixels to one light. It is a pyramid with its tip at the
// light, or a beam to a directional light, cut off behind the points where the rays start.
//
// What the shaft misses, none of its rays hits. "Hit" means that the triangle test of shared/ray.wgsl says so, with its
// rounding. So a triangle is missed only by a margin. u is the rounding unit, 2⁻²⁴. Vectors' sizes are sums of
// magnitudes.
//
// The kernel that imports this declares `view`, and `start_of`.

#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "visibility/lanes_workgroup.wgsl"

// Margin of places and heights, as a share of the distances involved: 48 u. The triangle test may see a corner 5 u of
// its distance from the ray's start away from its true place, in each of three coordinates: 9 u along a vector of
// length 1, and as much again along the axis, times a bound of at most 1. This picture: 4 u for a place, 5 u for its
// comparison. Quantised boxes: 2 u. The ray's direction: 2 u. That makes 31.
const SHAFT_SLACK: f32 = 2.86102294921875e-6;

// Margin of a start's place in the picture, as a share of its distance over its depth: 16 u. Two places of 4 u each and
// a quotient make 10.
const PLACE_SLACK: f32 = 9.5367431640625e-7;

// Margin of the volume that two corners span with a ray, as a share of the corners' distance, their edge, and the
// distances that the triangle test rounds, over the depth of the hit: 64 u. Corners that seem to lie elsewhere (9 u
// each), the products (11 u, three times) and the ray's direction (2 u) make 53.
const EDGE_SLACK: f32 = 3.814697265625e-6;

// A start this far to the side of the axis, as a quotient of its depth and its distance, has no shaft.
const LEAST_DEPTH: f32 = 0.05;

// A triangle whose nearest corner is this close to the light, as a share of its distances, is not tested by its edges.
const LEAST_NEARNESS: f32 = 0.0009765625;

// The light's picture of the scene: places across the shaft and depth along it. The vectors are not exactly of length 1
// or at right angles. They need not be: all places are measured with the same.
struct Shaft {
    // The light; among the starts for a directional light. Everything is relative to it.
    apex: vec3f,
    side: vec3f,
    upright: vec3f,
    // From the light to the starts.
    axis: vec3f,
    // Whether the light is directional.
    is_beam: bool,
    // Bounds of the starts' places in the picture.
    low: vec2f,
    high: vec2f,
    // Bound of their depths, and of their distances.
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

// Where a shadow ray starts.
struct Start {
    point: vec3f,
    // Whether there is a ray.
    counts: bool,
    // −1 or 1: the pixel's half of its block, left or right, and upper or lower.
    side: vec2f,
}

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

// A unit vector across a unit vector.
fn across(axis: vec3f) -> vec3f {
    let other = select(vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), abs(axis.x) > 0.7);
    return normalize(cross(axis, other));
}

// Sets the shaft around all starts of all lanes, each of which has `starts`. False if there is none: a start lies
// beside the light or behind it, as seen along the shaft, or the shaft is wider than a right angle.
fn set_shaft(light: TracedLight, starts: u32, lane: u32) -> bool {
    var low = vec3f(FARTHEST);
    var high = vec3f(-FARTHEST);
    var to_right = vec4f(0.0);
    var to_below = vec4f(0.0);
    for (var i = 0u; i < starts; i++) {
        let start = start_of(i, lane);
        if start.counts {
            low = min(low, start.point);
            high = max(high, start.point);
            to_right += vec4f(start.point, 1.0) * start.side.x;
            to_below += vec4f(start.point, 1.0) * start.side.y;
        }
    }
    low = least(vec4f(low, 0.0), lane).xyz;
    high = greatest(vec4f(high, 0.0), lane).xyz;
    to_right = total(to_right, lane);
    to_below = total(to_below, lane);
    let centre = (low + high) * 0.5;
    let right = to_right.xyz - centre * to_right.w;
    let below = to_below.xyz - centre * to_below.w;

    shaft.is_beam = light.kind == LIGHT_DIRECTIONAL;
    shaft.apex = select(light.position, centre, shaft.is_beam);
    shaft.axis = select(normalize(centre - shaft.apex), light.direction, shaft.is_beam);
    shaft.centre = centre - shaft.apex;
    shaft.half = (high - low) * 0.5 + 4.0 * ROUNDING * (max(abs(low), abs(high)) + abs(shaft.apex));
    // The picture turns with the surface, so that its bounds fit the starts closely.
    let flat_right = right - shaft.axis * dot(shaft.axis, right);
    let flat_below = below - shaft.axis * dot(shaft.axis, below);
    let longer = select(flat_right, flat_below, dot(flat_below, flat_below) > dot(flat_right, flat_right));
    let longer_squared = dot(longer, longer);
    shaft.side = select(across(shaft.axis), longer * inverseSqrt(longer_squared), longer_squared > 1e-12);
    shaft.upright = cross(shaft.axis, shaft.side);
    // About the surface's plane. Any plane would do.
    let normal = cross(right, below);
    let normal_squared = dot(normal, normal);
    let to_light = select(light.position - centre, -light.direction, shaft.is_beam);
    let turn = select(-1.0, 1.0, dot(normal, to_light) > 0.0);
    shaft.base = select(vec3f(0.0), normal * (turn * inverseSqrt(normal_squared)), normal_squared > 1e-20);

    // Least place and height; greatest place, depth and distance.
    var inmost = vec4f(FARTHEST);
    var outmost = vec4f(-FARTHEST);
    for (var i = 0u; i < starts; i++) {
        let start = start_of(i, lane);
        if start.counts {
            let to_start = start.point - shaft.apex;
            let distance = size_of(to_start);
            let seen = picture(to_start);
            let scale = 1.0 / scale_of(seen.z);
            let place = seen.xy * scale;
            let margin = PLACE_SLACK * distance * scale;
            let is_seen = shaft.is_beam || seen.z > LEAST_DEPTH * distance;
            inmost = min(inmost, vec4f(place - margin, dot(shaft.base, to_start), 0.0));
            let depth = seen.z + PLACE_SLACK * distance;
            outmost = max(outmost, vec4f(place + margin, depth, select(FARTHEST, distance, is_seen)));
        }
    }
    inmost = least(inmost, lane);
    outmost = greatest(outmost, lane);
    shaft.low = inmost.xy;
    shaft.high = outmost.xy;
    shaft.depth = outmost.z;
    shaft.reach = outmost.w;
    shaft.base_height = select(min(inmost.z, 0.0), inmost.z, shaft.is_beam);
    let widest = max(max(-inmost.x, -inmost.y), max(outmost.x, outmost.y));
    return shaft.reach < FARTHEST && (shaft.is_beam || widest <= 1.0);
}

// True if the shaft misses a box.
fn misses_box(centre: vec3f, half: vec3f) -> bool {
    let slack = SHAFT_SLACK * (dot(vec3f(1.0), abs(centre) + half) + shaft.reach);
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

fn blocking_of(triangle: u32) -> u32 {
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
    let is_behind_light = !shaft.is_beam && max(max(a.z, b.z), c.z) + slack < 0.0;
    if min(min(a.z, b.z), c.z) - slack > shaft.depth || is_behind_light || height + slack < shaft.base_height {
        return MISSES;
    }
    let scales = vec3f(scale_of(a.z), scale_of(b.z), scale_of(c.z));
    let above_low =
        max(max(a.xy - shaft.low * scales.x, b.xy - shaft.low * scales.y), c.xy - shaft.low * scales.z);
    let above_high =
        min(min(a.xy - shaft.high * scales.x, b.xy - shaft.high * scales.y), c.xy - shaft.high * scales.z);
    if any(above_low + slack < vec2f(0.0)) || any(above_high - slack > vec2f(0.0)) {
        return MISSES;
    }

    // If starts and light are on one side of the triangle's plane, the quotient of heights that the triangle test takes
    // for the hit's place is negative, or at least 1 because the light's height exceeds the rounding of both (10 u).
    let normal = plane_normal(triangle);
    let light_height = select(-dot(normal, to_a), -dot(normal, shaft.axis), shaft.is_beam);
    let light_side = side_of(light_height, 16.0 * ROUNDING * select(size_of(to_a) + reach, 1.0, shaft.is_beam));
    let starts_half = dot(abs(normal), shaft.half) + 16.0 * ROUNDING * reach;
    let starts_side = side_of(dot(normal, shaft.centre - to_a), starts_half);
    if light_side * starts_side > 0.0 {
        return MISSES;
    }

    // The volume that an edge spans with a ray from the apex has one sign on the triangle's side of the edge: that of
    // the whole triangle's volume. It is linear in the ray's place, so its maximum is at a corner of the bounds.
    let nearest = min(min(scales.x, scales.y), scales.z);
    if nearest < LEAST_NEARNESS * reach {
        return MAY_STOP;
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
        return MAY_STOP;
    }
    let edge_slack = EDGE_SLACK * longest * reach * select(farthest / nearest, 1.0, shaft.is_beam);
    let edge_a = sign(whole) * cross(vec3f(b.xy, scales.y), along_a);
    let edge_b = sign(whole) * cross(vec3f(c.xy, scales.z), along_b);
    let edge_c = sign(whole) * cross(at_a, along_c);
    if min(min(greatest_at(edge_a), greatest_at(edge_b)), greatest_at(edge_c)) < -edge_slack {
        return MISSES;
    }
    let covers = min(min(least_at(edge_a), least_at(edge_b)), least_at(edge_c)) > edge_slack
        && light_side * starts_side < 0.0 && (first.w & TRIANGLE_ALPHA) == 0u;
    return select(MAY_STOP, COVERS, covers);
}

fn greatest_at(edge: vec3f) -> f32 {
    let most = max(edge.xy * shaft.low, edge.xy * shaft.high);
    return most.x + most.y + edge.z;
}

fn least_at(edge: vec3f) -> f32 {
    let fewest = min(edge.xy * shaft.low, edge.xy * shaft.high);
    return fewest.x + fewest.y + edge.z;
}
