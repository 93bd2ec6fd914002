// BLEND surfaces, drawn over the shaded picture from far to near. They have no bits of their own. On a surface, such as
// a label on a wall, they take its bits. Elsewhere the client's shadow maps tell which lights reach them.
//
// A transmissive surface is drawn twice: what lies behind it is multiplied by what passes, then its own light is added.

#import "shading/inputs.wgsl"
#import "shading/around.wgsl"
#import "shading/surface.wgsl"
#import "shading/shadow_map.wgsl"

@group(2) @binding(0) var shadow_map: texture_depth_2d;
@group(2) @binding(1) var<storage, read> shadow_views: array<ShadowView>;
// x: 1 if the shadow maps are used, 0 if a light reaches what it reaches behind.
@group(2) @binding(2) var<uniform> by_map: vec4u;

// A surface behind that is nearer than this, in texels of a shadow map, knows better than the map.
const NEAR_TEXELS: f32 = 2.0;

@vertex
fn transform(vertex: Vertex) -> Varying {
    return projected(vertex, view.clip_from_local, view.origin);
}

@vertex
fn transform_more(vertex: Vertex, more: MoreOfVertex) -> MoreVarying {
    return projected_more(vertex, more, view.clip_from_local, view.origin);
}

// How much of light k reaches the surface behind the pixel, or −1 if its bit there is irrelevant or there is none.
fn reached_behind(k: u32, pixel: vec2u, behind: vec2u) -> f32 {
    if material_plus_1(behind.y) == 0u {
        return -1.0;
    }
    let light = arrival(lighting.lights[k], surface_point(pixel));
    if dot(unpack_normal(behind.x), light.toward) <= 0.0 || all(light.irradiance <= vec3f(0.0)) {
        return -1.0;
    }
    return reached(k, visibility_of(pixel));
}

// How much of light k reaches a point that is drawn on the pixel. `normal` faces the eye and the light.
fn reached_here(k: u32, pixel: vec2u, point: vec3f, normal: vec3f) -> f32 {
    if pixel.x >= lighting.lit_from_px {
        return 1.0;
    }
    let behind = textureLoad(normal_material_picture, pixel, 0).xy;
    if by_map.x == 0u {
        // A light that is not known reaches.
        return abs(reached_behind(k, pixel, behind));
    }
    let light = lighting.lights[k];
    let shadow = shadow_views[shadow_view_of(light, point)];
    if material_plus_1(behind.y) != 0u {
        let apart = distance(point, surface_point(pixel));
        let away = select(distance(point, light.position), 1.0, light.kind == DIRECTIONAL);
        let known = reached_behind(k, pixel, behind);
        if known >= 0.0 && apart <= NEAR_TEXELS * shadow.texel_m * away {
            return known;
        }
    }
    let toward = select(normalize(light.position - point), -light.direction, light.kind == DIRECTIONAL);
    return select(0.0, 1.0, shadow_map_lit(shadow_map, shadow, light.kind, toward, point, normal));
}

fn look_at(surface: Surface, toward_eye: vec3f) -> Look {
    let gloss = vec4f(surface.roughness, surface.metallic, surface.coat, surface.coat_roughness);
    let normals = mat3x3f(surface.normal, surface.coat_normal, surface.plane_normal);
    let finish = finishes[material.index];
    let smooth_normal = vec4f(surface.smooth_normal, surface.lean);
    return look_of(
        normals, smooth_normal, toward_eye, surface.color.rgb, finish, gloss, surface.tint, surface.occlusion,
    );
}

fn blended(input: Point, clip: vec2f, front: bool) -> vec4f {
    let surface = surface_of(input, front);
    var look = look_at(surface, normalize(-input.from_eye));
    look.diffuse *= 1.0 - surface.transmission;
    let pixel = vec2u(clip);
    look.lean = select(look.lean, 0.0, pixel.x >= lighting.lit_from_px);
    let point = view.origin + input.from_eye;
    var light = light_around(look);
    for (var k = 0u; k < lighting.count; k++) {
        let arriving = arrival(lighting.lights[k], point);
        let sent = answer(look, arriving.toward) * arriving.irradiance;
        if any(sent > vec3f(0.0)) {
            light += sent * reached_here(k, pixel, point, surface.plane_normal);
        }
    }
    return vec4f(kept(light + surface.emitted), surface.color.a);
}

// Share of the light from behind that passes.
fn share_passed(input: Point, front: bool) -> vec4f {
    let surface = surface_of(input, front);
    let look = look_at(surface, normalize(-input.from_eye));
    let inside = look.diffuse * surface.transmission * (1.0 - scattered(look, look.dielectric));
    return vec4f(mix(vec3f(1.0), inside, surface.color.a), 1.0);
}

@fragment
fn blend(input: Varying, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    return blended(point_of(input), input.clip.xy, front);
}

@fragment
fn blend_more(input: MoreVarying, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    return blended(point_of_more(input), input.clip.xy, front);
}

@fragment
fn passed(input: Varying, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    return share_passed(point_of(input), front);
}

@fragment
fn passed_more(input: MoreVarying, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    return share_passed(point_of_more(input), front);
}
