// Lists of the triangles that may stop the rays of a block of pixels: primary rays, and shadow rays to one light. The
// `…_lists.wgsl` kernels write them, `…_listed.wgsl` test them, and beside that trace the rays of blocks without one.
// `…_rest.wgsl` trace those of blocks whose list did not do. Blocks count from a part's first row of tiles, so parts
// may begin at any row. Shadow rays' lists replace those of primary rays.
//
// The kernel that imports this declares `QUEUE`: where its counts are.

#import "shared/traced_scene.wgsl"
#import "shared/mask.wgsl"
#import "visibility/counts.wgsl"

// A block is two tiles wide and high.
const BLOCK_TILES: u32 = 2u;

// What is known of a block, or of a block and a light: a list's length, or one of these.
// One triangle probably covers the light, as seen from the whole block.
const STATE_COVERED: u32 = 0x10001u;
// There is no list.
const STATE_OPEN: u32 = 0x10000u;

// Each block's states by light: `x` as above, `y` the first entry in `lists`, or the covering triangle. Primary rays
// use the first light's.
@group(1) @binding(3) var<storage, read_write> states: array<vec2u>;
@group(1) @binding(4) var<storage, read_write> lists: array<u32>;
// Blocks, each with a light, whose rays are traced one by one: from the front those without a list, `counts[QUEUE]` of
// them; from the back those whose list did not do, `counts[QUEUE + 1]`.
@group(1) @binding(5) var<storage, read_write> queue: array<u32>;

struct Queued {
    place: vec2u,
    light: u32,
}

fn queued(index: u32) -> Queued {
    let entry = queue[index];
    return Queued(vec2u(entry & 0x7ffu, (entry >> 11u) & 0x7ffu), entry >> 22u);
}

fn entry_of(block: vec2u, light: u32) -> u32 {
    return block.x | (block.y << 11u) | (light << 22u);
}

fn queue_without_list(block: vec2u, light: u32) {
    queue[atomicAdd(&counts[QUEUE], 1u)] = entry_of(block, light);
}

fn queue_again(block: vec2u, light: u32) {
    queue[arrayLength(&queue) - 1u - atomicAdd(&counts[QUEUE + 1u], 1u)] = entry_of(block, light);
}

fn tiles_across(pixels: u32) -> u32 {
    return (pixels + TILE_PX - 1u) / TILE_PX;
}

// Where the states of the block at tile (x, y) of a part begin.
fn states_at(tile: vec2u) -> u32 {
    let blocks_x = (tiles_across(view.width) + BLOCK_TILES - 1u) / BLOCK_TILES;
    let block = tile / BLOCK_TILES;
    return (block.y * blocks_x + block.x) * view.lights;
}

// A pixel of a block, by its number from 0 to 255: tile after tile.
struct BlockPixel {
    // The tile in the block, 0 to 3, and the pixel's bit in the tile.
    within: u32,
    bit: u32,
    // In the picture; meaningless outside.
    tile: u32,
    pixel: vec2u,
    is_inside: bool,
}

fn block_pixel(block: vec2u, number: u32) -> BlockPixel {
    let within = number / 64u;
    let tiles_x = tiles_across(view.width);
    let place = block * BLOCK_TILES + vec2u(within & 1u, (within >> 1u) + view.first_row);
    let bit = number % 64u;
    let pixel = place * TILE_PX + vec2u(bit % TILE_PX, bit / TILE_PX);
    let is_inside = place.x < tiles_x && place.y < view.end_row;
    return BlockPixel(within, bit, place.y * tiles_x + place.x, pixel, is_inside);
}
