// One step through obvhs' eight-wide compressed hierarchy (Ylitie, Karras, Laine, "Efficient Incoherent Ray Traversal
// on GPUs Through Compressed Wide BVHs", HPG 2017).
//
// A node: corner (3 × f32); exponents of the grid's spacing (3 × u8) and a mask of the children that are nodes (u8);
// first child; first triangle; a byte for each child; then for x, y, z the children's lower and upper planes, a byte
// each.

#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"

// Entries of a traversal stack. Every level pushes at most one, so this also bounds a hierarchy's depth. Twin:
// `host::TRAVERSAL_STACK`.
const TRAVERSAL_STACK: u32 = 32u;

// Planes move outwards by this share of the distances involved. Rounding in obvhs' quantisation (2 units of 2⁻²⁴), in
// this test (7) and in the triangle test's projection of the ray (4) stays below 16 units.
const SLACK: f32 = 9.5367431640625e-7;

struct NodeHits {
    // Index of the first child node and of the first triangle.
    child_base: u32,
    triangle_base: u32,
    // Bits 31 to 24: children to visit, the highest first; bits 23 to 0: triangles to test.
    bits: u32,
    // Which children are nodes.
    inner: u32,
}

// Which of four children the ray hits, as bits.
fn quad_hits(
    near: vec3u, far: vec3u, scale: vec3f, base_in: vec3f, base_out: vec3f, limit: f32,
) -> u32 {
    let in_x = fma(vec4f(unpack4xU8(near.x)), vec4f(scale.x), vec4f(base_in.x));
    let in_y = fma(vec4f(unpack4xU8(near.y)), vec4f(scale.y), vec4f(base_in.y));
    let in_z = fma(vec4f(unpack4xU8(near.z)), vec4f(scale.z), vec4f(base_in.z));
    let out_x = fma(vec4f(unpack4xU8(far.x)), vec4f(scale.x), vec4f(base_out.x));
    let out_y = fma(vec4f(unpack4xU8(far.y)), vec4f(scale.y), vec4f(base_out.y));
    let out_z = fma(vec4f(unpack4xU8(far.z)), vec4f(scale.z), vec4f(base_out.z));
    let enter = max(max(in_x, in_y), max(in_z, vec4f(0.0)));
    let leave = min(min(out_x, out_y), min(out_z, vec4f(limit)));
    let hits = select(vec4u(0u), vec4u(1u, 2u, 4u, 8u), enter <= leave);
    return hits.x | hits.y | hits.z | hits.w;
}

fn node_hits(index: u32, ray: Ray, limit: f32) -> NodeHits {
    let first = index * 5u;
    let head = nodes[first];
    let links = nodes[first + 1u];
    let x = nodes[first + 2u];
    let y = nodes[first + 3u];
    let z = nodes[first + 4u];

    let corner = bitcast<vec3f>(head.xyz) - ray.origin;
    let spacing = bitcast<vec3f>((vec3u(head.w, head.w >> 8u, head.w >> 16u) & vec3u(0xffu)) << vec3u(23u));
    let scale = spacing * ray.inverse;
    let base = corner * ray.inverse;
    // Of the distances along the ray.
    let slack = SLACK * fma(vec3f(255.0), abs(scale), abs(base));

    let back = ray.direction < vec3f(0.0);
    let near_x = select(x.xy, x.zw, back.x);
    let near_y = select(y.xy, y.zw, back.y);
    let near_z = select(z.xy, z.zw, back.z);
    let far_x = select(x.zw, x.xy, back.x);
    let far_y = select(y.zw, y.xy, back.y);
    let far_z = select(z.zw, z.xy, back.z);

    let low = quad_hits(vec3u(near_x.x, near_y.x, near_z.x), vec3u(far_x.x, far_y.x, far_z.x), scale, base - slack,
        base + slack, limit);
    let high = quad_hits(vec3u(near_x.y, near_y.y, near_z.y), vec3u(far_x.y, far_y.y, far_z.y), scale, base - slack,
        base + slack, limit);
    let hits = low | (high << 4u);
    let inner = head.w >> 24u;
    // The highest bit is the nearest node: a node's number is XORed with the octant, one bit at a time.
    var nodes_hit = hits & inner;
    nodes_hit = select(nodes_hit, (nodes_hit << 4u) | (nodes_hit >> 4u), (ray.octant & 4u) != 0u);
    nodes_hit = select(nodes_hit, ((nodes_hit & 0x33u) << 2u) | ((nodes_hit >> 2u) & 0x33u), (ray.octant & 2u) != 0u);
    nodes_hit = select(nodes_hit, ((nodes_hit & 0x55u) << 1u) | ((nodes_hit >> 1u) & 0x55u), (ray.octant & 1u) != 0u);
    var bits = nodes_hit << 24u;
    var leaves = hits & ~inner;
    while leaves != 0u {
        let child = firstTrailingBit(leaves);
        leaves &= leaves - 1u;
        let about = select(links.z, links.w, child >= 4u) >> ((child & 3u) * 8u);
        bits |= ((about >> 5u) & 7u) << (about & 31u);
    }
    return NodeHits(links.x, links.y, bits, inner);
}

// The state of a traversal: a group of sibling nodes that the ray hits. `x` is the index of the first sibling. Bits 31
// to 24 of `y` are siblings to visit; bits 7 to 0 mark the slots of their parent that hold nodes.
const GROUP_NODES: u32 = 0xff000000u;
// `y` of a group whose first and only node is a root.
const ROOT_BITS: u32 = 0x80000000u;

// The index of the group's node at bit `bit`.
fn group_node(group: vec2u, bit: u32, octant: u32) -> u32 {
    let place = (bit - 24u) ^ octant;
    return group.x + countOneBits(group.y & ~(0xffffffffu << place));
}
