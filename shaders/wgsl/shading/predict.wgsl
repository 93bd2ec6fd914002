// Prediction: the visibility of every pixel's surface, from a mask that was traced for another view, and from what the client
// knows by itself where that view did not see the surface.
//
// Visibility belongs to a point of the scene, not to a pixel, so each surface point is looked up where the mask's view saw it.
// The dissertation (§3.6) takes the nearest sample, whatever it saw, and treats only points outside the picture as unknown. Here
// a sample counts only when its own point lies in the plane of the surface that is asked about: nothing bleeds across edges, and
// what was hidden is found to be unknown. Where the samples around the point disagree about a light, a shadow's edge runs between
// them, and a wider kernel places it between the samples instead of along their borders (the dissertation's Figure 20).

#import "shading/view.wgsl"
#import "shading/lighting.wgsl"
#import "shading/shadow_map.wgsl"

// Twin: `shading::Prediction`.
struct Prediction {
    // The view that the mask was traced for, with the mask's size.
    mask_view: View,
    // What the mask says of this view.
    source: u32,
    predictor: u32,
    // What the dissertation's predictor does with unknown points.
    unknown: u32,
    // A bit for each light.
    lights: u32,
}

// No mask: everything is unknown.
const SOURCE_NONE: u32 = 0u;
// The mask was traced for this very view.
const SOURCE_SAME_VIEW: u32 = 1u;
const SOURCE_OTHER_VIEW: u32 = 2u;

const PREDICT_NOTHING: u32 = 0u;
const PREDICT_DISSERTATION: u32 = 1u;
const PREDICT_SURFACE: u32 = 2u;

const UNKNOWN_LIT: u32 = 0u;
const UNKNOWN_SHADOW: u32 = 1u;
const UNKNOWN_COPY: u32 = 2u;

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> lighting: Lighting;
@group(0) @binding(2) var shadow_map: texture_depth_2d;
@group(0) @binding(3) var<storage, read> shadow_views: array<ShadowView>;
@group(0) @binding(4) var<uniform> prediction: Prediction;
@group(0) @binding(5) var<storage, read_write> unknown_pixels: atomic<u32>;
@group(1) @binding(0) var depth_picture: texture_depth_2d;
@group(1) @binding(1) var normal_material_picture: texture_2d<u32>;
@group(2) @binding(0) var mask_words: texture_2d<u32>;
@group(2) @binding(1) var mask_depth: texture_depth_2d;

@vertex
fn cover(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return covering_triangle(index);
}

// A surface point, as the mask's view sees it.
struct Place {
    point: vec3f,
    normal: vec3f,
    // In pixels of the mask, whole numbers at their centres.
    at: vec2f,
    // Side of a pixel of the mask at the point's distance, in metres.
    footprint_m: f32,
}

// What the mask says: a bit for each light, when it says something.
struct Found {
    known: bool,
    word: u32,
}

// Whether the sample's own point lies on the surface at `place`.
//
// The sample's point is up to a few footprints away within the plane. The packed normal is off by up to 1/100, and a curved surface
// by less than a fifth of a footprint unless it bends by more than 20° from one sample to the next.
fn same_surface(place: Place, sample: vec2i) -> bool {
    let depth = textureLoad(mask_depth, sample, 0);
    if depth == 0.0 {
        return false;
    }
    let between = point_at_depth(prediction.mask_view, vec2u(sample), depth) - place.point;
    return abs(dot(place.normal, between)) <= 0.2 * place.footprint_m + 0.02 * length(between);
}

fn in_mask(sample: vec2i) -> bool {
    return all(sample >= vec2i(0)) && all(sample < vec2i(vec2u(prediction.mask_view.width, prediction.mask_view.height)));
}

// How close to a sample's centre a place counts as being there, in pixels of the mask.
const ON_CENTRE_PX: f32 = 0.2;

// The weight of a sample `away` pixels from the place. Measured on Sponza at 1080p, wrong bits of known points at lag 6: nearest
// 0.34 %, bilinear 0.30, this 0.27; wider ones gain on straight edges what they lose on leaves.
fn edge_weight(away: vec2f) -> f32 {
    return exp(-0.85 * dot(away, away));
}

// The lights of `disputed` that reach the place, by the weighted majority of the 16 samples around it.
fn edge_word(place: Place, disputed: u32) -> u32 {
    let corner = vec2i(floor(place.at));
    var words: array<u32, 16>;
    var weights: array<f32, 16>;
    var total = 0.0;
    for (var i = 0; i < 16; i++) {
        let sample = corner + vec2i(i & 3, i >> 2) - 1;
        weights[i] = 0.0;
        if in_mask(sample) && same_surface(place, sample) {
            weights[i] = edge_weight(vec2f(sample) - place.at);
            words[i] = textureLoad(mask_words, sample, 0).x;
            total += weights[i];
        }
    }
    var word = 0u;
    for (var rest = disputed; rest != 0u; rest &= rest - 1u) {
        let light = firstTrailingBit(rest);
        var reached = 0.0;
        for (var i = 0; i < 16; i++) {
            reached += select(0.0, weights[i], ((words[i] >> light) & 1u) == 1u);
        }
        word |= select(0u, 1u << light, reached * 2.0 > total);
    }
    return word;
}

