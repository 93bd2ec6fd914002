// Tests the shadow rays of each block of pixels and each light against the block's list. A workgroup takes a block, so
// its 256 rays share what is read of a triangle. The first layer of workgroups traces the rays of blocks without a
// list: few, and they take long, so they go first, and lists are tested beside them.

#import "shared/mask.wgsl"
#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "shared/alpha.wgsl"
#import "visibility/lists.wgsl"
#import "visibility/candidates.wgsl"
#import "visibility/shadow_queued.wgsl"
#import "visibility/shadow_ray.wgsl"

var<immediate> view: TracedView;

const QUEUE: u32 = SHADOW_QUEUE;

// Written by the kernels of primary rays.
@group(1) @binding(0) var<storage, read_write> surfaces: array<vec4u>;
@group(1) @binding(1) var<storage, read_write> mask: array<u32>;

// Whether a ray passes the triangle that should cover the light.
var<workgroup> is_lit_beside_cover: atomic<u32>;

// As `occluded` asks of each triangle, but the plane first: most rays share its answer.
fn is_stopped_by(candidate: u32, ray: Ray, end: End) -> bool {
    let corner_a = candidates[candidate].corner_a;
    let normal = candidates[candidate].normal;
    let to_a = corner_a - ray.origin;
    let height = dot(normal, to_a);
    let distance = height / dot(normal, ray.direction);
    if !is_off_plane(normal, to_a, height) || distance <= 0.0 || distance >= end.limit {
        return false;
    }
    let areas = areas_across(ray, corner_a, candidates[candidate].corner_b, candidates[candidate].corner_c);
    let area = areas.x + areas.y + areas.z;
    return !is_beside(areas) && area != 0.0 && is_end_off_plane(normal, corner_a, end)
        && passes_alpha_test(candidates[candidate].triangle, candidates[candidate].kind, areas / area);
}

@compute @workgroup_size(256)
fn shadow_listed(
    @builtin(workgroup_id) place: vec3u,
    @builtin(num_workgroups) blocks: vec3u,
    @builtin(local_invocation_index) number: u32,
) {
    if place.z == 0u {
        let first = place.y * blocks.x + place.x;
        if first == 0u && number == 0u {
            // Those of primary rays are done with.
            atomicStore(&counts[PRIMARY_QUEUE], 0u);
            atomicStore(&counts[PRIMARY_QUEUE + 1u], 0u);
        }
        let end = atomicLoad(&counts[QUEUE]);
        for (var i = first; i < end; i += blocks.x * blocks.y) {
            trace_queued(i, number);
        }
        return;
    }
    let block = vec3u(place.xy, place.z - 1u);
    let at = states_at(block.xy * BLOCK_TILES) + block.z;
    let state = states[at];
    if state.x == STATE_OPEN {
        return;
    }
    if number < 8u {
        atomicStore(&block_words[number], 0u);
    }
    if number == 0u {
        atomicStore(&is_lit_beside_cover, 0u);
    }
    let pixel = block_pixel(block.xy, number);
    var seen = vec4u(0u);
    if pixel.is_inside {
        seen = surfaces[pixel.tile * 64u + pixel.bit];
    }
    var lit = ((seen.w >> block.z) & 1u) == 1u;
    let light = lights[view.first_light + block.z];
    let ray = shadow_ray(bitcast<vec3f>(seen.xyz), light);
    let end = shadow_end(light);
    let is_covered = state.x == STATE_COVERED;
    let count = select(state.x, 1u, is_covered);
    for (var first = 0u; first < count; first += CHUNK) {
        let read = min(count - first, CHUNK);
        workgroupBarrier();
        if number < read {
            var triangle = state.y;
            if !is_covered {
                triangle = lists[state.y + first + number];
            }
            candidates[number] = candidate_of(triangle);
        }
        workgroupBarrier();
        if lit {
            for (var i = 0u; i < read; i++) {
                if is_stopped_by(i, ray, end) {
                    lit = false;
                    break;
                }
            }
        }
    }
    workgroupBarrier();
    if lit {
        atomicOr(&block_words[number >> 5u], 1u << (number & 31u));
        if is_covered {
            atomicStore(&is_lit_beside_cover, 1u);
        }
    }
    workgroupBarrier();
    if atomicLoad(&is_lit_beside_cover) == 1u {
        // Whether other triangles stop this ray is not known.
        if number == 0u {
            queue_again(block.xy, block.z);
        }
        return;
    }
    write_words(pixel, block.z, number);
}
