// Which lights a mask says nothing about any more, because something has moved since: those whose shadow, in the
// client's own shadow maps, is not what it was then. Maps are coarser than masks, but of what rests both maps are the
// same, texel by texel, so only movers' shadows and their edges differ.

#import "shading/view.wgsl"
#import "shading/lighting.wgsl"
#import "shading/shadow_map.wgsl"
#import "shading/before.wgsl"

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
@group(0) @binding(8) var<storage, read> touched: Touched;
@group(1) @binding(0) var depth_picture: texture_depth_2d;
@group(1) @binding(1) var normal_material_picture: texture_2d<u32>;
@group(1) @binding(2) var piece_picture: texture_2d<u32>;
// Bit k is 1 if light k's shadow has changed.
@group(1) @binding(3) var changed: texture_storage_2d<r32uint, write>;

// What may differ between both maps. Twin: `render/predict/touched.rs`.
struct Touched {
    // Bits of lights: those whose maps may differ; all; those that have moved.
    some: u32,
    all: u32,
    moved: u32,
    unused: u32,
    // A bit for each block of 32×32 texels, row by row. 1: something moving may be in it, or just beside it.
    blocks: array<u32>,
}

fn toward(light: Light, point: vec3f) -> vec3f {
    return select(normalize(light.position - point), -light.direction, light.kind == DIRECTIONAL);
}

const BLOCK_TEXELS: f32 = 32.0;

// Whether something moving may be, or may have been, in the block of the map that a point is looked up in, or beside it.
fn is_touched(k: u32, point: vec3f) -> bool {
    let light = lighting.lights[k];
    let shadow = shadow_views[shadow_view_of(light, point)];
    let across = u32(textureDimensions(shadow_map).x) / u32(BLOCK_TEXELS);
    let at = (map_place(shadow, point).xy + vec2f(shadow.left, shadow.top)) / BLOCK_TEXELS;
    let block = min(vec2u(max(at, vec2f(0.0))), vec2u(across - 1u));
    let bit = block.y * across + block.x;
    return (touched.blocks[bit >> 5u] >> (bit & 31u) & 1u) == 1u;
}

// Whether a point that rests, under a light that has not moved, has other texels around it than it had then.
fn texels_differ(k: u32, point: vec3f, normal: vec3f) -> bool {
    let light = lighting.lights[k];
    let shadow = shadow_views[shadow_view_of(light, point)];
    // As `shadow_map_lit` looks it up.
    let step = normal * (OFF_SURFACE_TEXELS * texel_at(shadow, light.kind, point));
    let at = map_place(shadow, point + step);
    if at.w <= 0.0 || any(at.xy < vec2f(0.0)) || any(at.xy >= vec2f(shadow.side - 1.0)) {
        return false;
    }
    let texel = vec2i(at.xy) + vec2i(vec2f(shadow.left, shadow.top));
    return any(texels_at(shadow_map, texel) != texels_at(shadow_map_then, texel));
}

@compute @workgroup_size(8, 8)
fn compare(@builtin(global_invocation_id) id: vec3u) {
    let pixel = id.xy;
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
    // What moves may turn to a light, wherever its shadow falls. On what rests, most pixels see the same texels as then.
    // Three loops, each over fewer lights and longer: software ends a loop when no pixel of a group goes on. The first is
    // the same for all pixels, so that software reads each light once.
    var near = 0u;
    for (var rest = touched.some & ~touched.moved; rest != 0u; rest &= rest - 1u) {
        let k = firstTrailingBit(rest);
        near |= select(0u, 1u << k, is_touched(k, point));
    }
    near = select(near, 0u, piece.x != 0u);
    var suspects = select(touched.moved, touched.all, piece.x != 0u);
    for (var rest = near; rest != 0u; rest &= rest - 1u) {
        let k = firstTrailingBit(rest);
        suspects |= select(0u, 1u << k, texels_differ(k, point, normal));
    }
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
