// Where a block of pixels lies in the picture. Imported by the kernels of primary rays, which declare `view`.

#import "shared/mask.wgsl"
#import "shared/traced_scene.wgsl"
#import "visibility/lists.wgsl"
#import "visibility/primary_ray.wgsl"

// The first pixel of a block, and the one after its last.
fn block_pixels(block: vec2u) -> vec4u {
    let first = (block * BLOCK_TILES + vec2u(0u, view.first_row)) * TILE_PX;
    let end = vec2u(view.width, min(view.height, view.end_row * TILE_PX));
    return vec4u(first, min(first + BLOCK_TILES * TILE_PX, end));
}

// The unit vector through the middle of a block.
fn block_axis(block: vec2u) -> vec3f {
    let pixels = block_pixels(block);
    return normalize(picture_direction(vec2f(pixels.xy + pixels.zw) * 0.5));
}
