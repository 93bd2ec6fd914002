// Traces the shadow rays of blocks whose list did not do one by one. Few are left, so few workgroups take them in
// turns.

#import "shared/mask.wgsl"
#import "shared/traced_scene.wgsl"
#import "visibility/counts.wgsl"
#import "visibility/lists.wgsl"
#import "visibility/shadow_queued.wgsl"

var<immediate> view: TracedView;

const QUEUE: u32 = SHADOW_QUEUE;

// Written by the kernels of primary rays.
@group(1) @binding(0) var<storage, read_write> surfaces: array<vec4u>;
@group(1) @binding(1) var<storage, read_write> mask: array<u32>;

@compute @workgroup_size(256)
fn shadow_rest(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) number: u32,
) {
    if group.x == 0u && number == 0u {
        // This part's lists are done with.
        atomicStore(&counts[LISTS_END], 0u);
    }
    let count = atomicLoad(&counts[QUEUE + 1u]);
    for (var i = group.x; i < count; i += groups.x) {
        trace_queued(arrayLength(&queue) - 1u - i, number);
    }
}
