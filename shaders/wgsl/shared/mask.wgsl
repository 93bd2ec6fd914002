// The visibility mask as array<u32>, in the layout of gnomon-protocol's `Mask`. A tile is 8×8 pixels and two words.

const TILE_PX: u32 = 8u;

// The bit of a pixel within its tile, 0 to 63.
fn mask_bit(place_in_tile: vec2u) -> u32 {
    return place_in_tile.y * TILE_PX + place_in_tile.x;
}

// The word that holds bit `bit` of a tile in a light's plane.
fn mask_word(light: u32, tiles: u32, tile: u32, bit: u32) -> u32 {
    return (light * tiles + tile) * 2u + (bit >> 5u);
}
