// BLEND surfaces, drawn over the shaded picture from far to near. They have no visibility of their own: a light reaches
// them if it reaches the surface behind them, if its bit there is irrelevant, or if there is no surface.

#import "shading/inputs.wgsl"
#import "shading/environment.wgsl"
#import "shading/material.wgsl"

struct Vertex {
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) uv: vec2f,
}

struct Varying {
    @builtin(position) clip: vec4f,
    @location(0) point: vec3f,
    @location(1) normal: vec3f,
    @location(2) uv: vec2f,
}

@vertex
fn transform(vertex: Vertex) -> Varying {
    let clip = view.clip_from_local * vec4f(vertex.position, 1.0);
    return Varying(clip, vertex.position, vertex.normal, vertex.uv);
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

@fragment
fn blend(input: Varying, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    let color = base_color(input.uv);
    let normal = normalize(select(-input.normal, input.normal, front));
    let pixel = vec2u(input.clip.xy);
    var irradiance = ambient(normal);
    for (var k = 0u; k < lighting.count; k++) {
        let light = arrival(lighting.lights[k], input.point);
        let facing = dot(normal, light.toward);
        if facing > 0.0 && any(light.irradiance > vec3f(0.0)) {
            irradiance += light.irradiance * (facing * reached_behind(k, pixel));
        }
    }
    return vec4f(kept(color.rgb * irradiance + emitted[material.index].rgb), color.a);
}
