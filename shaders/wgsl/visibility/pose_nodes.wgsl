// Puts nodes of one height around moved triangles and the nodes below: see `set_boxes` in `backend/compute/refit.rs`. A
// node's children keep their places, and so their order, however its piece turns.

#import "visibility/pose.wgsl"

// Steps of a node's grid.
const STEPS: f32 = 255.0;
// Extents grow by this share, more than dividing by the steps may round off: 2^-20.
const EXTENT_SLACK: f32 = 9.5367431640625e-7;
// Boxes grow by this share of a step, more than their corners' differences are rounded by, 255 · 2^-24.
const STEP_SLACK: f32 = 3.0517578125e-5;
// Least extent of a node along an axis, in metres.
const LEAST_EXTENT_M: f32 = 1e-20;
const FAR: f32 = 3.4028234663852886e38;

struct Box {
    low: vec3f,
    high: vec3f,
}

const NOTHING = Box(vec3f(FAR), vec3f(-FAR));

fn joined(one: Box, other: Box) -> Box {
    return Box(min(one.low, other.low), max(one.high, other.high));
}

fn is_something(it: Box) -> bool {
    return all(it.low <= it.high);
}

fn box_of_triangle(triangle: u32) -> Box {
    let first = triangle * 12u + 9u;
    // Nothing hits what has no area.
    if ((normals[first] | normals[first + 1u] | normals[first + 2u]) & 0x7fffffffu) == 0u {
        return NOTHING;
    }
    let a = bitcast<vec3f>(triangles[3u * triangle].xyz);
    let b = bitcast<vec3f>(triangles[3u * triangle + 1u].xyz);
    let c = bitcast<vec3f>(triangles[3u * triangle + 2u].xyz);
    return Box(min(a, min(b, c)), max(a, max(b, c)));
}

// The least power of two of which a grid's steps cover an extent: as the exponent of an f32.
fn exponent(extent_m: f32) -> u32 {
    let step = max(extent_m, LEAST_EXTENT_M) * (1.0 / STEPS) * (1.0 + EXTENT_SLACK);
    let bits = bitcast<u32>(step);
    return (bits >> 23u) + select(0u, 1u, (bits & 0x7fffffu) != 0u);
}

@compute @workgroup_size(64)
fn pose_nodes(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let place = item(group, groups, lane);
    if place >= posing.end {
        return;
    }
    let node = order[place].x;
    let placement = placement_of(order[place].y);
    if (placements[placement + FLAGS_AT] & SHOWN) == 0u {
        return;
    }
    let head = trees[5u * node];
    let links = trees[5u * node + 1u];
    let inner = head.w >> 24u;
    let shift = placements[placement + TRIANGLES_AT];
    var boxes: array<Box, 8>;
    var all_boxes = NOTHING;
    for (var slot = 0u; slot < 8u; slot++) {
        let about = (select(links.z, links.w, slot > 3u) >> (8u * (slot & 3u))) & 0xffu;
        var own = NOTHING;
        if ((inner >> slot) & 1u) != 0u {
            let child = links.x + countOneBits(inner & ((1u << slot) - 1u));
            own = Box(bounds[2u * child].xyz, bounds[2u * child + 1u].xyz);
        } else {
            let first = links.y + (about & 0x1fu) + shift;
            let end = first + countOneBits(about >> 5u);
            for (var triangle = first; triangle < end; triangle++) {
                own = joined(own, box_of_triangle(triangle));
            }
        }
        boxes[slot] = own;
        all_boxes = joined(all_boxes, own);
    }
    bounds[2u * node] = vec4f(all_boxes.low, 0.0);
    bounds[2u * node + 1u] = vec4f(all_boxes.high, 0.0);

    // Around nothing, no ray may visit a child: all boxes are inverted, on the grid of the file's pose.
    var corner = bitcast<vec3f>(head.xyz);
    var exponents = vec3u(head.w, head.w >> 8u, head.w >> 16u) & vec3u(0xffu);
    if is_something(all_boxes) {
        corner = all_boxes.low;
        let extent = all_boxes.high - corner;
        exponents = vec3u(exponent(extent.x), exponent(extent.y), exponent(extent.z));
    }
    // Of powers of two, which multiply exactly.
    let per_m = bitcast<vec3f>((vec3u(254u) - exponents) << vec3u(23u));
    var lows: array<vec2u, 3>;
    var highs: array<vec2u, 3>;
    for (var slot = 0u; slot < 8u; slot++) {
        let own = boxes[slot];
        var low = vec3u(255u);
        var high = vec3u(0u);
        if is_something(own) {
            low = vec3u(clamp(floor((own.low - corner) * per_m - STEP_SLACK), vec3f(0.0), vec3f(STEPS)));
            high = vec3u(clamp(ceil((own.high - corner) * per_m + STEP_SLACK), vec3f(0.0), vec3f(STEPS)));
        }
        let half = slot >> 2u;
        let up = 8u * (slot & 3u);
        for (var axis = 0u; axis < 3u; axis++) {
            lows[axis][half] |= low[axis] << up;
            highs[axis][half] |= high[axis] << up;
        }
    }
    let first_node = placements[placement + FIRST_NODE_AT];
    let nodes_shift = placements[placement + NODES_AT];
    let to = 5u * select(node + nodes_shift, placements[placement + ROOT_AT], node == first_node);
    let packed = exponents.x | (exponents.y << 8u) | (exponents.z << 16u) | (inner << 24u);
    nodes[to] = vec4u(bitcast<vec3u>(corner), packed);
    nodes[to + 1u] = vec4u(links.x + nodes_shift, links.y + shift, links.zw);
    nodes[to + 2u] = vec4u(lows[0], highs[0]);
    nodes[to + 3u] = vec4u(lows[1], highs[1]);
    nodes[to + 4u] = vec4u(lows[2], highs[2]);
}
