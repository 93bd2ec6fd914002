// Finds the surface points of each block of pixels among the block's list. A workgroup takes a block, so its 256 rays
// share what is read of a triangle. The first layer of workgroups traces the rays of blocks without a list: few, and
// they take long, so they go first, and lists are tested beside them.

#import "shared/mask.wgsl"
#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "shared/alpha.wgsl"
#import "visibility/counts.wgsl"
#import "visibility/lists.wgsl"
#import "visibility/candidates.wgsl"
#import "visibility/primary_queued.wgsl"
#import "visibility/frustum.wgsl"
#import "visibility/primary_ray.wgsl"
#import "visibility/surface.wgsl"

var<immediate> view: TracedView;

const QUEUE: u32 = PRIMARY_QUEUE;

// As in visibility/primary.wgsl.
@group(1) @binding(0) var<storage, read_write> surfaces: array<vec4u>;

var<workgroup> block_pixels_seen: atomic<u32>;
// Whether a ray hits nothing before the depth from which on triangles are not listed.
var<workgroup> is_beyond_list: atomic<u32>;

// Where the closest hit is, with its distance along the ray.
struct Nearest {
    hit: ClosestHit,
    distance: f32,
}

// As `intersect` asks of each triangle, but the plane first: most rays share its answer.
fn nearer(candidate: u32, ray: Ray, nearest: Nearest) -> Nearest {
    let triangle = candidates[candidate].triangle;
    let corner_a = candidates[candidate].corner_a;
    let normal = candidates[candidate].normal;
    let kind = candidates[candidate].kind;
    let to_a = corner_a - ray.origin;
    let height = dot(normal, to_a);
    let distance = height / dot(normal, ray.direction);
    if !is_off_plane(normal, to_a, height) || distance <= 0.0
        || !is_closer(distance, triangle, nearest.distance, nearest.hit.triangle) {
        return nearest;
    }
    let areas = areas_across(ray, corner_a, candidates[candidate].corner_b, candidates[candidate].corner_c);
    let area = areas.x + areas.y + areas.z;
    let front = area > 0.0;
    if is_beside(areas) || area == 0.0 || (!front && (kind & TRIANGLE_SINGLE_SIDED) != 0u)
        || !passes_alpha_test(triangle, kind, areas / area) {
        return nearest;
    }
    return Nearest(ClosestHit(triangle, areas / area, front), distance);
}

@compute @workgroup_size(256)
fn primary_listed(
    @builtin(workgroup_id) block: vec3u,
    @builtin(num_workgroups) blocks: vec3u,
    @builtin(local_invocation_index) number: u32,
) {
    if block.z == 0u {
        let first = block.y * blocks.x + block.x;
        if first == 0u && number == 0u {
            // Those of an earlier part are done with.
            atomicStore(&counts[SHADOW_QUEUE], 0u);
            atomicStore(&counts[SHADOW_QUEUE + 1u], 0u);
        }
        let end = atomicLoad(&counts[QUEUE]);
        for (var i = first; i < end; i += blocks.x * blocks.y) {
            trace_queued(i, number);
        }
        return;
    }
    let at = states_at(block.xy * BLOCK_TILES);
    let state = states[at];
    if state.x == STATE_OPEN {
        return;
    }
    if number == 0u {
        atomicStore(&is_beyond_list, 0u);
        atomicStore(&block_pixels_seen, 0u);
    }
    let place = block_pixel(block.xy, number);
    let is_seen = place.is_inside && place.pixel.x < view.width && place.pixel.y < view.height;
    let direction = pixel_direction(place.pixel);
    let ray = make_ray(view.origin, direction);
    var nearest = Nearest(ClosestHit(NOTHING, vec3f(0.0), false), FARTHEST);
    let count = state.x - 1u;
    for (var first = 0u; first < count; first += CHUNK) {
        let read = min(count - first, CHUNK);
        workgroupBarrier();
        if number < read {
            candidates[number] = candidate_of(lists[state.y + first + number]);
        }
        workgroupBarrier();
        if is_seen {
            for (var i = 0u; i < read; i++) {
                nearest = nearer(i, ray, nearest);
            }
        }
    }
    let depth = bitcast<f32>(lists[state.y + count]);
    workgroupBarrier();
    if is_seen {
        atomicAdd(&block_pixels_seen, 1u);
        if depth < FARTHEST && !(nearest.distance * dot(block_axis(block.xy), direction) < depth) {
            atomicStore(&is_beyond_list, 1u);
        }
    }
    workgroupBarrier();
    if atomicLoad(&is_beyond_list) == 1u {
        if number == 0u {
            queue_again(block.xy, 0u);
        }
        return;
    }
    var seen = vec4u(0u);
    if nearest.hit.triangle != NOTHING {
        seen = surface(nearest.hit);
    }
    take(place, seen, number);
    if number == 0u {
        atomicAdd(&counts[COUNT_PRIMARY_LISTED], atomicLoad(&block_pixels_seen));
    }
}
