// Shading: the light from each pixel's surface to the eye, linear and exposed.

#import "shading/inputs.wgsl"
#import "shading/environment.wgsl"

@vertex
fn cover(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return covering_triangle(index);
}

@fragment
fn shade(@builtin(position) place: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(place.xy);
    let normal_material = textureLoad(normal_material_picture, pixel, 0).xy;
    let material = material_plus_1(normal_material.y);
    if material == 0u {
        return vec4f(sky(ray_of_pixel(view, pixel)), 1.0);
    }
    let point = surface_point(pixel);
    let normal = unpack_normal(normal_material.x);
    let visibility = visibility_of(pixel);
    var irradiance = ambient(normal);
    for (var k = 0u; k < lighting.count; k++) {
        let light = arrival(lighting.lights[k], point);
        let facing = dot(normal, light.toward);
        // An irrelevant light adds nothing, whatever its bit.
        irradiance += light.irradiance * (max(facing, 0.0) * reached(k, visibility));
    }
    let color = textureLoad(color_picture, pixel, 0).rgb;
    return vec4f(kept(color * irradiance + emitted[material - 1u].rgb), 1.0);
}
