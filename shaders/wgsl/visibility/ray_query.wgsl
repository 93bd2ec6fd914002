// Traverses the adapter's own acceleration structure. Replaces visibility/traverse.wgsl in the kernels, which declare
// `view`. The text must begin with `enable wgpu_ray_query;`.
//
// The adapter only finds candidates; our own tests decide. Its structure holds every triangle slightly enlarged
// (backend/compute/enlarge.rs), because not every adapter's test is watertight. So there are more candidates than hits.
// No geometry is marked opaque, so every triangle becomes a candidate. A shadow ray seldom has more than one, because
// its first hit ends it.

#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "shared/alpha.wgsl"
#import "visibility/closest_hit.wgsl"

@group(0) @binding(7) var structure: acceleration_structure;

// Marks the instance of what moves. Twin: `MOVES` in backend/compute/acceleration.rs.
const MOVES: u32 = 1u;

// The triangle of a candidate. What rests is numbered as in `triangles`, and what moves from its first one on.
fn candidate_triangle(candidate: RayIntersection) -> u32 {
    return candidate.primitive_index + select(0u, view.root, candidate.instance_custom_data == MOVES);
}

// Our own test of a candidate.
fn intersect_candidate(ray: Ray, triangle: u32) -> Hit {
    let a = bitcast<vec3f>(triangles[triangle * 3u].xyz);
    let b = bitcast<vec3f>(triangles[triangle * 3u + 1u].xyz);
    let c = bitcast<vec3f>(triangles[triangle * 3u + 2u].xyz);
    return intersect_triangle(ray, triangle, a, b, c);
}

fn intersect(ray: Ray) -> ClosestHit {
    var closest = ClosestHit(NOTHING, vec3f(0.0), false);
    if view.nodes == 0u {
        return closest;
    }
    var limit = FARTHEST;
    var query: ray_query;
    rayQueryInitialize(&query, structure, RayDesc(RAY_FLAG_NONE, 0xffu, 0.0, FARTHEST, ray.origin, ray.slanted));
    while rayQueryProceed(&query) {
        let triangle = candidate_triangle(rayQueryGetCandidateIntersection(&query));
        let kind = triangles[triangle * 3u].w;
        let hit = intersect_candidate(ray, triangle);
        if hit.clear && hit.distance > 0.0 && hit.distance < limit
            && (hit.front || (kind & TRIANGLE_SINGLE_SIDED) == 0u)
            && passes_alpha_test(triangle, kind, hit.weights) {
            limit = hit.distance;
            closest = ClosestHit(triangle, hit.weights, hit.front);
            // Farther candidates are no longer needed.
            rayQueryConfirmIntersection(&query);
        }
    }
    return closest;
}

// True if a triangle stops the ray before its end.
fn occluded(ray: Ray, end: End) -> bool {
    if view.nodes == 0u {
        return false;
    }
    var query: ray_query;
    rayQueryInitialize(&query, structure,
        RayDesc(RAY_FLAG_TERMINATE_ON_FIRST_HIT, 0xffu, 0.0, end.limit, ray.origin, ray.slanted));
    while rayQueryProceed(&query) {
        let triangle = candidate_triangle(rayQueryGetCandidateIntersection(&query));
        let hit = intersect_candidate(ray, triangle);
        let corner = triangles[triangle * 3u];
        if is_between(hit, triangle, bitcast<vec3f>(corner.xyz), end)
            && passes_alpha_test(triangle, corner.w, hit.weights) {
            return true;
        }
    }
    return false;
}
