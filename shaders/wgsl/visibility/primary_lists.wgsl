// Finds, for each block of pixels, the triangles that its primary rays may hit first. After them a list has the depth,
// along the block's axis, behind which triangles are not listed.
//
// A triangle that covers the block hides what lies behind it. That every ray hits something before is tested later, so
// the cover needs no proof.

#import "shared/mask.wgsl"
#import "shared/traced_scene.wgsl"
#import "visibility/lanes_workgroup.wgsl"
#import "visibility/counts.wgsl"
#import "visibility/lists.wgsl"
#import "visibility/frustum.wgsl"
#import "visibility/primary_ray.wgsl"
#import "visibility/shaft.wgsl"
#import "visibility/block_walk.wgsl"

var<immediate> view: TracedView;

const QUEUE: u32 = PRIMARY_QUEUE;

const COVER_ENDS_WALK: bool = false;
// Few, so that covering triangles are known early.
const ENOUGH_FOUND: u32 = 8u;

// Margin of a ray's place in the picture, as a share of the sizes of the vectors that make its direction, over its
// depth: 32 u. The place in the whole picture is off by 11 u, products and sums by 3 u, both here and in the ray. Two
// places make 4 u.
const FRUSTUM_SLACK: f32 = 1.9073486328125e-6;

// Sets the shaft around a block's rays. False if it is wider than a right angle.
fn set_frustum(block: vec2u, lane: u32) -> bool {
    let pixels = block_pixels(block);
    shaft.apex = view.origin;
    shaft.axis = block_axis(block);
    shaft.side = normalize(view.right - shaft.axis * dot(shaft.axis, view.right));
    shaft.upright = cross(shaft.axis, shaft.side);
    shaft.is_beam = false;
    shaft.has_starts = false;
    // In the picture, pixels lie between the corners.
    let corner = select(pixels.xy, pixels.zw - 1u, vec2<bool>((lane & 1u) != 0u, (lane & 2u) != 0u));
    let seen = picture(pixel_direction(corner));
    let margin = FRUSTUM_SLACK * (size_of(view.forward) + size_of(view.right) + size_of(view.up)) / seen.z;
    shaft.low = least(vec4f(seen.xy / seen.z - margin, 0.0, 0.0), lane).xy;
    shaft.high = greatest(vec4f(seen.xy / seen.z + margin, 0.0, 0.0), lane).xy;
    shaft.depth = FARTHEST;
    // The rays start at the apex, so a corner's distance from there is all that their test rounds.
    shaft.reach = 0.0;
    shaft.base = vec3f(0.0);
    shaft.base_height = -FARTHEST;
    shaft.centre = vec3f(0.0);
    shaft.half = vec3f(0.0);
    let positive = select(vec3u(4u, 2u, 1u), vec3u(0u), shaft.axis < vec3f(0.0));
    walk_octant = positive.x | positive.y | positive.z;
    return max(max(-shaft.low.x, -shaft.low.y), max(shaft.high.x, shaft.high.y)) <= 1.0;
}

// Drops kept triangles behind the nearest cover. Returns how many are left.
fn keep_near(count: u32, lane: u32) -> u32 {
    var near = 0u;
    for (var first = 0u; first < count; first += LANES) {
        let is_one = first + lane < count;
        let triangle = kept[min(first + lane, LIST_MOST)];
        var stays = false;
        if is_one {
            stays = blocking_of(triangle).kind != MISSES;
        }
        let staying = ballot(stays, lane);
        workgroupBarrier();
        if stays {
            kept[near + countOneBits(staying & lanes_below(lane))] = triangle;
        }
        near += countOneBits(staying);
        workgroupBarrier();
    }
    return near;
}

@compute @workgroup_size(32)
fn primary_lists(@builtin(workgroup_id) place: vec3u, @builtin(local_invocation_index) lane: u32) {
    var count = TOO_MANY;
    if set_frustum(place.xy, lane) {
        count = find(lane);
    }
    workgroupBarrier();
    var state = vec2u(STATE_OPEN, 0u);
    if count != TOO_MANY {
        count = keep_near(count, lane);
        if lane == 0u {
            kept[count] = bitcast<u32>(shaft.depth);
        }
        workgroupBarrier();
        state = write_list(count + 1u, lane);
    }
    if lane == 0u {
        states[states_at(place.xy * BLOCK_TILES)] = state;
        if state.x == STATE_OPEN {
            queue_without_list(place.xy, 0u);
        }
    }
}
