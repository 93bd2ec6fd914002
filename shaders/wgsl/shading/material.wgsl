// A material: its factors, its textures, and the alpha test of MASK points. Twin: `material::Material`.

#import "shared/texels.wgsl"

// Where a texture lies: rows for u and v, each to be multiplied with (u, v, 1).
struct TextureMap {
    u: vec3f,
    // 1 if it reads the second texture coordinates.
    second: u32,
    v: vec3f,
    unused_0: u32,
}

struct Material {
    // Linear RGBA factor.
    base_color: vec4f,
    // A MASK point is drawn if its alpha is at least this.
    alpha_cutoff: f32,
    // Index into the table of finishes.
    index: u32,
    // Wrapping of the base colour outside 0 to 1, along u and v: 0 repeats, 1 repeats mirrored, 2 clamps to the edge.
    wrap_u: u32,
    wrap_v: u32,
    // Emitted light, exposed.
    emissive: vec3f,
    metallic: f32,
    roughness: f32,
    normal_scale: f32,
    occlusion_strength: f32,
    coat: f32,
    coat_roughness: f32,
    coat_normal_scale: f32,
    transmission: f32,
    unused: f32,
    // Of the textures but the base colour's, in the order of their bindings.
    maps: array<TextureMap, 8>,
}

@group(1) @binding(0) var<uniform> material: Material;
@group(1) @binding(1) var picture: texture_2d<f32>;
@group(1) @binding(2) var picture_sampler: sampler;

fn picture_alpha(x: i32, y: i32, size: vec2i) -> f32 {
    let place = vec2i(wrapped(x, size.x, material.wrap_u), wrapped(y, size.y, material.wrap_v));
    return textureLoad(picture, place, 0).a;
}

// A point's alpha between its vertices. Interpolation rounds: between ones it may be a little less, which would decide
// a test against a cutoff. 16-bit colours have no alpha in between.
fn vertex_alpha(interpolated: f32) -> f32 {
    return select(interpolated, 1.0, interpolated > 0.99999);
}

// The alpha that decides a MASK point, but for its vertices': bilinear in the full-size picture, exactly as the tracers
// read it, so that both ends see the same leaf. Never through the picture's sampler, which would read a smaller mip.
fn mask_alpha(uv: vec2f) -> f32 {
    let size = vec2i(textureDimensions(picture, 0));
    let texels = texels_around(uv, vec2f(size));
    let x = texels.corner.x;
    let y = texels.corner.y;
    let upper = mix(picture_alpha(x, y, size), picture_alpha(x + 1, y, size), texels.weight.x);
    let lower = mix(picture_alpha(x, y + 1, size), picture_alpha(x + 1, y + 1, size), texels.weight.x);
    return mix(upper, lower, texels.weight.y) * material.base_color.a;
}
