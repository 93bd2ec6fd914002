// Finds the surface points of blocks whose list did not do ray by ray. Few are left, so few workgroups take them in
// turns.

#import "shared/mask.wgsl"
#import "shared/traced_scene.wgsl"
#import "visibility/counts.wgsl"
#import "visibility/lists.wgsl"
#import "visibility/primary_queued.wgsl"

var<immediate> view: TracedView;

const QUEUE: u32 = PRIMARY_QUEUE;

// As in visibility/primary.wgsl.
@group(1) @binding(0) var<storage, read_write> surfaces: array<vec4u>;

@compute @workgroup_size(256)
fn primary_rest(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) number: u32,
) {
    if group.x == 0u && number == 0u {
        // The lists of primary rays are done with. Those of shadow rays begin.
        atomicStore(&counts[LISTS_END], 0u);
    }
    let count = atomicLoad(&counts[QUEUE + 1u]);
    for (var i = group.x; i < count; i += groups.x) {
        trace_queued(arrayLength(&queue) - 1u - i, number);
    }
}
