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
@group(1) @binding(0) var depth_picture: texture_depth_2d;
@group(1) @binding(1) var normal_material_picture: texture_2d<u32>;
@group(1) @binding(2) var piece_picture: texture_2d<u32>;
// Bit k is 1 if light k's shadow has changed.
@group(1) @binding(3) var changed: texture_storage_2d<r32uint, write>;

fn toward(light: Light, point: vec3f) -> vec3f {
    return select(normalize(light.position - point), -light.direction, light.kind == DIRECTIONAL);
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
    var word = 0u;
    for (var k = 0u; k < lighting.count; k++) {
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
