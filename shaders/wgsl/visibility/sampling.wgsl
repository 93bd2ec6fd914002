// Which pixels of a tile trace shadow rays of their own, and what the others make of their neighbours' answers. Imported by
// visibility/shadow.wgsl, which declares `view` and `surfaces`. Twin: server/src/visibility/backend/sampling.rs, for `cpu`.
//
// A neighbour counts when it asks the same light, lies in the same tile, and its point is near: over the edge of a surface
// it is not. Both wanting the light means that both face it, which is all that normals could add.

const SAMPLE_ALL: u32 = 0u;
const SAMPLE_CHECKERBOARD: u32 = 1u;
const SAMPLE_QUARTER: u32 = 2u;
override SAMPLING: u32 = 0u;
// Whether pixels whose neighbours disagree trace a ray after all.
override REFINE: bool = false;

// A neighbour's point is near within this many widths of a pixel.
const NEAR_PX: f32 = 8.0;

fn has_own_ray(place: vec2u) -> bool {
    if SAMPLING == SAMPLE_ALL {
        return true;
    }
    if SAMPLING == SAMPLE_CHECKERBOARD {
        return ((place.x ^ place.y) & 1u) == 0u;
    }
    return ((place.x | place.y) & 1u) == 0u;
}

const DARK: u32 = 0u;
const LIT: u32 = 1u;
const UNDECIDED: u32 = 2u;

// What the neighbours that traced rays say of the pixel at `place`, nearer ones more loudly. UNDECIDED when none counts.
fn neighbours_verdict(place: vec2u, light: u32, tile: u32, start: vec3f, words: vec2u) -> u32 {
    let pixel_m = distance(start, view.origin) * 2.0 * length(view.right) / f32(view.width);
    var lit = 0.0;
    var dark = 0.0;
    for (var index = 0u; index < 9u; index++) {
        let at = vec2i(place) + vec2i(i32(index % 3u) - 1, i32(index / 3u) - 1);
        if any(at < vec2i(0)) || any(at > vec2i(7)) || !has_own_ray(vec2u(at)) {
            continue;
        }
        let bit = mask_bit(vec2u(at));
        let other = surfaces[tile * 64u + bit];
        let apart = distance(start, bitcast<vec3f>(other.xyz));
        if ((other.w >> light) & 1u) == 0u || apart > NEAR_PX * pixel_m {
            continue;
        }
        let weight = 1.0 / (apart * apart + pixel_m * pixel_m * 0.0625);
        if ((words[bit >> 5u] >> (bit & 31u)) & 1u) == 1u {
            lit += weight;
        } else {
            dark += weight;
        }
    }
    if lit + dark == 0.0 || (REFINE && lit > 0.0 && dark > 0.0) {
        return UNDECIDED;
    }
    return select(DARK, LIT, lit > dark);
}
