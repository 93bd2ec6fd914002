// Which of the wanted lights reach each pixel: rule 5 of server/src/visibility/mod.rs. A workgroup is one tile and one
// light, and writes that tile's two words of the mask, also when they are zero.

#import "shared/mask.wgsl"
#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "visibility/work.wgsl"
#import "visibility/sampling.wgsl"
#import "visibility/traverse.wgsl"

var<immediate> view: TracedView;

// As visibility/primary.wgsl wrote them.
@group(1) @binding(0) var<storage, read_write> surfaces: array<vec4u>;
@group(1) @binding(1) var<storage, read_write> mask: array<u32>;
@group(1) @binding(2) var<storage, read_write> work: array<atomic<u32>>;

var<workgroup> tile_words: array<atomic<u32>, 2>;

// Shadow rays that this tile traced for the light, where not every pixel has its own.
var<workgroup> tile_rays: atomic<u32>;

// Whether the segment from a surface's start point to the light is free.
fn is_lit(start: vec3f, light: TracedLight) -> bool {
    let directional = light.kind == LIGHT_DIRECTIONAL;
    let direction = select(light.position - start, -light.direction, directional);
    let end = End(select(1.0, FARTHEST, directional), light.position, !directional);
    return !is_blocked(make_ray(start, direction), end);
}

@compute @workgroup_size(8, 8)
fn shadow(
    @builtin(workgroup_id) place: vec3u,
    @builtin(num_workgroups) tiles: vec3u,
    @builtin(local_invocation_id) local: vec3u,
) {
    let bit = mask_bit(local.xy);
    let tile = (view.first_row + place.y) * tiles.x + place.x;
    let seen = surfaces[tile * 64u + bit];
    let start = bitcast<vec3f>(seen.xyz);
    let light = lights[place.z];
    let wanted = ((seen.w >> place.z) & 1u) == 1u;
    let own = wanted && has_own_ray(local.xy);
    var lit = own && is_lit(start, light);
    if lit {
        atomicOr(&tile_words[bit >> 5u], 1u << (bit & 31u));
    }
    workgroupBarrier();
    var words = vec2u(atomicLoad(&tile_words[0]), atomicLoad(&tile_words[1]));
    if SAMPLING != SAMPLE_ALL {
        workgroupBarrier();
        if wanted && !own {
            let found = neighbours_verdict(local.xy, place.z, tile, start, words);
            lit = found == LIT;
            if found == UNDECIDED {
                lit = is_lit(start, light);
            }
            if lit {
                atomicOr(&tile_words[bit >> 5u], 1u << (bit & 31u));
            }
            if found == UNDECIDED {
                atomicAdd(&tile_rays, 1u);
            }
        }
        if own {
            atomicAdd(&tile_rays, 1u);
        }
        workgroupBarrier();
        words = vec2u(atomicLoad(&tile_words[0]), atomicLoad(&tile_words[1]));
        if bit == 0u {
            atomicAdd(&work[WORK_RAYS], atomicLoad(&tile_rays));
        }
    }
    if COUNT_NODES {
        atomicAdd(&work[WORK_NODES], node_visits);
    }
    if bit < 2u {
        // A plane is as large as the picture, of which this may be a part.
        let plane = tiles.x * ((view.height + TILE_PX - 1u) / TILE_PX);
        mask[mask_word(place.z, plane, tile, bit * 32u)] = words[bit];
    }
}
