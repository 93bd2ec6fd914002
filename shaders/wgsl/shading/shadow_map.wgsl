// What the client knows of its lights by itself: shadow maps of the scene at rest, drawn once (`render/predict/shadow_map.rs`).
// They fill in where no received visibility can be carried over.

#import "shading/view.wgsl"
#import "shading/lighting.wgsl"

// A light's view of the scene, in a square of the map. Twin: `shading::ShadowView`.
struct ShadowView {
    clip_from_local: mat4x4f,
    // Left and top of the square, and its side, in texels.
    left: f32,
    top: f32,
    side: f32,
    // Side of a texel in metres: at distance 1, or anywhere for a directional light.
    texel_m: f32,
}

// Where a light looks from a point of a cube map: +x, −x, +y, −y, +z, −z.
fn cube_face(from_light: vec3f) -> u32 {
    let size = abs(from_light);
    if size.x >= size.y && size.x >= size.z {
        return select(0u, 1u, from_light.x < 0.0);
    }
    if size.y >= size.z {
        return select(2u, 3u, from_light.y < 0.0);
    }
    return select(4u, 5u, from_light.z < 0.0);
}

fn shadow_view_of(light: Light, point: vec3f) -> u32 {
    return light.shadow_view + select(0u, cube_face(point - light.position), light.kind == POINT);
}

// Whether the map leaves the surface at `point`, with this normal towards the eye, in the light: the majority of the four texels
// around it, by their bilinear weights.
fn shadow_map_lit(map: texture_depth_2d, shadow: ShadowView, kind: u32, toward: vec3f, point: vec3f, normal: vec3f) -> bool {
    let facing = dot(normal, toward);
    if facing <= 0.0 {
        // Rule 4 of server/src/visibility/mod.rs: the surface hides the light from itself.
        return false;
    }
    let distance = (shadow.clip_from_local * vec4f(point, 1.0)).w;
    let texel_m = shadow.texel_m * select(distance, 1.0, kind == DIRECTIONAL);
    // Within the four texels a tilted surface is up to √2 texels · tan nearer to the light than at the point; a step off the
    // surface of √2 texels · sin makes up for that (Holbert, "Normal Offset Shadows", GDC 2011), and half a texel for rounding.
    let sine = sqrt(max(1.0 - facing * facing, 0.0));
    let clip = shadow.clip_from_local * vec4f(point + normal * (texel_m * (1.5 * sine + 0.5)), 1.0);
    let ndc = clip.xyz / clip.w;
    let place = (ndc.xy * vec2f(0.5, -0.5) + 0.5) * shadow.side - 0.5;
    if clip.w <= 0.0 || any(place < vec2f(0.0)) || any(place >= vec2f(shadow.side - 1.0)) {
        return true;
    }
    let corner = vec2i(place);
    let weight = place - vec2f(corner);
    let texel = corner + vec2i(vec2f(shadow.left, shadow.top));
    // Reversed depth: what is nearer to the light has more.
    let nearest = vec4f(
        textureLoad(map, texel, 0),
        textureLoad(map, texel + vec2i(1, 0), 0),
        textureLoad(map, texel + vec2i(0, 1), 0),
        textureLoad(map, texel + vec2i(1, 1), 0),
    );
    let lit = select(vec4f(0.0), vec4f(1.0), nearest <= vec4f(ndc.z));
    return mix(mix(lit.x, lit.y, weight.x), mix(lit.z, lit.w, weight.x), weight.y) >= 0.5;
}