fn by_surface(place: Place) -> Found {
    let corner = vec2i(floor(place.at));
    var every = 0xffffffffu;
    var some = 0u;
    var known = false;
    for (var i = 0; i < 4; i++) {
        let sample = corner + vec2i(i & 1, i >> 1);
        if in_mask(sample) && same_surface(place, sample) {
            let word = textureLoad(mask_words, sample, 0).x;
            every &= word;
            some |= word;
            known = true;
        }
    }
    let disputed = some & ~every & prediction.lights;
    if !known || disputed == 0u {
        return Found(known, some);
    }
    // Next to a sample's centre that sample is right, and a kernel would round corners off: a mask that was traced for nearly this
    // view has such centres everywhere.
    let nearest = vec2i(round(place.at));
    if distance(place.at, vec2f(nearest)) < ON_CENTRE_PX && in_mask(nearest) && same_surface(place, nearest) {
        return Found(true, textureLoad(mask_words, nearest, 0).x);
    }
    return Found(true, (some & every) | edge_word(place, disputed));
}

fn by_dissertation(place: Place) -> Found {
    let sample = vec2i(round(place.at));
    if !in_mask(sample) {
        return Found(false, 0u);
    }
    return Found(true, textureLoad(mask_words, sample, 0).x);
}

// What the mask says of the surface point.
fn from_mask(point: vec3f, normal: vec3f) -> Found {
    let mask = prediction.mask_view;
    let clip = mask.clip_from_local * vec4f(point, 1.0);
    if clip.w < mask.near_m {
        return Found(false, 0u);
    }
    let size = vec2f(vec2u(mask.width, mask.height));
    let at = (clip.xy / clip.w * vec2f(0.5, -0.5) + 0.5) * size - 0.5;
    if any(at < vec2f(-0.5)) || any(at > size - 0.5) {
        return Found(false, 0u);
    }
    let place = Place(point, normal, at, clip.w * 2.0 * length(mask.up) / size.y);
    if prediction.predictor == PREDICT_DISSERTATION {
        return by_dissertation(place);
    }
    return by_surface(place);
}

// What the client knows by itself of the surface point.
fn from_shadow_map(point: vec3f, normal: vec3f) -> u32 {
    var word = 0u;
    for (var k = 0u; k < lighting.count; k++) {
        let light = lighting.lights[k];
        let toward = select(normalize(light.position - point), -light.direction, light.kind == DIRECTIONAL);
        let shadow = shadow_views[shadow_view_of(light, point)];
        word |= select(0u, 1u << k, shadow_map_lit(shadow_map, shadow, light.kind, toward, point, normal));
    }
    return word;
}

// What the client takes for visibility where there is none.
fn by_itself(pixel: vec2u, point: vec3f, normal: vec3f) -> u32 {
    if prediction.predictor == PREDICT_SURFACE {
        return from_shadow_map(point, normal);
    }
    if prediction.predictor == PREDICT_DISSERTATION && prediction.source != SOURCE_NONE {
        if prediction.unknown == UNKNOWN_SHADOW {
            return 0u;
        }
        let sample = vec2i(pixel);
        if prediction.unknown == UNKNOWN_COPY && in_mask(sample) {
            return textureLoad(mask_words, sample, 0).x;
        }
    }
    return 0xffffffffu;
}

// x: the lights that reach the pixel as far as can be told; y: what the client alone would say, where the shading needs it.
@fragment
fn predict(@builtin(position) place: vec4f) -> @location(0) vec2u {
    let pixel = vec2u(place.xy);
    let packed = textureLoad(normal_material_picture, pixel, 0).y;
    if material_plus_1(packed) == 0u {
        return vec2u(0u);
    }
    let point = point_at_depth(view, pixel, textureLoad(depth_picture, pixel, 0));
    let normal = unpack_plane_normal(packed);
    var found = Found(false, 0u);
    if prediction.source == SOURCE_SAME_VIEW {
        found = Found(true, textureLoad(mask_words, pixel, 0).x);
    } else if prediction.source == SOURCE_OTHER_VIEW {
        found = from_mask(point, normal);
    }
    if found.known && view.visibility_share >= 1.0 {
        // Nothing reads y now, and in unknown pixels it equals x: its complement tells a measuring reader that x was known.
        return vec2u(found.word, ~found.word);
    }
    let own = by_itself(pixel, point, normal);
    if found.known {
        return vec2u(found.word, own);
    }
    atomicAdd(&unknown_pixels, 1u);
    return vec2u(own, own);
}
