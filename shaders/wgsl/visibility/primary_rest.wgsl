// Finds the surface points of blocks without a list ray by ray, as visibility/primary.wgsl does. A workgroup is a tile.

#import "shared/mask.wgsl"
#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "visibility/traverse.wgsl"
#import "visibility/counts.wgsl"
#import "visibility/lists.wgsl"
#import "visibility/primary_ray.wgsl"
#import "visibility/surface.wgsl"

var<immediate> view: TracedView;

// As in visibility/primary.wgsl.
@group(1) @binding(0) var<storage, read_write> surfaces: array<vec4u>;

var<workgroup> tile_rays: atomic<u32>;

@compute @workgroup_size(8, 8)
fn primary_rest(
    @builtin(workgroup_id) place: vec3u,
    @builtin(num_workgroups) tiles: vec3u,
    @builtin(local_invocation_id) local: vec3u,
) {
    let bit = mask_bit(local.xy);
    if bit == 0u && place.x == 0u && place.y == 0u {
        // The lists of primary rays are done with. Those of shadow rays begin.
        atomicStore(&counts[LISTS_END], 0u);
    }
    if states[states_at(place.xy)].x != STATE_OPEN {
        return;
    }
    let row = view.first_row + place.y;
    let pixel = vec2u(place.x, row) * TILE_PX + local.xy;
    var seen = vec4u(0u);
    if pixel.x < view.width && pixel.y < view.height {
        let hit = intersect(make_ray(view.origin, pixel_direction(pixel)));
        if hit.triangle != NOTHING {
            seen = surface(hit);
        }
    }
    surfaces[(row * tiles.x + place.x) * 64u + bit] = seen;

    atomicAdd(&tile_rays, countOneBits(seen.w));
    workgroupBarrier();
    if bit == 0u {
        atomicAdd(&counts[COUNT_RAYS], atomicLoad(&tile_rays));
    }
}
