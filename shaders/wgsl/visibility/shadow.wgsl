// Which of the wanted lights reach each pixel: rule 5 of server/src/visibility/mod.rs. A workgroup is one tile and one
// light, and writes that tile's two words of the mask, also when they are zero.

#import "shared/mask.wgsl"
#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "shared/cwbvh.wgsl"
#import "shared/alpha.wgsl"

var<immediate> view: TracedView;

// As visibility/primary.wgsl wrote them.
@group(1) @binding(0) var<storage, read_write> surfaces: array<vec4u>;
@group(1) @binding(1) var<storage, read_write> mask: array<u32>;

var<workgroup> tile_words: array<atomic<u32>, 2>;

// Whether anything stands on the ray before `limit`.
fn is_blocked(ray: Ray, limit: f32) -> bool {
    var stack: array<vec2u, TRAVERSAL_STACK>;
    var depth = 0u;
    var group = select(vec2u(0u), ROOT_GROUP, view.nodes > 0u);
    loop {
        if (group.y & GROUP_NODES) == 0u {
            if depth == 0u {
                break;
            }
            depth -= 1u;
            group = stack[depth];
        }
        let bit = firstLeadingBit(group.y);
        let node = group_node(group, bit, ray.octant);
        group.y &= ~(1u << bit);
        if (group.y & GROUP_NODES) != 0u && depth < TRAVERSAL_STACK {
            stack[depth] = group;
            depth += 1u;
        }
        let hits = node_hits(node, ray, limit);
        group = vec2u(hits.child_base, (hits.bits & GROUP_NODES) | hits.inner);
        var candidates = hits.bits & ~GROUP_NODES;
        while candidates != 0u {
            let candidate = firstTrailingBit(candidates);
            candidates &= candidates - 1u;
            let triangle = hits.triangle_base + candidate;
            let a = triangles[triangle * 3u];
            let b = triangles[triangle * 3u + 1u];
            let c = triangles[triangle * 3u + 2u];
            let met = meet_triangle(ray, triangle, bitcast<vec3f>(a.xyz), bitcast<vec3f>(b.xyz),
                bitcast<vec3f>(c.xyz));
            if met.clear && met.distance > 0.0 && met.distance < limit
                && triangle_is_there(triangle, a.w, met.weights) {
                return true;
            }
        }
    }
    return false;
}

@compute @workgroup_size(8, 8)
fn shadow(
    @builtin(workgroup_id) place: vec3u,
    @builtin(num_workgroups) tiles: vec3u,
    @builtin(local_invocation_id) local: vec3u,
) {
    let bit = mask_bit(local.xy);
    let tile = place.y * tiles.x + place.x;
    let seen = surfaces[tile * 64u + bit];
    if ((seen.w >> place.z) & 1u) == 1u {
        let start = bitcast<vec3f>(seen.xyz);
        let light = lights[place.z];
        let directional = light.kind == LIGHT_DIRECTIONAL;
        let direction = select(light.position - start, -light.direction, directional);
        if !is_blocked(make_ray(start, direction), select(1.0, FARTHEST, directional)) {
            atomicOr(&tile_words[bit >> 5u], 1u << (bit & 31u));
        }
    }
    workgroupBarrier();
    if bit < 2u {
        mask[mask_word(place.z, tiles.x * tiles.y, tile, bit * 32u)] = atomicLoad(&tile_words[bit]);
    }
}
