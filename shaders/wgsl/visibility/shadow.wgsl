// Traces each pixel's shadow rays: rule 5 of server/src/visibility/mod.rs. A workgroup is one tile and one light, and
// writes that tile's two words of the mask even if they are zero.

#import "shared/mask.wgsl"
#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "visibility/traverse.wgsl"
#import "visibility/shadow_ray.wgsl"

var<immediate> view: TracedView;

// Written by the kernels of primary rays.
@group(1) @binding(0) var<storage, read_write> surfaces: array<vec4u>;
@group(1) @binding(1) var<storage, read_write> mask: array<u32>;

var<workgroup> tile_words: array<atomic<u32>, 2>;

@compute @workgroup_size(8, 8)
fn shadow(
    @builtin(workgroup_id) place: vec3u,
    @builtin(num_workgroups) tiles: vec3u,
    @builtin(local_invocation_id) local: vec3u,
) {
    let bit = mask_bit(local.xy);
    let tile = (view.first_row + place.y) * tiles.x + place.x;
    let seen = surfaces[tile * 64u + bit];
    let needed = ((seen.w >> place.z) & 1u) == 1u;
    let light = lights[view.first_light + place.z];
    if needed && !occluded(shadow_ray(bitcast<vec3f>(seen.xyz), light), shadow_end(light)) {
        atomicOr(&tile_words[bit >> 5u], 1u << (bit & 31u));
    }
    workgroupBarrier();
    if bit < 2u {
        // A plane is the size of the whole picture; this may be a part of it.
        let plane = tiles.x * ((view.height + TILE_PX - 1u) / TILE_PX);
        mask[mask_word(place.z, plane, tile, bit * 32u)] = atomicLoad(&tile_words[bit]);
    }
}
