// From exposed light to the screen: tone curve, edges, sRGB encoding, dither.
// `client/docs/light-and-exposure.md` says where the curves come from.
//
// Edges of surfaces are smooth as those of shadows are (`edges.wgsl`): where the nine pixels around show other
// surfaces, too, the pattern says which share of the pixel its own surface covers. The rest is what the others show
// (`client/docs/edges.md`).

#import "shading/view.wgsl"
#import "shading/same_surface.wgsl"
#import "shading/put_off.wgsl"

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

// False draws each pixel as its centre is.
override smooth_edges: bool = true;

// True in a first pass, which puts off the pixels that an edge crosses.
override puts_off: bool = false;

@group(0) @binding(0) var<uniform> tone: Tone;
@group(0) @binding(1) var<uniform> view: View;
@group(0) @binding(2) var light_picture: texture_2d<f32>;
@group(0) @binding(3) var depth_picture: texture_depth_2d;
@group(0) @binding(4) var normal_material_picture: texture_2d<u32>;
@group(0) @binding(5) var<storage, read> edge_shares: array<f32, 512>;
@group(0) @binding(6) var<storage, read_write> put_off: PutOff;
@group(1) @binding(0) var target_picture: texture_storage_2d<rgba8unorm, write>;

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

// What a pixel's light becomes on the screen, linear.
fn shown_at(pixel: vec2u) -> vec3f {
    return toned(textureLoad(light_picture, pixel, 0).rgb);
}

fn put(pixel: vec2u, linear: vec3f) {
    // Pictures without a curve are for comparisons, which dither would disturb.
    let dither = select(threshold(pixel) / 255.0, 0.0, curve_kind == NONE);
    textureStore(target_picture, pixel, vec4f(encoded(linear) + dither, 1.0));
}

// The pixels around that show the same surface of the same material: bit 3·row + column.
fn same_around(pixel: vec2u) -> u32 {
    let word = textureLoad(normal_material_picture, pixel, 0).y;
    let material = material_plus_1(word);
    let depth = textureLoad(depth_picture, pixel, 0);
    let point = point_at_depth(view, pixel, max(depth, 1e-30));
    let normal = unpack_plane_normal(word);
    let footprint_m = footprint_of(point);
    var same = 0u;
    for (var place = 0u; place < 9u; place++) {
        let other = neighbour(pixel, place);
        let its_material = material_plus_1(textureLoad(normal_material_picture, other, 0).y);
        // Where there is no surface there is the sky, behind any number of pixels.
        let on_plane = material == 0u || is_on_plane(other, point, normal, footprint_m);
        same |= select(0u, 1u << place, its_material == material && on_plane);
    }
    return same;
}

const ALL_NINE: u32 = 0x1ffu;

// Weights of the pixels beside one and at its corners, before its own 1: a Gaussian of half a pixel, as a screen shows
// one. As `WEIGHTS` of `edge_shares.rs`.
const BESIDE: f32 = 0.1353;
const AT_CORNER: f32 = 0.0183;

// What a pixel shows if an edge crosses it, linear: what is on either side of the edge, by its share.
fn smoothed(pixel: vec2u) -> vec3f {
    let same = same_around(pixel);
    var own = vec4f(shown_at(pixel), 1.0);
    var others = vec4f(0.0);
    for (var place = 0u; place < 9u; place++) {
        if place == 4u {
            continue;
        }
        let weight = select(AT_CORNER, BESIDE, place % 2u == 1u);
        let seen = vec4f(shown_at(neighbour(pixel, place)), 1.0) * weight;
        let is_same = ((same >> place) & 1u) == 1u;
        own += select(vec4f(0.0), seen, is_same);
        others += select(seen, vec4f(0.0), is_same);
    }
    return mix(others.rgb / max(others.a, AT_CORNER), own.rgb / own.a, edge_shares[same]);
}

@compute @workgroup_size(8, 8)
fn show(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_index) place_in_group: u32,
) {
    var pixel = id.xy;
    if smooth_edges && !puts_off {
        pixel = pixel_put_off(id.xy, group.xy, place_in_group);
    }
    if any(pixel >= vec2u(view.width, view.height)) {
        return;
    }
    if puts_off && same_around(pixel) != ALL_NINE {
        put_off_pixel(pixel);
        return;
    }
    if smooth_edges && !puts_off {
        put(pixel, smoothed(pixel));
        return;
    }
    put(pixel, shown_at(pixel));
}
