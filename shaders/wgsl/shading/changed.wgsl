// Which lights a mask says nothing about any more, because something has moved since: those whose shadow, in the
// client's own shadow maps, is not what it was then. Maps are coarser than masks, but of what rests both maps are the
// same, texel by texel, so only movers' shadows and their edges differ.

#import "shading/view.wgsl"
#import "shading/lighting.wgsl"
#import "shading/shadow_map.wgsl"
#import "shading/before.wgsl"
#import "shading/put_off.wgsl"

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> lighting: Lighting;
@group(0) @binding(2) var shadow_map: texture_depth_2d;
@group(0) @binding(3) var<storage, read> shadow_views: array<ShadowView>;
// Of the mask's time.
@group(0) @binding(4) var<uniform> lighting_then: Lighting;
@group(0) @binding(5) var shadow_map_then: texture_depth_2d;
@group(0) @binding(6) var<storage, read> shadow_views_then: array<ShadowView>;
// For each piece.
@group(0) @binding(7) var<storage, read> before: array<Before>;
// What may differ between both maps: for each row of blocks of 32×32 texels, a bit for each block, 1 if something
// moving may be in it or just beside it; then three rows of lights. Twin: `render/predict/touched.rs`.
@group(0) @binding(8) var touched: texture_2d<u32>;
@group(1) @binding(0) var depth_picture: texture_depth_2d;
@group(1) @binding(1) var normal_material_picture: texture_2d<u32>;
@group(1) @binding(2) var piece_picture: texture_2d<u32>;
// Bit k is 1 if light k's shadow has changed.
@group(1) @binding(3) var changed: texture_storage_2d<r32uint, write>;
// For each tile of 8×8 pixels, row by row: see `look`.
@group(1) @binding(4) var<storage, read_write> tiles: array<u32>;
@group(1) @binding(5) var<storage, read_write> put_off: PutOff;

fn tiles_across() -> u32 {
    return (view.width + TILE_PX - 1u) / TILE_PX;
}

fn toward(light: Light, point: vec3f) -> vec3f {
    return select(normalize(light.position - point), -light.direction, light.kind == DIRECTIONAL);
}

const BLOCK_TEXELS: u32 = 32u;
const TILE_PX: u32 = 8u;

// Rows of bits of lights: those whose maps may differ, all, and those that have moved.
const SOME: u32 = 0u;
const ALL: u32 = 1u;
const MOVED: u32 = 2u;

fn touched_lights(row: u32) -> u32 {
    return textureLoad(touched, vec2u(0u, textureDimensions(shadow_map).y / BLOCK_TEXELS + row), 0).x;
}

// Whether one of these blocks of the map is touched.
fn some_touched(first: vec2u, last: vec2u) -> bool {
    var some = 0u;
    for (var y = first.y; y <= last.y; y++) {
        for (var place = first.x >> 5u; place <= last.x >> 5u; place++) {
            let least = max(first.x, place << 5u) & 31u;
            let most = min(last.x, (place << 5u) + 31u) & 31u;
            let blocks = textureLoad(touched, vec2u(place, y), 0).x;
            some |= blocks & (0xffffffffu << least) & (0xffffffffu >> (31u - most));
        }
    }
    return some != 0u;
}

// The pixels of a tile that show surfaces: two of its corners' rays, and the least and greatest distance.
struct Tile {
    first: vec3f,
    across: vec3f,
    down: vec3f,
    near: f32,
    far: f32,
}

// Whether a tile's points may be looked up in a touched block of a light's view. All lie between the eight corners.
fn tile_is_touched(tile: Tile, shadow: ShadowView) -> bool {
    let eye = shadow.clip_from_local * vec4f(view.origin, 1.0);
    let first = shadow.clip_from_local * vec4f(tile.first, 0.0);
    let across = shadow.clip_from_local * vec4f(tile.across, 0.0);
    let down = shadow.clip_from_local * vec4f(tile.down, 0.0);
    // A texel more on each side, for rounding.
    let wide = 1.0 + 2.0 / shadow.side;
    var beyond = vec4<bool>(true);
    var behind = false;
    var low = vec2f(shadow.side);
    var high = vec2f(0.0);
    for (var corner = 0u; corner < 8u; corner++) {
        let ray = first + f32(corner & 1u) * across + f32((corner >> 1u) & 1u) * down;
        let clip = eye + ray * select(tile.near, tile.far, corner >= 4u);
        beyond &= vec4<bool>(clip.xy > vec2f(clip.w * wide), clip.xy < vec2f(-clip.w * wide));
        behind |= clip.w <= 0.0;
        let at = (clip.xy / clip.w * vec2f(0.5, -0.5) + 0.5) * shadow.side;
        low = min(low, at);
        high = max(high, at);
    }
    // Around the light, or beside it: then all of its square.
    low = select(low - 1.0, vec2f(0.0), behind);
    high = select(high + 1.0, vec2f(shadow.side), behind);
    let square = vec2f(shadow.left, shadow.top);
    let ends = vec4f(low, high);
    let texels = vec4u(clamp(ends, vec4f(0.0), vec4f(shadow.side - 1.0)) + square.xyxy);
    return !any(beyond) && some_touched(texels.xy / BLOCK_TEXELS, texels.zw / BLOCK_TEXELS);
}

