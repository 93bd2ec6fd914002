// The shaft of a block's shadow rays. The kernel that imports this declares `view`, and `start_of`.

#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "visibility/lanes_workgroup.wgsl"
#import "visibility/shaft.wgsl"

// Margin of a start's place in the picture, as a share of its distance over its depth: 16 u. Two places of 4 u each and
// a quotient make 10.
const PLACE_SLACK: f32 = 9.5367431640625e-7;

// A start this far to the side of the axis, as a quotient of its depth and its distance, has no shaft.
const LEAST_DEPTH: f32 = 0.05;

// Where a shadow ray starts.
struct Start {
    point: vec3f,
    // Whether there is a ray.
    counts: bool,
    // −1 or 1: the pixel's half of its block, left or right, and upper or lower.
    side: vec2f,
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
    shaft.has_starts = true;
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
