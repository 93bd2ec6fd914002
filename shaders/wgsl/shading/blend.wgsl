// BLEND surfaces, drawn over the shaded picture from far to near. They have no visibility of their own, so a light reaches
// them when it reaches the surface behind them; where its bit there is irrelevant, or there is no surface, it reaches them.

#import "shading/view.wgsl"
#import "shading/lighting.wgsl"
#import "shading/material.wgsl"

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> lighting: Lighting;
@group(0) @binding(2) var<storage, read> mask: array<u32>;
@group(0) @binding(3) var<storage, read> emitted: array<vec4f>;
@group(0) @binding(4) var depth_picture: texture_depth_2d;
@group(0) @binding(5) var color_picture: texture_2d<f32>;
@group(0) @binding(6) var normal_material_picture: texture_2d<u32>;

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

// Whether light k reaches the surface behind the pixel.
fn reaches(k: u32, pixel: vec2u) -> bool {
    let behind = textureLoad(normal_material_picture, pixel, 0).xy;
    if k >= view.mask_lights || behind.y == 0u {
        return true;
    }
    let depth = textureLoad(depth_picture, pixel, 0);
    let light = arrival(lighting.lights[k], view.origin + ray_of_pixel(view, pixel) * (view.near_m / depth));
    if dot(unpack_normal(behind.x), light.toward) <= 0.0 || all(light.irradiance <= vec3f(0.0)) {
        return true;
    }
    let bits = mask_place(view.width, view.height, pixel);
    return ((mask[bits.word + k * bits.step] >> bits.bit) & 1u) == 1u;
}

@fragment
fn blend(input: Varying, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    let color = base_color(input.uv);
    let normal = normalize(select(-input.normal, input.normal, front));
    let pixel = vec2u(input.clip.xy);
    var irradiance = ambient(lighting.ambient_above, lighting.ambient_below, normal);
    for (var k = 0u; k < lighting.count; k++) {
        let light = arrival(lighting.lights[k], input.point);
        let facing = dot(normal, light.toward);
        if facing > 0.0 && any(light.irradiance > vec3f(0.0)) && reaches(k, pixel) {
            irradiance += light.irradiance * facing;
        }
    }
    return vec4f(color.rgb * irradiance + emitted[material.index].rgb, color.a);
}
