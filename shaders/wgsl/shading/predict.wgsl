// Prediction: the visibility of every pixel's surface, from masks traced for other views, and from the client's own
// shadow maps where those views did not see the surface.
//
// Visibility belongs to a point of the scene, not to a pixel, so each surface point is looked up where the mask's view
// saw it. The dissertation (§3.6) takes the nearest sample, whatever it saw, and treats only points outside the picture
// as unknown. Here a sample counts only if its point lies in the plane of the looked-up surface. So nothing bleeds
// across edges, and surfaces that were hidden are unknown. Where the samples around the point disagree about a light, a
// shadow's edge runs between them: a wider kernel places it between the samples, not along their
// borders (the dissertation's Figure 20).
//
// Masks may arrive in part. Tiles missing from the newest are looked up in earlier ones, each in its own view.
//
// What moves is looked up where it was. A light whose shadow on a point has changed since is unknown (`changed.wgsl`).

#import "shading/view.wgsl"
#import "shading/lighting.wgsl"
#import "shading/shadow_map.wgsl"
#import "shading/baseline.wgsl"
#import "shading/put_off.wgsl"
#import "shading/before.wgsl"

// Twin: `shading::MaskLayer`.
struct MaskLayer {
    // The view that the mask was traced for, with the mask's size.
    view: View,
    // Layer of the textures.
    slot: u32,
    // 1 if the mask was traced for the picture's own view.
    same_view: u32,
    // 1 if all of it has arrived.
    whole: u32,
    // 1 if the mask was traced for the picture's own time.
    same_time: u32,
}

// Twin: `shading::Prediction`.
struct Prediction {
    // Newest first.
    layers: array<MaskLayer, 8>,
    // Number of layers; if 0, everything is unknown.
    count: u32,
    predictor: u32,
    // How the dissertation's predictor fills unknown points.
    unknown: u32,
    // A bit for each light.
    lights: u32,
}

// False if there is at most one mask, and it is whole. Then the shader needs fewer registers: a client's whole frame
// takes 7 to 9 % less time on an H200, with any predictor.
override layered: bool = true;

// True in a first pass, which puts off the pixels that shadow's edges cross and those without visibility: both take
// many times as long as the others. A visibility share of 1 and prediction by surface are required.
override puts_off: bool = false;

// False if there is no mask; and if every mask was traced for the picture's own view. Software runs both sides of every
// branch, so what is not needed must not be compiled.
override masks: bool = true;
override from_elsewhere: bool = true;

// True if something has moved since a mask was traced, and prediction is by surface.
override moved: bool = false;

const PREDICT_NOTHING: u32 = 0u;
const PREDICT_DISSERTATION: u32 = 1u;
const PREDICT_SURFACE: u32 = 2u;

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> lighting: Lighting;
@group(0) @binding(2) var shadow_map: texture_depth_2d;
@group(0) @binding(3) var<storage, read> shadow_views: array<ShadowView>;
@group(0) @binding(4) var<uniform> prediction: Prediction;
@group(0) @binding(5) var<storage, read_write> unknown_pixels: atomic<u32>;
// For each layer, and for each piece.
@group(0) @binding(6) var<storage, read> before: array<Before>;
@group(1) @binding(0) var depth_picture: texture_depth_2d;
@group(1) @binding(1) var normal_material_picture: texture_2d<u32>;
// x: the lights that reach the pixel. y: below a visibility share of 1, the client's own estimate, which shading mixes
// in. At a share of 1 shading ignores y, and it says where x is from: 0 if a mask lacked a light, or else 1 + the
// oldest layer that a light needed.
@group(1) @binding(2) var visibility: texture_storage_2d<rg32uint, write>;
@group(1) @binding(3) var<storage, read_write> put_off: PutOff;
// Of the piece that a pixel shows: see `pieces.wgsl`.
@group(1) @binding(4) var piece_picture: texture_2d<u32>;
// Lights whose shadow has changed, one bit each.
@group(1) @binding(5) var changed_picture: texture_2d<u32>;
@group(2) @binding(0) var mask_words: texture_2d_array<u32>;
// Lights that have arrived, one texel for 64×8 pixels.
@group(2) @binding(1) var mask_coverage: texture_2d_array<u32>;
@group(2) @binding(2) var mask_depth: texture_depth_2d_array;
@group(2) @binding(3) var nearest_texel: sampler;

