// Traverses the compressed hierarchy. Imported by the kernels, which declare `view`. visibility/ray_query.wgsl has the
// same two functions for adapters with their own structure.

#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "shared/cwbvh.wgsl"
#import "shared/alpha.wgsl"
#import "visibility/closest_hit.wgsl"

fn intersect(ray: Ray) -> ClosestHit {
    var closest = ClosestHit(NOTHING, vec3f(0.0), false);
    var limit = FARTHEST;
    var stack: array<vec2u, TRAVERSAL_STACK>;
    var depth = 0u;
    var group = vec2u(view.root, select(0u, ROOT_BITS, view.nodes > 0u));
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
        let children = node_hits(node, ray, limit);
        group = vec2u(children.child_base, (children.bits & GROUP_NODES) | children.inner);
        var candidates = children.bits & ~GROUP_NODES;
        while candidates != 0u {
            let candidate = firstTrailingBit(candidates);
            candidates &= candidates - 1u;
            let triangle = children.triangle_base + candidate;
            let a = triangles[triangle * 3u];
            let b = triangles[triangle * 3u + 1u];
            let c = triangles[triangle * 3u + 2u];
            let hit = intersect_triangle(ray, triangle, bitcast<vec3f>(a.xyz), bitcast<vec3f>(b.xyz),
                bitcast<vec3f>(c.xyz));
            if hit.clear && hit.distance > 0.0 && is_closer(hit.distance, triangle, limit, closest.triangle)
                && (hit.front || (a.w & TRIANGLE_SINGLE_SIDED) == 0u)
                && passes_alpha_test(triangle, a.w, hit.weights) {
                limit = hit.distance;
                closest = ClosestHit(triangle, hit.weights, hit.front);
            }
        }
    }
    return closest;
}

// True if a triangle stops the ray before its end.
fn occluded(ray: Ray, end: End) -> bool {
    var stack: array<vec2u, TRAVERSAL_STACK>;
    var depth = 0u;
    var group = vec2u(view.root, select(0u, ROOT_BITS, view.nodes > 0u));
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
        let children = node_hits(node, ray, end.limit);
        group = vec2u(children.child_base, (children.bits & GROUP_NODES) | children.inner);
        var candidates = children.bits & ~GROUP_NODES;
        while candidates != 0u {
            let candidate = firstTrailingBit(candidates);
            candidates &= candidates - 1u;
            let triangle = children.triangle_base + candidate;
            let a = triangles[triangle * 3u];
            let b = triangles[triangle * 3u + 1u];
            let c = triangles[triangle * 3u + 2u];
            let corner_a = bitcast<vec3f>(a.xyz);
            let hit = intersect_triangle(ray, triangle, corner_a, bitcast<vec3f>(b.xyz), bitcast<vec3f>(c.xyz));
            if is_between(hit, triangle, corner_a, end) && passes_alpha_test(triangle, a.w, hit.weights) {
                return true;
            }
        }
    }
    return false;
}
