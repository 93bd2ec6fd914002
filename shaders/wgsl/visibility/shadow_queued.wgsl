// Traces the shadow rays of a block and a light in the queue one by one. A workgroup of 256 takes the block. The kernel
// that imports this declares `view`, `surfaces` and `mask`.

#import "shared/mask.wgsl"
#import "shared/traced_scene.wgsl"
#import "shared/ray.wgsl"
#import "visibility/traverse.wgsl"
#import "visibility/lists.wgsl"
#import "visibility/shadow_ray.wgsl"

var<workgroup> block_words: array<atomic<u32>, 8>;

// The words are 0 before, for all of a workgroup.
fn write_words(pixel: BlockPixel, light: u32, number: u32) {
    workgroupBarrier();
    if pixel.is_inside && (pixel.bit & 31u) == 0u {
        // A plane is the size of the whole picture; this may be a part of it.
        let plane = tiles_across(view.width) * tiles_across(view.height);
        mask[mask_word(light, plane, pixel.tile, pixel.bit)] = atomicLoad(&block_words[number >> 5u]);
    }
}

fn trace_queued(index: u32, number: u32) {
    let block = queued(index);
    let pixel = block_pixel(block.place, number);
    if number < 8u {
        atomicStore(&block_words[number], 0u);
    }
    workgroupBarrier();
    if pixel.is_inside {
        let seen = surfaces[pixel.tile * 64u + pixel.bit];
        let needed = ((seen.w >> block.light) & 1u) == 1u;
        let light = lights[view.first_light + block.light];
        if needed && !occluded(shadow_ray(bitcast<vec3f>(seen.xyz), light), shadow_end(light)) {
            atomicOr(&block_words[number >> 5u], 1u << (number & 31u));
        }
    }
    write_words(pixel, block.light, number);
    // The next one's words begin.
    workgroupBarrier();
}
