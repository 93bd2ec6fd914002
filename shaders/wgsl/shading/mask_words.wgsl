// Turns bit planes, as sent on the wire, into one word of all lights for each pixel of the mask.

#import "shared/mask.wgsl"

struct MaskSize {
    width: u32,
    height: u32,
    lights: u32,
    unused_0: u32,
}

@group(0) @binding(0) var<uniform> size: MaskSize;
// One plane after another.
@group(0) @binding(1) var<storage, read> mask: array<u32>;

@group(1) @binding(0) var words: texture_storage_2d<r32uint, write>;

@compute @workgroup_size(8, 8)
fn gather(@builtin(global_invocation_id) id: vec3u) {
    let pixel = id.xy;
    if any(pixel >= vec2u(size.width, size.height)) {
        return;
    }
    let tiles_x = (size.width + TILE_PX - 1u) / TILE_PX;
    let tiles = tiles_x * ((size.height + TILE_PX - 1u) / TILE_PX);
    let tile = pixel.y / TILE_PX * tiles_x + pixel.x / TILE_PX;
    let bit = mask_bit(pixel % TILE_PX);
    var word = 0u;
    for (var k = 0u; k < size.lights; k++) {
        word |= ((mask[mask_word(k, tiles, tile, bit)] >> (bit & 31u)) & 1u) << k;
    }
    textureStore(words, pixel, vec4u(word, 0u, 0u, 0u));
}
