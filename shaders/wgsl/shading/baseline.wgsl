// The dissertation's predictor (§3.6), to measure against. `predict.wgsl` imports it and declares what it reads.

const UNKNOWN_LIT: u32 = 0u;
const UNKNOWN_SHADOW: u32 = 1u;
const UNKNOWN_COPY: u32 = 2u;

fn in_mask(layer: u32, sample: vec2i) -> bool {
    let size = vec2u(prediction.layers[layer].view.width, prediction.layers[layer].view.height);
    return all(sample >= vec2i(0)) && all(sample < vec2i(size));
}

// The nearest sample, whatever it saw.
fn by_dissertation(place: Place) -> Found {
    let sample = vec2i(round(place.at));
    if !in_mask(place.layer, sample) {
        return NOTHING;
    }
    return Found(prediction.lights, textureLoad(mask_words, sample, prediction.layers[place.layer].slot, 0).x);
}

// Visibility of a point outside the mask's picture: lit, in shadow, or the mask's word at the same pixel.
fn unknown_to_dissertation(pixel: vec2u) -> u32 {
    if prediction.unknown == UNKNOWN_SHADOW {
        return 0u;
    }
    let sample = vec2i(pixel);
    if prediction.unknown == UNKNOWN_COPY && in_mask(0u, sample) {
        return textureLoad(mask_words, sample, prediction.layers[0].slot, 0).x;
    }
    return 0xffffffffu;
}