// Set where a first pass does not get far enough.
var<private> unsettled: bool = false;

// A surface point, as seen by the mask's view.
struct Place {
    layer: u32,
    point: vec3f,
    normal: vec3f,
    // In pixels of the mask, with whole numbers at pixel centres.
    at: vec2f,
    // Side of a mask pixel at the point's distance, in metres.
    footprint_m: f32,
}

// What a mask says about a point.
struct Found {
    // Lights it has a bit for.
    known: u32,
    // Lights of `known` that reach the point.
    word: u32,
}

const NOTHING = Found(0u, 0u);

// What all masks say, and the oldest one that was used.
struct Told {
    found: Found,
    oldest: u32,
}

// Four samples of the mask in a square, in textureGather's order: lower left, lower right, upper right, upper left.
struct Quad {
    // True if the sample's own point lies on the looked-up surface.
    on_surface: vec4<bool>,
    words: vec4u,
    // Lights that have arrived, for each sample.
    came: vec4u,
    // Squared distance to the looked-up point, in pixels of the mask.
    distance_2: vec4f,
}

// The lights that have arrived at a sample of the mask.
fn came_at(layer: u32, sample: vec2i) -> u32 {
    let size = vec2u(prediction.layers[layer].view.width, prediction.layers[layer].view.height);
    let texel = clamp(sample, vec2i(0), vec2i(size) - 1);
    return textureLoad(mask_coverage, texel / vec2i(64, 8), prediction.layers[layer].slot, 0).x;
}

// The square with its upper left sample at `corner`.
//
// A sample's point is up to a few footprints away within the plane. The packed normal is off by up to 1/100, and a
// curved surface by less than a fifth of a footprint unless it bends by more than 20° from one sample to the next.
fn quad_at(place: Place, corner: vec2f) -> Quad {
    let size = vec2f(vec2u(prediction.layers[place.layer].view.width, prediction.layers[place.layer].view.height));
    let middle = (corner + 1.0) / size;
    let slot = prediction.layers[place.layer].slot;
    let depth = textureGather(mask_depth, nearest_texel, middle, slot);
    let words = textureGather(0, mask_words, nearest_texel, middle, slot);
    var came = vec4u(prediction.lights);
    if layered && prediction.layers[place.layer].whole == 0u {
        let sample = vec2i(corner);
        came = vec4u(
            came_at(place.layer, sample + vec2i(0, 1)),
            came_at(place.layer, sample + vec2i(1, 1)),
            came_at(place.layer, sample + vec2i(1, 0)),
            came_at(place.layer, sample),
        );
    }
    let across = corner.x + vec4f(0.0, 1.0, 1.0, 0.0);
    let down = corner.y + vec4f(1.0, 1.0, 0.0, 0.0);
    // The four points relative to the looked-up one, as in `point_at_depth`. Depth is 0 where there is no surface.
    let view_x = (2.0 * across + 1.0) / size.x - 1.0;
    let view_y = 1.0 - (2.0 * down + 1.0) / size.y;
    let distance = prediction.layers[place.layer].view.near_m / max(depth, vec4f(1e-30));
    let eye = prediction.layers[place.layer].view.origin - place.point;
    let forward = prediction.layers[place.layer].view.forward;
    let right = prediction.layers[place.layer].view.right;
    let up = prediction.layers[place.layer].view.up;
    let x = eye.x + distance * (forward.x + view_x * right.x + view_y * up.x);
    let y = eye.y + distance * (forward.y + view_x * right.y + view_y * up.y);
    let z = eye.z + distance * (forward.z + view_x * right.z + view_y * up.z);
    let off_plane = abs(place.normal.x * x + place.normal.y * y + place.normal.z * z);
    let in_plane = off_plane <= 0.2 * place.footprint_m + 0.02 * sqrt(x * x + y * y + z * z);
    // Gathering beyond the border repeats it.
    let in_mask = (across >= vec4f(0.0)) & (across < vec4f(size.x)) & (down >= vec4f(0.0)) & (down < vec4f(size.y));
    let away_x = across - place.at.x;
    let away_y = down - place.at.y;
    return Quad((depth > vec4f(0.0)) & in_mask & in_plane, words & came, came, away_x * away_x + away_y * away_y);
}

// Closer than this to a sample's centre, in pixels of the mask, that sample alone decides.
const ON_CENTRE_PX: f32 = 0.2;