// For each tile, the lights that have not moved and in whose maps something moving may be around the tile's points: its
// pixels need not ask about others.
@compute @workgroup_size(8, 8)
fn look(@builtin(global_invocation_id) id: vec3u) {
    let size = vec2u(view.width, view.height);
    let first = id.xy * TILE_PX;
    if any(first >= size) {
        return;
    }
    let last = min(first + TILE_PX, size) - 1u;
    // Reversed, and 0 without a surface.
    var nearest = 0.0;
    var farthest = 1.0;
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            let depth = textureLoad(depth_picture, vec2u(x, y), 0);
            nearest = max(nearest, depth);
            farthest = select(farthest, min(farthest, depth), depth > 0.0);
        }
    }
    let ray = ray_of_pixel(view, first);
    let tile = Tile(
        ray,
        ray_of_pixel(view, vec2u(last.x, first.y)) - ray,
        ray_of_pixel(view, vec2u(first.x, last.y)) - ray,
        view.near_m / max(nearest, 1e-30),
        view.near_m / farthest,
    );
    var word = 0u;
    let asked = touched_lights(SOME) & ~touched_lights(MOVED);
    for (var rest = select(asked, 0u, nearest == 0.0); rest != 0u; rest &= rest - 1u) {
        let k = firstTrailingBit(rest);
        let views = select(1u, 6u, lighting.lights[k].kind == POINT);
        let first_view = lighting.lights[k].shadow_view;
        var near = false;
        for (var face = 0u; face < views; face++) {
            near |= tile_is_touched(tile, shadow_views[first_view + face]);
        }
        word |= select(0u, 1u << k, near);
    }
    tiles[id.y * tiles_across() + id.x] = word;
}

// Lights in whose maps something moving may be around a pixel that rests.
fn lights_around(pixel: vec2u) -> u32 {
    return tiles[pixel.y / TILE_PX * tiles_across() + pixel.x / TILE_PX];
}

// Whether a point that rests has another shadow than it had then, under a light that has not moved.
fn shadow_differs(k: u32, point: vec3f, normal: vec3f) -> bool {
    let light = lighting.lights[k];
    let shadow = shadow_views[shadow_view_of(light, point)];
    let place = lookup_of(shadow, light.kind, toward(light, point), point, normal);
    return is_lit(shadow_map, place) != is_lit(shadow_map_then, place);
}

// Pixels that rest, where no light has moved: each looks into both maps at one place. Puts off what moves.
@compute @workgroup_size(8, 8)
fn compare_resting(@builtin(global_invocation_id) id: vec3u) {
    let pixel = id.xy;
    if any(pixel >= vec2u(view.width, view.height)) {
        return;
    }
    let packed = textureLoad(normal_material_picture, pixel, 0).y;
    let is_surface = material_plus_1(packed) != 0u;
    if is_surface && textureLoad(piece_picture, pixel, 0).x != 0u {
        put_off_pixel(pixel);
        return;
    }
    let point = point_at_depth(view, pixel, textureLoad(depth_picture, pixel, 0));
    let normal = unpack_plane_normal(packed);
    var word = 0u;
    for (var rest = select(0u, lights_around(pixel), is_surface); rest != 0u; rest &= rest - 1u) {
        let k = firstTrailingBit(rest);
        word |= select(0u, 1u << k, shadow_differs(k, point, normal));
    }
    textureStore(changed, pixel, vec4u(word, 0u, 0u, 0u));
}

@compute @workgroup_size(8, 8)
fn compare(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_index) place_in_group: u32,
) {
    let pixel = pixel_put_off(id.xy, group.xy, place_in_group);
    if any(pixel >= vec2u(view.width, view.height)) {
        return;
    }
    let packed = textureLoad(normal_material_picture, pixel, 0).y;
    if material_plus_1(packed) == 0u {
        textureStore(changed, pixel, vec4u(0u));
        return;
    }
    let point = point_at_depth(view, pixel, textureLoad(depth_picture, pixel, 0));
    let normal = unpack_plane_normal(packed);
    let piece = textureLoad(piece_picture, pixel, 0);
    var then = Then(point, normal, true);
    if piece.x != 0u {
        then = then_of(before[piece.x - 1u], piece, point, normal);
    }
    if !then.is_known {
        textureStore(changed, pixel, vec4u(0xffffffffu, 0u, 0u, 0u));
        return;
    }
    // What moves may turn to a light, wherever its shadow falls.
    let suspects = select(touched_lights(MOVED) | lights_around(pixel), touched_lights(ALL), piece.x != 0u);
    var word = 0u;
    for (var rest = suspects; rest != 0u; rest &= rest - 1u) {
        let k = firstTrailingBit(rest);
        let light = lighting.lights[k];
        let shadow = shadow_views[shadow_view_of(light, point)];
        let lit = shadow_map_lit(shadow_map, shadow, light.kind, toward(light, point), point, normal);
        let other = lighting_then.lights[k];
        let shadow_then = shadow_views_then[shadow_view_of(other, then.point)];
        let way = toward(other, then.point);
        let was_lit = shadow_map_lit(shadow_map_then, shadow_then, other.kind, way, then.point, then.normal);
        word |= select(0u, 1u << k, lit != was_lit);
    }
    textureStore(changed, pixel, vec4u(word, 0u, 0u, 0u));
}
