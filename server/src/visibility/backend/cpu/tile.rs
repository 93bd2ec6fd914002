//! One tile of 8×8 pixels: camera rays, surface points, then shadow rays light by light.

use std::time::{Duration, Instant};

use gnomon_protocol::mask::TILE_PX;
use gnomon_scene::camera::RayBasis;

use super::{
    count::Counter,
    group::{Group, PACKETS, Projection},
    light::{PreparedLight, lanes_by_face},
    regroup::{Regrouping, packet_sets},
    simd::{F8, Simd},
    surface::{Coordinates, Surface},
    traverse::{Hits, Scratch, intersect, occluded},
    vector,
    world::Stage,
};
use crate::visibility::hierarchy::bvh::Child;

/// The picture that contains a tile.
#[derive(Clone, Copy)]
pub(super) struct Picture {
    pub(super) basis: RayBasis,
    pub(super) width: u32,
    pub(super) height: u32,
}

#[derive(Debug, Default)]
pub(super) struct TileCost<C> {
    pub(super) primary: Duration,
    pub(super) shadow: Duration,
    pub(super) shadow_rays: u64,
    pub(super) primary_stats: C,
    pub(super) shadow_stats: C,
}

/// Memory that a thread reuses from tile to tile.
pub(super) struct TileScratch {
    directions: [[F8; PACKETS]; 3],
    hits: Hits,
    surface: Surface,
    traversal: Scratch,
    /// The child that last stopped a shadow ray, by light: in the tree of what rests, and of what moves.
    blockers: [[Child; 2]; 32],
}

impl Default for TileScratch {
    fn default() -> Self {
        Self {
            directions: [[F8::default(); PACKETS]; 3],
            hits: Hits::default(),
            surface: Surface::default(),
            traversal: Scratch::default(),
            blockers: [[Child::None; 2]; 32],
        }
    }
}

/// Packets are 4×2 pixels: lane i of packet p is the pixel (4·(p mod 2) + i mod 4, 2·⌊p/2⌋ + ⌊i/4⌋) of the tile.
const PACKET_CORNERS: [(u32, u32); PACKETS] = [(0, 0), (4, 0), (0, 2), (4, 2), (0, 4), (4, 4), (0, 6), (4, 6)];

/// A packet's lanes as bits of the tile's word.
fn word_bits(p: usize, lanes: u8) -> u64 {
    let (x, y) = PACKET_CORNERS[p];
    let row = 8 * y + x;
    u64::from(lanes & 15) << row | u64::from(lanes >> 4) << (row + 8)
}

/// Exact: a picture's sides have at most 4096 pixels.
#[expect(clippy::cast_precision_loss, reason = "pixel coordinates are below 2^24")]
fn float(x: u32) -> f32 {
    x as f32
}

/// Traces tile (`tile_x`, `tile_y`) and calls `write` with each light's index and word.
#[inline(always)]
pub(super) fn trace_tile<S: Simd, C: Counter>(
    s: S,
    stage: &Stage<'_>,
    picture: &Picture,
    (tile_x, tile_y): (u32, u32),
    scratch: &mut TileScratch,
    cost: &mut TileCost<C>,
    mut write: impl FnMut(usize, u64),
) {
    let start = Instant::now();
    let TileScratch { directions, hits, surface, traversal, blockers } = scratch;
    let present = aim(s, picture, tile_x, tile_y, directions);

    let mut faces = [[0; PACKETS]; 6];
    for (p, &present) in present.iter().enumerate() {
        let sorted = lanes_by_face(s, vector::load_packet(s, directions, p));
        for (face, lanes) in faces.iter_mut().zip(sorted) {
            face[p] = lanes & present;
        }
    }
    hits.inverse_depth = [F8::default(); PACKETS];
    for (face, lanes) in (0..).zip(&faces) {
        if *lanes == [0; PACKETS] {
            continue;
        }
        let projection = Projection::from_apex(picture.basis.origin, face);
        let mut group = Group::empty(projection);
        for p in (0..PACKETS).filter(|&p| lanes[p] != 0) {
            let [x, y, z] = projection.permute(s, vector::load_packet(s, directions, p));
            let inverse = s.div(s.splat(1.0), z);
            group.set_packet(s, p, x * inverse, y * inverse, lanes[p]);
        }
        // In a loop, so that the code is there once.
        for geometry in stage.geometries() {
            intersect(s, geometry, &group, hits, traversal, &mut cost.primary_stats);
        }
    }
    for (p, &present) in present.iter().enumerate() {
        let hit = s.bits(s.gt(s.load(&hits.inverse_depth[p]), s.splat(0.0))) & present;
        let direction = vector::load_packet(s, directions, p);
        surface.set_packet(s, p, hit, stage.corners(), &hits.triangle[p], (picture.basis.origin, direction));
    }
    let traced = Instant::now();
    cost.primary += traced - start;

    for (plane, light) in stage.lights.iter().enumerate() {
        let mut rays = [0; PACKETS];
        for p in (0..PACKETS).filter(|&p| surface.lanes[p] != 0) {
            rays[p] = light.rays(s, surface, p);
        }
        traversal.blockers = blockers[plane];
        cost.shadow_rays += rays.iter().map(|lanes| u64::from(lanes.count_ones())).sum::<u64>();
        let word = light_tile(s, stage, light, &rays, surface, traversal, &mut cost.shadow_stats);
        write(plane, word);
        blockers[plane] = traversal.blockers;
    }
    cost.shadow += traced.elapsed();
}

