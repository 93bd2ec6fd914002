// Walks the hierarchy once for all rays of a block of pixels, and finds the triangles that may stop any of them. The 32
// lanes of a workgroup test the children of four nodes at a time against the shaft that holds the rays.
//
// A list is complete, so a ray that none of its triangles stops is free. It may be in any order and hold too much: the
// rays are tested, and their answers depend on neither.
//
// The kernel that imports this declares `view`, and:
// COVER_ENDS_WALK: whether a triangle that covers the whole shaft is all that counts, or hides what lies behind it;
// ENOUGH_FOUND: how many triangles of leaves are collected before they are tested, at most 32.

#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "visibility/lanes_workgroup.wgsl"
#import "visibility/counts.wgsl"
#import "visibility/lists.wgsl"
#import "visibility/shaft.wgsl"

// The octant of the shaft's direction, as a ray's: the child that is likely the nearest is visited first. 0 where the
// order does not matter.
var<private> walk_octant: u32;

// Nodes that wait for a visit, the next on top.
const WAITING_MOST: u32 = 256u;
// A block that visits more nodes, or finds more triangles, is traced ray by ray: most rays meet few of them.
const VISITS_MOST: u32 = 256u;
const LIST_MOST: u32 = 128u;
// Triangles found in leaves and not yet tested. A round adds at most three a lane, if fewer than 32 are left.
const FOUND_MOST: u32 = 4u * LANES;

var<workgroup> waiting: array<u32, WAITING_MOST>;
var<workgroup> found: array<u32, FOUND_MOST>;
// The kernel may add one entry.
var<workgroup> kept: array<u32, LIST_MOST + 1u>;

// A child that the shaft may reach.
struct Child {
    // A node, or 0, which is the root of something, and so no child.
    node: u32,
    triangle: u32,
    triangles: u32,
}

const NO_CHILD: Child = Child(0u, 0u, 0u);

fn byte_of(words: vec2u, child: u32) -> f32 {
    return f32((select(words.x, words.y, child >= 4u) >> ((child & 3u) * 8u)) & 0xffu);
}

// Child `child` of a node in the form of shared/cwbvh.wgsl.
fn child_of(node: u32, child: u32) -> Child {
    let head = nodes[node * 5u];
    let links = nodes[node * 5u + 1u];
    let x = nodes[node * 5u + 2u];
    let y = nodes[node * 5u + 3u];
    let z = nodes[node * 5u + 4u];
    let about = (select(links.z, links.w, child >= 4u) >> ((child & 3u) * 8u)) & 0xffu;
    let spacing = bitcast<vec3f>((vec3u(head.w, head.w >> 8u, head.w >> 16u) & vec3u(0xffu)) << vec3u(23u));
    let corner = bitcast<vec3f>(head.xyz) - shaft.apex;
    let low = corner + spacing * vec3f(byte_of(x.xy, child), byte_of(y.xy, child), byte_of(z.xy, child));
    let high = corner + spacing * vec3f(byte_of(x.zw, child), byte_of(y.zw, child), byte_of(z.zw, child));
    if about == 0u || misses_box((low + high) * 0.5, (high - low) * 0.5, size_of(corner)) {
        return NO_CHILD;
    }
    let inner = head.w >> 24u;
    if ((inner >> child) & 1u) == 1u {
        return Child(links.x + countOneBits(inner & lanes_below(child)), 0u, 0u);
    }
    return Child(0u, links.y + (about & 0x1fu), countOneBits(about >> 5u));
}

fn lanes_below(lane: u32) -> u32 {
    return (1u << lane) - 1u;
}

// What `find` returns instead of a number of triangles. `kept` begins with the covering one.
const COVERED: u32 = 0xfffffffeu;
const TOO_MANY: u32 = 0xffffffffu;

// Moves the last found triangles that may stop rays to the kept ones, one a lane. Returns how many are kept.
fn keep(found_count: u32, kept_count: u32, lane: u32) -> u32 {
    let place = max(found_count, LANES) - LANES + lane;
    var triangle = 0u;
    var blocking = NO_BLOCKING;
    if place < found_count {
        triangle = found[place];
        blocking = blocking_of(triangle);
    }
    let covering = ballot(blocking.kind == COVERS, lane);
    if covering != 0u {
        if COVER_ENDS_WALK {
            if lane == firstTrailingBit(covering) {
                kept[0] = triangle;
            }
            return COVERED;
        }
        let behind = select(FARTHEST, blocking.depth, blocking.kind == COVERS);
        shaft.depth = min(shaft.depth, least(vec4f(behind), lane).x);
    }
    let keeping = ballot(blocking.kind != MISSES, lane);
    let count = kept_count + countOneBits(keeping);
    if count > LIST_MOST {
        return TOO_MANY;
    }
    if blocking.kind != MISSES {
        kept[kept_count + countOneBits(keeping & lanes_below(lane))] = triangle;
    }
    return count;
}

// Collects the triangles in the shaft. Returns how many are kept.
fn find(lane: u32) -> u32 {
    // The root lies on top.
    var node_count = select(0u, 1u, view.nodes > 0u);
    var visits = 0u;
    var found_count = 0u;
    var kept_count = 0u;
    if lane == 0u {
        waiting[0] = view.root;
    }
    loop {
        workgroupBarrier();
        if found_count >= ENOUGH_FOUND || (node_count == 0u && found_count > 0u) {
            kept_count = keep(found_count, kept_count, lane);
            if kept_count >= COVERED {
                return kept_count;
            }
            found_count = max(found_count, LANES) - LANES;
            continue;
        }
        if node_count == 0u {
            return kept_count;
        }
        // A round takes a node away and adds up to 32.
        if node_count > WAITING_MOST - LANES || visits > VISITS_MOST {
            return TOO_MANY;
        }
        let visited = min(node_count, 4u);
        let rest = node_count - visited;
        var child = NO_CHILD;
        if (lane >> 3u) < visited {
            child = child_of(waiting[rest + (lane >> 3u)], (lane & 7u) ^ walk_octant);
        }
        let with_node = ballot(child.node != 0u, lane);
        let with_one = ballot(child.triangles > 0u, lane);
        let with_two = ballot(child.triangles > 1u, lane);
        let with_three = ballot(child.triangles > 2u, lane);
        workgroupBarrier();
        let below = lanes_below(lane);
        if child.node != 0u {
            waiting[rest + countOneBits(with_node & below)] = child.node;
        }
        let place = found_count + countOneBits(with_one & below) + countOneBits(with_two & below)
            + countOneBits(with_three & below);
        for (var i = 0u; i < child.triangles; i++) {
            found[place + i] = child.triangle + i;
        }
        visits += visited;
        node_count = rest + countOneBits(with_node);
        found_count += countOneBits(with_one) + countOneBits(with_two) + countOneBits(with_three);
    }
    return TOO_MANY;
}

// Writes `count` kept entries into a list, and returns the block's state.
fn write_list(count: u32, lane: u32) -> vec2u {
    let room = of_first(reserve(count, lane), lane);
    if room + count > arrayLength(&lists) {
        return vec2u(STATE_OPEN, 0u);
    }
    for (var i = lane; i < count; i += LANES) {
        lists[room + i] = kept[i];
    }
    return vec2u(count, room);
}

// Where a list may begin. Only the first lane's answer counts.
fn reserve(count: u32, lane: u32) -> u32 {
    if lane > 0u {
        return 0u;
    }
    return atomicAdd(&counts[LISTS_END], count);
}