// Weights of samples on the surface. Wrong bits of known points at lag 6, on Sponza at 1080p: nearest 0.34 %, bilinear
// 0.30 %, this 0.27 %. Wider kernels gain on straight edges what they lose on leaves.
fn edge_weights(quad: Quad) -> vec4f {
    return select(vec4f(0.0), exp(-0.85 * quad.distance_2), quad.on_surface);
}

// Total weight of the samples that a light reaches, and of the samples that have a bit for it.
fn reached(quad: Quad, weights: vec4f, light: u32) -> vec2f {
    let here = vec4u(light);
    let lit = dot(weights, vec4f((quad.words >> here) & vec4u(1u)));
    if !layered {
        return vec2f(lit, dot(weights, vec4f(1.0)));
    }
    return vec2f(lit, dot(weights, vec4f((quad.came >> here) & vec4u(1u))));
}

// The lights of `disputed` that reach the place, by the weighted majority of 16 samples.
fn edge_word(place: Place, disputed: u32) -> u32 {
    let corner = floor(place.at);
    let a = quad_at(place, corner + vec2f(-1.0, -1.0));
    let b = quad_at(place, corner + vec2f(1.0, -1.0));
    let c = quad_at(place, corner + vec2f(-1.0, 1.0));
    let d = quad_at(place, corner + vec2f(1.0, 1.0));
    let of_a = edge_weights(a);
    let of_b = edge_weights(b);
    let of_c = edge_weights(c);
    let of_d = edge_weights(d);
    var word = 0u;
    for (var rest = disputed; rest != 0u; rest &= rest - 1u) {
        let light = firstTrailingBit(rest);
        let all = reached(a, of_a, light) + reached(b, of_b, light) + reached(c, of_c, light) + reached(d, of_d, light);
        word |= select(0u, 1u << light, all.x > 0.5 * all.y);
    }
    return word;
}

fn any_of(words: vec4u) -> u32 {
    return words.x | words.y | words.z | words.w;
}

fn by_surface(place: Place) -> Found {
    let quad = quad_at(place, floor(place.at));
    let some = any_of(select(vec4u(0u), quad.words, quad.on_surface));
    let not_every = any_of(select(vec4u(0u), quad.came & ~quad.words, quad.on_surface));
    let known = (some | not_every) & prediction.lights;
    let disputed = some & not_every & prediction.lights;
    if disputed == 0u {
        return Found(known, some);
    }
    // Close to a sample's centre that sample is right, and a kernel would round off corners. In a mask traced for
    // nearly this view, such centres are everywhere.
    let on_centre = quad.on_surface & (quad.distance_2 < vec4f(ON_CENTRE_PX * ON_CENTRE_PX));
    let certain = any_of(select(vec4u(0u), quad.came, on_centre)) & disputed;
    var word = (some & ~not_every) | (any_of(select(vec4u(0u), quad.words, on_centre)) & certain);
    if puts_off {
        unsettled = unsettled || (disputed & ~certain) != 0u;
    } else if (disputed & ~certain) != 0u {
        word |= edge_word(place, disputed & ~certain);
    }
    return Found(known, word);
}

// What a mask says about a pixel of its own view.
fn from_same_view(layer: u32, pixel: vec2u) -> Found {
    let word = textureLoad(mask_words, pixel, prediction.layers[layer].slot, 0).x;
    if !layered || prediction.layers[layer].whole == 1u {
        return Found(prediction.lights, word);
    }
    return Found(came_at(layer, vec2i(pixel)), word);
}

// What a mask says about a surface point.
fn from_other_view(layer: u32, point: vec3f, normal: vec3f) -> Found {
    let clip = prediction.layers[layer].view.clip_from_local * vec4f(point, 1.0);
    if clip.w < prediction.layers[layer].view.near_m {
        return NOTHING;
    }
    let size = vec2f(vec2u(prediction.layers[layer].view.width, prediction.layers[layer].view.height));
    let at = (clip.xy / clip.w * vec2f(0.5, -0.5) + 0.5) * size - 0.5;
    if any(at < vec2f(-0.5)) || any(at > size - 0.5) {
        return NOTHING;
    }
    let footprint_m = clip.w * 2.0 * length(prediction.layers[layer].view.up) / size.y;
    let place = Place(layer, point, normal, at, footprint_m);
    if prediction.predictor == PREDICT_DISSERTATION {
        return by_dissertation(place);
    }
    return by_surface(place);
}