/// Writes the directions of a tile's camera rays. Returns the lanes inside the picture.
#[inline(always)]
fn aim<S: Simd>(
    s: S,
    picture: &Picture,
    tile_x: u32,
    tile_y: u32,
    directions: &mut [[F8; PACKETS]; 3],
) -> [u8; PACKETS] {
    let RayBasis { forward, right, up, .. } = picture.basis;
    let lane_x = s.load(&F8([0.5, 1.5, 2.5, 3.5, 0.5, 1.5, 2.5, 3.5]));
    let lane_y = s.load(&F8([0.5, 0.5, 0.5, 0.5, 1.5, 1.5, 1.5, 1.5]));
    let (width, height) = (s.splat(float(picture.width)), s.splat(float(picture.height)));
    let (one, two) = (s.splat(1.0), s.splat(2.0));
    let mut present = [0; PACKETS];
    for (p, present) in present.iter_mut().enumerate() {
        let (left, top) = PACKET_CORNERS[p];
        let x = lane_x + s.splat(float(tile_x * TILE_PX + left));
        let y = lane_y + s.splat(float(tile_y * TILE_PX + top));
        *present = s.bits(s.and(s.gt(width, x), s.gt(height, y)));
        let ndc_x = s.div(x * two, width) - one;
        let ndc_y = one - s.div(y * two, height);
        for axis in 0..3 {
            let along = s.fma(s.splat(right[axis]), ndc_x, s.splat(forward[axis]));
            s.store(s.fma(s.splat(up[axis]), ndc_y, along), &mut directions[axis][p]);
        }
    }
    present
}

/// Traces the shadow rays `rays` of a light. Returns the tile's word: pixels that the light reaches.
#[inline(always)]
fn light_tile<S: Simd, C: Counter>(
    s: S,
    stage: &Stage<'_>,
    light: &PreparedLight,
    rays: &[u8; PACKETS],
    surface: &Surface,
    scratch: &mut Scratch,
    count: &mut C,
) -> u64 {
    if *rays == [0; PACKETS] {
        return 0;
    }
    let points = &surface.pushed;
    if light.directional || light.distant {
        let projection = if light.directional {
            Projection::along(light.direction, stage.middle)
        } else {
            Projection::from_distant(light.position, stage.middle)
        };
        let mut group = Group::empty(projection);
        for p in (0..PACKETS).filter(|&p| rays[p] != 0) {
            let from_middle = from_origin(s, points, &projection, p);
            let x = s.fnma(s.splat(projection.shear[0]), from_middle[2], from_middle[0]);
            let y = s.fnma(s.splat(projection.shear[1]), from_middle[2], from_middle[1]);
            let inverse = s.div(s.splat(1.0), s.fma(s.splat(projection.spread), from_middle[2], s.splat(1.0)));
            group.set_packet(s, p, x * inverse, y * inverse, rays[p]);
        }
        return trace_group::<S, C, true>(s, stage, group, points, scratch, count);
    }
    let mut word = 0;
    for (face, lanes) in (0..).zip(&light.faces(s, surface, rays)) {
        if *lanes == [0; PACKETS] {
            continue;
        }
        let projection = Projection::from_apex(light.position, face);
        let mut group = Group::empty(projection);
        for p in (0..PACKETS).filter(|&p| lanes[p] != 0) {
            let [x, y, z] = from_origin(s, points, &projection, p);
            let inverse = s.div(s.splat(1.0), z);
            group.set_packet(s, p, x * inverse, y * inverse, lanes[p]);
        }
        word |= trace_group::<S, C, false>(s, stage, group, points, scratch, count);
    }
    word
}

