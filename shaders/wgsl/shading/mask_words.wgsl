// Turns bit planes, as sent on the wire, into one word of all lights for each pixel of the mask.

#import "shared/mask.wgsl"
#import "shading/view.wgsl"

struct MaskSize {
    width: u32,
    height: u32,
    lights: u32,
    unused_0: u32,
}

@group(0) @binding(0) var<uniform> size: MaskSize;
// One plane after another.
@group(0) @binding(1) var<storage, read> mask: array<u32>;

@vertex
fn cover(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return covering_triangle(index);
}

@fragment
fn gather(@builtin(position) place: vec4f) -> @location(0) u32 {
    let pixel = vec2u(place.xy);
    let tiles_x = (size.width + TILE_PX - 1u) / TILE_PX;
    let tiles = tiles_x * ((size.height + TILE_PX - 1u) / TILE_PX);
    let tile = pixel.y / TILE_PX * tiles_x + pixel.x / TILE_PX;
    let bit = mask_bit(pixel % TILE_PX);
    var word = 0u;
    for (var k = 0u; k < size.lights; k++) {
        word |= ((mask[mask_word(k, tiles, tile, bit)] >> (bit & 31u)) & 1u) << k;
    }
    return word;
}
