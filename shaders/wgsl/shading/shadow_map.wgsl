// The client's own shadow maps, drawn once, or when something has moved (`render/predict/shadow_map.rs`). They are used
// where no received visibility applies.

#import "shading/view.wgsl"
#import "shading/lighting.wgsl"

// A light's view of the scene, in a square of the map. Twin: `shading::ShadowView`.
struct ShadowView {
    clip_from_local: mat4x4f,
    // Left and top edge of the square and its side, in texels.
    left: f32,
    top: f32,
    side: f32,
    // Side of a texel in metres: at distance 1, or anywhere for a directional light.
    texel_m: f32,
}

// The cube map face that a light sees a point in: +x, −x, +y, −y, +z, −z.
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

// Offset of a lookup from its surface, in texels: for surfaces that are not quite planar.
const OFF_SURFACE_TEXELS: f32 = 0.2;

// A point in its light's square, in texels with whole numbers at their centres; its reversed depth; its distance.
fn map_place(shadow: ShadowView, point: vec3f) -> vec4f {
    let clip = shadow.clip_from_local * vec4f(point, 1.0);
    return vec4f((clip.xy / clip.w * vec2f(0.5, -0.5) + 0.5) * shadow.side - 0.5, clip.z / clip.w, clip.w);
}

// Where a point is looked up in a light's square.
struct Lookup {
    // The first of four texels around it, and where it lies between them.
    texel: vec2i,
    weight: vec2f,
    // The surface's own depth at the four.
    surface: vec4f,
    // Whether these decide; if not, whether it is lit.
    is_inside: bool,
    otherwise: bool,
}

// `normal` faces the eye.
fn lookup_of(shadow: ShadowView, kind: u32, toward: vec3f, point: vec3f, normal: vec3f) -> Lookup {
    let distance = (shadow.clip_from_local * vec4f(point, 1.0)).w;
    let texel_m = shadow.texel_m * select(distance, 1.0, kind == DIRECTIONAL);
    let step = normal * (OFF_SURFACE_TEXELS * texel_m);
    let at = map_place(shadow, point + step);
    // Rule 4 of server/src/visibility/mod.rs: a surface that faces away hides the light from itself.
    let faces = dot(normal, toward) > 0.0;
    let is_outside = at.w <= 0.0 || any(at.xy < vec2f(0.0)) || any(at.xy >= vec2f(shadow.side - 1.0));
    if !faces || is_outside {
        return Lookup(vec2i(0), vec2f(0.0), vec4f(0.0), false, faces);
    }
    // A plane's depth is linear in the map.
    let tangent = normalize(
        select(vec3f(0.0, normal.z, -normal.y), vec3f(normal.y, -normal.x, 0.0), abs(normal.z) < 0.7),
    );
    let across = map_place(shadow, point + step + tangent * texel_m).xyz - at.xyz;
    let along = map_place(shadow, point + step + cross(normal, tangent) * texel_m).xyz - at.xyz;
    let area = across.x * along.y - across.y * along.x;
    let slope = vec2f(across.z * along.y - along.z * across.y, along.z * across.x - across.z * along.x) / area;
    let corner = vec2i(at.xy);
    let weight = at.xy - vec2f(corner);
    let first = at.z - dot(slope, weight);
    let surface = vec4f(first, first + slope.x, first + slope.y, first + slope.x + slope.y);
    return Lookup(corner + vec2i(vec2f(shadow.left, shadow.top)), weight, surface, true, true);
}

// True if the map shows a point as lit: the majority of the four texels around it, by their bilinear weights.
fn is_lit(map: texture_depth_2d, place: Lookup) -> bool {
    if !place.is_inside {
        return place.otherwise;
    }
    // Reversed depth: greater means nearer to the light.
    let nearest = vec4f(
        textureLoad(map, place.texel, 0),
        textureLoad(map, place.texel + vec2i(1, 0), 0),
        textureLoad(map, place.texel + vec2i(0, 1), 0),
        textureLoad(map, place.texel + vec2i(1, 1), 0),
    );
    let lit = select(vec4f(0.0), vec4f(1.0), nearest <= place.surface);
    return mix(mix(lit.x, lit.y, place.weight.x), mix(lit.z, lit.w, place.weight.x), place.weight.y) >= 0.5;
}

fn shadow_map_lit(
    map: texture_depth_2d, shadow: ShadowView, kind: u32, toward: vec3f, point: vec3f, normal: vec3f,
) -> bool {
    return is_lit(map, lookup_of(shadow, kind, toward, point, normal));
}
