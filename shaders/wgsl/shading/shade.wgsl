// Shading: the light from each pixel's surface to the eye, linear and exposed: what it emits, and what it sends on.

#import "shading/inputs.wgsl"
#import "shading/around.wgsl"
#import "shading/edges.wgsl"
#import "shading/put_off.wgsl"

// True if some surface emits light. Otherwise `emitted_picture` is something else.
override EMITS: bool = true;

// True in a first pass, which puts off the pixels that a shadow's edge crosses.
override puts_off: bool = false;

@group(1) @binding(0) var light_picture: texture_storage_2d<rgba16float, write>;
@group(1) @binding(1) var emitted_picture: texture_2d<f32>;
@group(1) @binding(2) var<storage, read_write> put_off: PutOff;

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

// What the surface sends to the eye of light k, of which this share reaches it. A light that its bit does not concern
// adds nothing, whatever the bit.
fn light_from(k: u32, look: Look, point: vec3f, share: f32) -> vec3f {
    if share == 0.0 {
        return vec3f(0.0);
    }
    let arriving = arrival(lighting.lights[k], point);
    return answer(look, arriving.toward) * arriving.irradiance * share;
}

fn put(pixel: vec2u, light: vec3f) {
    textureStore(light_picture, pixel, vec4f(kept(light), 1.0));
}

@compute @workgroup_size(8, 8)
fn shade(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_index) place_in_group: u32,
) {
    var pixel = id.xy;
    if !puts_off && smooth_edges {
        pixel = pixel_put_off(id.xy, group.xy, place_in_group);
    }
    if any(pixel >= vec2u(view.width, view.height)) {
        return;
    }
    let words = textureLoad(normal_material_picture, pixel, 0);
    if material_plus_1(words.y) == 0u {
        put(pixel, sky(ray_of_pixel(view, pixel)));
        return;
    }
    if puts_off && is_disputed(pixel) {
        put_off_pixel(pixel);
        return;
    }
    let point = surface_point(pixel);
    let look = look_at(pixel, words, normalize(view.origin - point));
    var light = light_around(look);
    if EMITS {
        light += textureLoad(emitted_picture, pixel, 0).rgb;
    }
    if puts_off || !smooth_edges {
        let visibility = visibility_of(pixel);
        for (var k = 0u; k < lighting.count; k++) {
            light += light_from(k, look, point, reached(k, visibility));
        }
    } else {
        let around = surroundings(pixel, point, look.plane_normal);
        for (var k = 0u; k < lighting.count; k++) {
            light += light_from(k, look, point, smooth_share(around, k));
        }
    }
    put(pixel, light);
}
