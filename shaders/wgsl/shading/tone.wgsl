// From exposed light to the screen: tone curve, sRGB encoding, dither.

#import "shading/view.wgsl"

// The tone curve x^a / (b·x^(a·d) + c) of Lottes, "Advanced Techniques and Optimization of HDR Color Pipelines" (GDC
// 2016). Twin: `shading::Tone`, which computes b and c.
struct Tone {
    contrast: f32,
    shoulder: f32,
    b: f32,
    c: f32,
}

@group(0) @binding(0) var<uniform> tone: Tone;
@group(0) @binding(1) var light_picture: texture_2d<f32>;

@vertex
fn cover(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return covering_triangle(index);
}

fn curve(x: f32) -> f32 {
    let power = pow(x, tone.contrast);
    return saturate(power / (tone.b * pow(power, tone.shoulder) + tone.c));
}

// Applies the curve to the brightest channel and scales the others with it, which keeps hues. Light much brighter than
// the screen can show fades towards white, as on film.
fn toned(light: vec3f) -> vec3f {
    let peak = max(max(light.r, light.g), max(light.b, 1e-6));
    let shown = curve(peak);
    let fade = shown * shown * (1.0 - 1.0 / (1.0 + 0.25 * max(peak - 0.5, 0.0)));
    return mix(light * (shown / peak), vec3f(shown), fade);
}

fn encoded(linear: vec3f) -> vec3f {
    let low = linear * 12.92;
    let high = 1.055 * pow(max(linear, vec3f(0.0)), vec3f(1.0 / 2.4)) - 0.055;
    return select(high, low, linear <= vec3f(0.0031308));
}

// An 8×8 Bayer matrix, from −1/2 to 1/2.
fn threshold(pixel: vec2u) -> f32 {
    let mixed = pixel.x ^ pixel.y;
    let rank = ((mixed & 1u) << 5u) | ((pixel.y & 1u) << 4u) | ((mixed & 2u) << 2u) | ((pixel.y & 2u) << 1u)
        | ((mixed & 4u) >> 1u) | ((pixel.y & 4u) >> 2u);
    return (f32(rank) + 0.5) / 64.0 - 0.5;
}

@fragment
fn show(@builtin(position) place: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(place.xy);
    let light = textureLoad(light_picture, pixel, 0).rgb;
    return vec4f(encoded(toned(light)) + threshold(pixel) / 255.0, 1.0);
}
