// Finds, for each block of pixels and each light, the triangles that may stop the shadow rays.

#import "shared/mask.wgsl"
#import "shared/traced_scene.wgsl"
#import "visibility/lanes_workgroup.wgsl"
#import "visibility/counts.wgsl"
#import "visibility/lists.wgsl"
#import "visibility/shadow_shaft.wgsl"
#import "visibility/block_walk.wgsl"

var<immediate> view: TracedView;

const QUEUE: u32 = SHADOW_QUEUE;

// Written by the kernels of primary rays.
@group(1) @binding(0) var<storage, read_write> surfaces: array<vec4u>;

// Pixels of a block that each lane has.
const PIXELS: u32 = BLOCK_TILES * BLOCK_TILES * 64u / LANES;

const COVER_ENDS_WALK: bool = true;
const ENOUGH_FOUND: u32 = LANES;

var<private> block: vec2u;
var<private> own_light: u32;

// The start of one of a lane's rays.
fn start_of(i: u32, lane: u32) -> Start {
    let pixel = block_pixel(block, i * LANES + lane);
    if !pixel.is_inside {
        return Start(vec3f(0.0), false, vec2f(0.0));
    }
    let seen = surfaces[pixel.tile * 64u + pixel.bit];
    let side = vec2f(select(-1.0, 1.0, (pixel.within & 1u) != 0u), select(-1.0, 1.0, (pixel.within & 2u) != 0u));
    return Start(bitcast<vec3f>(seen.xyz), ((seen.w >> own_light) & 1u) == 1u, side);
}

@compute @workgroup_size(32)
fn shadow_lists(@builtin(workgroup_id) place: vec3u, @builtin(local_invocation_index) lane: u32) {
    block = place.xy;
    own_light = place.z;
    let light = lights[view.first_light + place.z];
    var rays = 0u;
    for (var i = 0u; i < PIXELS; i++) {
        rays += countOneBits(ballot(start_of(i, lane).counts, lane));
    }
    var state = vec2u(0u);
    if rays > 0u {
        var count = TOO_MANY;
        if set_shaft(light, PIXELS, lane) {
            count = find(lane);
        }
        workgroupBarrier();
        if count == COVERED {
            state = vec2u(STATE_COVERED, kept[0]);
        } else if count == TOO_MANY {
            state = vec2u(STATE_OPEN, 0u);
        } else if count > 0u {
            state = write_list(count, lane);
        }
    }
    if lane == 0u {
        states[states_at(block * BLOCK_TILES) + own_light] = state;
        if state.x == STATE_OPEN {
            queue_without_list(block, own_light);
        }
        if rays > 0u && state.x != STATE_OPEN {
            let found = select(COUNT_LISTED, COUNT_PROVEN_LIT, state.x == 0u);
            atomicAdd(&counts[select(found, COUNT_PROVEN_DARK, state.x == STATE_COVERED)], rays);
        }
    }
}
