// Shading: the light from each pixel's surface to the eye, linear and exposed, added to what the surface emits.

#import "shading/inputs.wgsl"
#import "shading/around.wgsl"
#import "shading/edges.wgsl"

@vertex
fn cover(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return covering_triangle(index);
}

// What the G-buffer says of a pixel's surface.
fn look_at(pixel: vec2u, words: vec4u, toward_eye: vec3f) -> Look {
    let finish = finishes[material_plus_1(words.y) - 1u];
    let normal = unpack_normal(words.x);
    let last = finish.last;
    var smooth_normal = vec4f(normal, 0.0);
    // Without visibility, facets have no shadows.
    if last == LAST_IS_SMOOTH && pixel.x < lighting.lit_from_px {
        smooth_normal = unpack_smooth(words.w);
    }
    let coat_normal = select(normal, unpack_normal(words.w), last == LAST_IS_COAT_NORMAL);
    let color = textureLoad(color_picture, pixel, 0);
    let normals = mat3x3f(normal, coat_normal, unpack_plane_normal(words.y));
    return look_of(
        normals, smooth_normal, toward_eye, color.rgb, finish, unpack4x8unorm(words.z), unpack4x8unorm(words.w),
        color.a,
    );
}

@fragment
fn shade(@builtin(position) place: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(place.xy);
    let words = textureLoad(normal_material_picture, pixel, 0);
    if material_plus_1(words.y) == 0u {
        return vec4f(sky(ray_of_pixel(view, pixel)), 1.0);
    }
    let point = surface_point(pixel);
    let look = look_at(pixel, words, normalize(view.origin - point));
    let around = surroundings(pixel, point, look.plane_normal);
    var light = light_around(look);
    for (var k = 0u; k < lighting.count; k++) {
        let share = smooth_share(around, k);
        if share > 0.0 {
            let arriving = arrival(lighting.lights[k], point);
            // An irrelevant light adds nothing, whatever its bit.
            light += answer(look, arriving.toward) * arriving.irradiance * share;
        }
    }
    return vec4f(kept(light), 1.0);
}