/// Groups with longer sides are regrouped. A tangent for rays from an apex; relative to the scene for parallel rays.
const WIDE: f32 = 0.03;
const WIDE_PARALLEL: f32 = 0.003;
/// Padding of a part's sides, relative to that length.
const PADDING: f32 = 0.3;

/// Traces a group of shadow rays. Returns the pixels whose rays reach their points.
#[inline(always)]
fn trace_group<S: Simd, C: Counter, const PARALLEL: bool>(
    s: S,
    stage: &Stage<'_>,
    mut group: Group,
    points: &Coordinates,
    scratch: &mut Scratch,
    count: &mut C,
) -> u64 {
    let wide = if PARALLEL { WIDE_PARALLEL * stage.size_m } else { WIDE };
    if group.side() <= wide {
        occluded_by_any::<S, C, PARALLEL>(s, stage, &mut group, points, scratch, count);
    } else if group.widest_packet(s) <= wide {
        for packets in packet_sets(s, &group, wide * PADDING) {
            group.packets = packets;
            group.shrink(s);
            occluded_by_any::<S, C, PARALLEL>(s, stage, &mut group, points, scratch, count);
        }
    } else {
        let mut regrouping = Regrouping::of(&group, wide * PADDING);
        let mut left = [0; PACKETS];
        for range in regrouping.sort() {
            let mut part = regrouping.part(s, range, group.projection, points);
            occluded_by_any::<S, C, PARALLEL>(s, stage, &mut part.group, &part.points, scratch, count);
            part.add_left(&mut left);
        }
        group.lanes = left;
    }
    group.lanes.iter().enumerate().fold(0, |word, (p, &lanes)| word | word_bits(p, lanes))
}

/// Removes the rays that something stops, resting or moving: see [`occluded`].
#[inline(always)]
fn occluded_by_any<S: Simd, C: Counter, const PARALLEL: bool>(
    s: S,
    stage: &Stage<'_>,
    group: &mut Group,
    points: &Coordinates,
    scratch: &mut Scratch,
    count: &mut C,
) {
    for (tree, geometry) in stage.geometries().enumerate() {
        if tree > 0 {
            if group.packets == 0 {
                return;
            }
            group.shrink(s);
        }
        occluded::<S, C, PARALLEL>(s, geometry, (tree, stage.size_m), group, points, scratch, count);
    }
}

/// Packet `p` of `points` in the projection's frame, relative to its origin.
#[inline(always)]
fn from_origin<S: Simd>(s: S, points: &Coordinates, projection: &Projection, p: usize) -> [S::F; 3] {
    let [u, v, w] = projection.axes;
    [
        s.load(&points[u][p]) - s.splat(projection.origin[0]),
        s.load(&points[v][p]) - s.splat(projection.origin[1]),
        (s.load(&points[w][p]) - s.splat(projection.origin[2])) * s.splat(projection.w_sign),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_lane_has_its_own_bit_of_the_word() {
        let mut seen = 0;
        for (p, (x, y)) in PACKET_CORNERS.into_iter().enumerate() {
            for lane in 0..8 {
                let bits = word_bits(p, 1 << lane);
                assert_eq!(bits, 1 << (8 * (y + lane / 4) + x + lane % 4));
                assert_eq!(seen & bits, 0);
                seen |= bits;
            }
        }
        assert_eq!(seen, u64::MAX);
    }
}
