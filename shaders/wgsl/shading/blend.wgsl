// BLEND surfaces, drawn over the shaded picture from far to near. They have no visibility of their own: a light reaches
// them if it reaches the surface behind them, if its bit there is irrelevant, or if there is no surface.
//
// A transmissive surface is drawn twice: what lies behind it is multiplied by what passes, then its own light is added.

#import "shading/inputs.wgsl"
#import "shading/around.wgsl"
#import "shading/surface.wgsl"

@vertex
fn transform(vertex: Vertex) -> Varying {
    return projected(vertex, view.clip_from_local, view.origin);
}

// How much of light k reaches the surface behind the pixel.
fn reached_behind(k: u32, pixel: vec2u) -> f32 {
    let behind = textureLoad(normal_material_picture, pixel, 0).xy;
    if material_plus_1(behind.y) == 0u {
        return 1.0;
    }
    let light = arrival(lighting.lights[k], surface_point(pixel));
    if dot(unpack_normal(behind.x), light.toward) <= 0.0 || all(light.irradiance <= vec3f(0.0)) {
        return 1.0;
    }
    return reached(k, visibility_of(pixel));
}

fn look_at(surface: Surface, toward_eye: vec3f) -> Look {
    let gloss = vec4f(surface.roughness, surface.metallic, surface.coat, surface.coat_roughness);
    let normals = mat3x3f(surface.normal, surface.coat_normal, surface.plane_normal);
    let finish = finishes[material.index];
    return look_of(normals, toward_eye, surface.color.rgb, finish, gloss, surface.tint, surface.occlusion);
}

@fragment
fn blend(input: Varying, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    let surface = surface_of(input, front);
    var look = look_at(surface, normalize(-input.from_eye));
    look.diffuse *= 1.0 - surface.transmission;
    let pixel = vec2u(input.clip.xy);
    let point = view.origin + input.from_eye;
    var light = light_around(look);
    for (var k = 0u; k < lighting.count; k++) {
        let arriving = arrival(lighting.lights[k], point);
        let sent = answer(look, arriving.toward) * arriving.irradiance;
        if any(sent > vec3f(0.0)) {
            light += sent * reached_behind(k, pixel);
        }
    }
    return vec4f(kept(light + surface.emitted), surface.color.a);
}

// Share of the light from behind that passes.
@fragment
fn passed(input: Varying, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    let surface = surface_of(input, front);
    let look = look_at(surface, normalize(-input.from_eye));
    let inside = look.diffuse * surface.transmission * (1.0 - scattered(look, look.dielectric));
    return vec4f(mix(vec3f(1.0), inside, surface.color.a), 1.0);
}
