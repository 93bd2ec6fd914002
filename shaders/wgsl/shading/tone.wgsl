// From exposed light to the screen: tone curve, sRGB encoding, dither.
// `client/docs/light-and-exposure.md` says where the curves come from.

#import "shading/view.wgsl"

// The tone curve x^a / (b·x^(a·d) + c) of Lottes, "Advanced Techniques and Optimization of HDR Color Pipelines" (GDC
// 2016). Twin: `shading::Tone`, which computes b and c.
struct Tone {
    contrast: f32,
    shoulder: f32,
    b: f32,
    c: f32,
}

const NEUTRAL: u32 = 0u;
const ACES: u32 = 1u;
const GNOMON: u32 = 2u;
const NONE: u32 = 3u;
override curve_kind: u32 = NEUTRAL;

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
fn gnomon(light: vec3f) -> vec3f {
    let peak = max(max(light.r, light.g), max(light.b, 1e-6));
    let shown = curve(peak);
    let fade = shown * shown * (1.0 - 1.0 / (1.0 + 0.25 * max(peak - 0.5, 0.0)));
    return mix(light * (shown / peak), vec3f(shown), fade);
}

// Khronos PBR Neutral (2024): base colours stay as they are up to 0.8, highlights lose saturation.
fn neutral(light: vec3f) -> vec3f {
    let start = 0.8 - 0.04;
    let desaturation = 0.15;
    let least = min(light.r, min(light.g, light.b));
    // Undoes the 4 % that a dielectric mirrors.
    let offset = select(0.04, least - 6.25 * least * least, least < 0.08);
    let base = light - offset;
    let peak = max(base.r, max(base.g, base.b));
    if peak < start {
        return base;
    }
    let rest = 1.0 - start;
    let shown = 1.0 - rest * rest / (peak + rest - start);
    let fade = 1.0 - 1.0 / (desaturation * (peak - shown) + 1.0);
    return mix(base * (shown / peak), vec3f(shown), fade);
}

// Stephen Hill's fit of ACES, with the exposure that three.js gives it.
fn aces(light: vec3f) -> vec3f {
    let to_fit = mat3x3f(
        vec3f(0.59719, 0.07600, 0.02840),
        vec3f(0.35458, 0.90834, 0.13383),
        vec3f(0.04823, 0.01566, 0.83777),
    );
    let from_fit = mat3x3f(
        vec3f(1.60475, -0.10208, -0.00327),
        vec3f(-0.53108, 1.10813, -0.07276),
        vec3f(-0.07367, -0.00605, 1.07602),
    );
    let v = to_fit * (light / 0.6);
    let fitted = (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.4329510) + 0.238081);
    return from_fit * fitted;
}

fn toned(light: vec3f) -> vec3f {
    switch curve_kind {
        case NEUTRAL: {
            return saturate(neutral(light));
        }
        case ACES: {
            return saturate(aces(light));
        }
        case GNOMON: {
            return gnomon(light);
        }
        default: {
            return saturate(light);
        }
    }
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
    // Pictures without a curve are for comparisons, which dither would disturb.
    let dither = select(threshold(pixel) / 255.0, 0.0, curve_kind == NONE);
    return vec4f(encoded(toned(light)) + dither, 1.0);
}
