// Finds each pixel's surface point ray by ray. A workgroup is one tile.

#import "shared/mask.wgsl"
#import "shared/traced_scene.wgsl"
#import "visibility/counts.wgsl"
#import "visibility/primary_seen.wgsl"

var<immediate> view: TracedView;

// Tile after tile, 64 pixels each: xyz is the shadow rays' start (bits of f32), w the lights that need a ray.
@group(1) @binding(0) var<storage, read_write> surfaces: array<vec4u>;

var<workgroup> tile_rays: atomic<u32>;

@compute @workgroup_size(8, 8)
fn primary(
    @builtin(workgroup_id) place: vec3u,
    @builtin(num_workgroups) tiles: vec3u,
    @builtin(local_invocation_id) local: vec3u,
) {
    let row = view.first_row + place.y;
    let pixel = vec2u(place.x, row) * TILE_PX + local.xy;
    let bit = mask_bit(local.xy);
    let seen = seen_at(pixel);
    let tile = row * tiles.x + place.x;
    surfaces[tile * 64u + bit] = seen;

    atomicAdd(&tile_rays, countOneBits(seen.w));
    workgroupBarrier();
    if bit == 0u {
        atomicAdd(&counts[COUNT_RAYS], atomicLoad(&tile_rays));
    }
}