// What a mask says about a pixel's surface point.
fn from_mask(layer: u32, pixel: vec2u, point: vec3f, normal: vec3f) -> Found {
    if !from_elsewhere || prediction.layers[layer].same_view == 1u {
        return from_same_view(layer, pixel);
    }
    if moved && prediction.layers[layer].same_time == 0u {
        let known = prediction.lights & ~textureLoad(changed_picture, pixel, 0).x;
        var found = NOTHING;
        let piece = textureLoad(piece_picture, pixel, 0);
        var then = Then(point, normal, true);
        if piece.x != 0u {
            then = then_of(before[layer * (arrayLength(&before) / 8u) + piece.x - 1u], piece, point, normal);
        }
        if then.is_known {
            found = from_other_view(layer, then.point, then.normal);
        }
        return Found(found.known & known, found.word & known);
    }
    return from_other_view(layer, point, normal);
}

// What the masks say about a pixel's surface point. For each light, the newest mask that has its bit decides.
fn from_masks(pixel: vec2u, point: vec3f, normal: vec3f) -> Told {
    if !masks || prediction.count == 0u {
        return Told(NOTHING, 0u);
    }
    if !layered {
        return Told(from_mask(0u, pixel, point, normal), 0u);
    }
    var found = NOTHING;
    var oldest = 0u;
    for (var layer = 0u; layer < prediction.count && found.known != prediction.lights; layer++) {
        let more = from_mask(layer, pixel, point, normal);
        let fresh = more.known & ~found.known;
        found = Found(found.known | fresh, found.word | (more.word & fresh));
        oldest = select(oldest, layer, fresh != 0u);
    }
    return Told(found, oldest);
}

// Visibility of the surface point from the client's own shadow maps, for some lights.
fn from_shadow_map(point: vec3f, normal: vec3f, lights: u32) -> u32 {
    var word = 0u;
    for (var rest = lights; rest != 0u; rest &= rest - 1u) {
        let k = firstTrailingBit(rest);
        let light = lighting.lights[k];
        let toward = select(normalize(light.position - point), -light.direction, light.kind == DIRECTIONAL);
        let shadow = shadow_views[shadow_view_of(light, point)];
        word |= select(0u, 1u << k, shadow_map_lit(shadow_map, shadow, light.kind, toward, point, normal));
    }
    return word;
}

// Visibility where no mask has any, for some lights.
fn by_itself(pixel: vec2u, point: vec3f, normal: vec3f, lights: u32) -> u32 {
    if prediction.predictor == PREDICT_SURFACE {
        return from_shadow_map(point, normal, lights);
    }
    if prediction.predictor == PREDICT_DISSERTATION && prediction.count != 0u {
        return unknown_to_dissertation(pixel);
    }
    return 0xffffffffu;
}

fn put(pixel: vec2u, words: vec2u) {
    textureStore(visibility, pixel, vec4u(words, 0u, 0u));
}

@compute @workgroup_size(8, 8)
fn predict(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_index) place_in_group: u32,
) {
    var pixel = id.xy;
    if !puts_off {
        pixel = pixel_put_off(id.xy, group.xy, place_in_group);
    }
    if any(pixel >= vec2u(view.width, view.height)) {
        return;
    }
    let packed = textureLoad(normal_material_picture, pixel, 0).y;
    if material_plus_1(packed) == 0u {
        put(pixel, vec2u(0u));
        return;
    }
    let point = point_at_depth(view, pixel, textureLoad(depth_picture, pixel, 0));
    let normal = unpack_plane_normal(packed);
    let told = from_masks(pixel, point, normal);
    let found = told.found;
    let unknown = prediction.lights & ~found.known;
    if puts_off && (unsettled || unknown != 0u) {
        put_off_pixel(pixel);
        return;
    }
    if unknown == 0u && (puts_off || view.visibility_share >= 1.0) {
        put(pixel, vec2u(found.word, 1u + told.oldest));
        return;
    }
    // Below that share, shading mixes in the client's own estimate of every light.
    let own = by_itself(pixel, point, normal, select(prediction.lights, unknown, view.visibility_share >= 1.0));
    if unknown == 0u {
        put(pixel, vec2u(found.word, own));
        return;
    }
    atomicAdd(&unknown_pixels, 1u);
    let word = found.word | (own & unknown);
    put(pixel, vec2u(word, select(own, 0u, view.visibility_share >= 1.0)));
}
