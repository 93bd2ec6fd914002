// Rays through the compressed hierarchy: imported by the kernels, which declare `view`. visibility/ray_query.wgsl has the
// same two functions for adapters that walk a hierarchy of their own.

#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "shared/cwbvh.wgsl"
#import "shared/alpha.wgsl"
#import "visibility/nearest.wgsl"
#import "visibility/work.wgsl"

fn nearest(ray: Ray) -> Nearest {
    var found = Nearest(NOTHING, vec3f(0.0), false);
    var limit = FARTHEST;
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
        if COUNT_NODES {
            node_visits += 1u;
        }
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
            if met.clear && met.distance > 0.0 && met.distance < limit && (met.front || (a.w & TRIANGLE_SINGLE_SIDED) == 0u)
                && triangle_is_there(triangle, a.w, met.weights) {
                limit = met.distance;
                found = Nearest(triangle, met.weights, met.front);
            }
        }
    }
    return found;
}

// Whether anything stands on the ray before its end.
fn is_blocked(ray: Ray, end: End) -> bool {
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
        let hits = node_hits(node, ray, end.limit);
        if COUNT_NODES {
            node_visits += 1u;
        }
        group = vec2u(hits.child_base, (hits.bits & GROUP_NODES) | hits.inner);
        var candidates = hits.bits & ~GROUP_NODES;
        while candidates != 0u {
            let candidate = firstTrailingBit(candidates);
            candidates &= candidates - 1u;
            let triangle = hits.triangle_base + candidate;
            let a = triangles[triangle * 3u];
            let b = triangles[triangle * 3u + 1u];
            let c = triangles[triangle * 3u + 2u];
            let corner_a = bitcast<vec3f>(a.xyz);
            let met = meet_triangle(ray, triangle, corner_a, bitcast<vec3f>(b.xyz), bitcast<vec3f>(c.xyz));
            if stands_between(met, triangle, corner_a, end) && triangle_is_there(triangle, a.w, met.weights) {
                return true;
            }
        }
    }
    return false;
}
