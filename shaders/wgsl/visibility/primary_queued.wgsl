// Finds the surface points of a block in the queue ray by ray. A workgroup of 256 takes the block. The kernel that
// imports this declares `view` and `surfaces`.

#import "shared/mask.wgsl"
#import "visibility/counts.wgsl"
#import "visibility/lists.wgsl"
#import "visibility/primary_seen.wgsl"

var<workgroup> block_rays: atomic<u32>;

// Takes what a block's pixels see, and counts their shadow rays. All of a workgroup call it.
fn take(place: BlockPixel, seen: vec4u, number: u32) {
    if place.is_inside {
        surfaces[place.tile * 64u + place.bit] = seen;
    }
    if number == 0u {
        atomicStore(&block_rays, 0u);
    }
    workgroupBarrier();
    atomicAdd(&block_rays, countOneBits(seen.w));
    workgroupBarrier();
    if number == 0u {
        atomicAdd(&counts[COUNT_RAYS], atomicLoad(&block_rays));
    }
}

fn trace_queued(index: u32, number: u32) {
    let place = block_pixel(queued(index).place, number);
    var seen = vec4u(0u);
    if place.is_inside {
        seen = seen_at(place.pixel);
    }
    take(place, seen, number);
}
