// Rays through the adapter's own acceleration structure: takes the place of visibility/traverse.wgsl in the kernels, which
// declare `view`. Its text wants `enable wgpu_ray_query;` in front.
//
// The adapter offers triangles, and everything is decided here as everywhere. Its structure holds every triangle a little
// enlarged (backend/ray_query/pad.rs), since not every adapter's own test is watertight: what it offers is more than what the
// ray meets, and our test says which of it that is. No geometry is marked opaque, so every triangle comes as a candidate. A
// shadow ray seldom sees more than one, for the first that is there ends it.

#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "shared/alpha.wgsl"
#import "visibility/nearest.wgsl"

@group(0) @binding(7) var structure: acceleration_structure;

// A triangle that the adapter offers, as the ray meets its plane. Triangles are in the order of `triangles`.
fn meet_candidate(ray: Ray, triangle: u32) -> Meeting {
    let a = bitcast<vec3f>(triangles[triangle * 3u].xyz);
    let b = bitcast<vec3f>(triangles[triangle * 3u + 1u].xyz);
    let c = bitcast<vec3f>(triangles[triangle * 3u + 2u].xyz);
    return meet_triangle(ray, triangle, a, b, c);
}

fn nearest(ray: Ray) -> Nearest {
    var found = Nearest(NOTHING, vec3f(0.0), false);
    if view.nodes == 0u {
        return found;
    }
    var limit = FARTHEST;
    var query: ray_query;
    rayQueryInitialize(&query, structure, RayDesc(RAY_FLAG_NONE, 0xffu, 0.0, FARTHEST, ray.origin, ray.slanted));
    while rayQueryProceed(&query) {
        let triangle = rayQueryGetCandidateIntersection(&query).primitive_index;
        let kind = triangles[triangle * 3u].w;
        let met = meet_candidate(ray, triangle);
        if met.clear && met.distance > 0.0 && met.distance < limit && (met.front || (kind & TRIANGLE_SINGLE_SIDED) == 0u)
            && triangle_is_there(triangle, kind, met.weights) {
            limit = met.distance;
            found = Nearest(triangle, met.weights, met.front);
            // What lies behind need not be offered any more.
            rayQueryConfirmIntersection(&query);
        }
    }
    return found;
}

// Whether anything stands on the ray before its end.
fn is_blocked(ray: Ray, end: End) -> bool {
    if view.nodes == 0u {
        return false;
    }
    var query: ray_query;
    rayQueryInitialize(&query, structure,
        RayDesc(RAY_FLAG_TERMINATE_ON_FIRST_HIT, 0xffu, 0.0, end.limit, ray.origin, ray.slanted));
    while rayQueryProceed(&query) {
        let triangle = rayQueryGetCandidateIntersection(&query).primitive_index;
        let met = meet_candidate(ray, triangle);
        let corner = triangles[triangle * 3u];
        if stands_between(met, triangle, bitcast<vec3f>(corner.xyz), end)
            && triangle_is_there(triangle, corner.w, met.weights) {
            return true;
        }
    }
    return false;
}
