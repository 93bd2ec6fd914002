// Shading: the light that the surface in every pixel sends to the eye, in linear exposed units.

#import "shading/view.wgsl"
#import "shading/lighting.wgsl"

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> lighting: Lighting;
// The newest mask, plane after plane.
@group(0) @binding(2) var<storage, read> mask: array<u32>;
// Emitted light of every material, exposed.
@group(0) @binding(3) var<storage, read> emitted: array<vec4f>;
@group(0) @binding(4) var depth_picture: texture_depth_2d;
@group(0) @binding(5) var color_picture: texture_2d<f32>;
@group(0) @binding(6) var normal_material_picture: texture_2d<u32>;

@vertex
fn cover(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return covering_triangle(index);
}

fn sky(direction: vec3f) -> vec3f {
    return mix(lighting.horizon, lighting.zenith, sqrt(saturate(normalize(direction).y)));
}

@fragment
fn shade(@builtin(position) place: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(place.xy);
    let ray = ray_of_pixel(view, pixel);
    let normal_material = textureLoad(normal_material_picture, pixel, 0).xy;
    if normal_material.y == 0u {
        return vec4f(sky(ray), 1.0);
    }
    let point = view.origin + ray * (view.near_m / textureLoad(depth_picture, pixel, 0));
    let normal = unpack_normal(normal_material.x);
    let bits = mask_place(view.width, view.height, pixel);
    var irradiance = ambient(lighting.ambient_above, lighting.ambient_below, normal);
    for (var k = 0u; k < lighting.count; k++) {
        let light = arrival(lighting.lights[k], point);
        let facing = dot(normal, light.toward);
        // An irrelevant light adds nothing, whatever its bit is, so its bit is not even read.
        if facing <= 0.0 || all(light.irradiance <= vec3f(0.0)) {
            continue;
        }
        if k < view.mask_lights && ((mask[bits.word + k * bits.step] >> bits.bit) & 1u) == 0u {
            continue;
        }
        irradiance += light.irradiance * facing;
    }
    let color = textureLoad(color_picture, pixel, 0).rgb;
    return vec4f(color * irradiance + emitted[normal_material.y - 1u].rgb, 1.0);
}
