//! Takes a group of rays through the tree: [`intersect`] finds nearest triangles, [`occluded`] any that stops a ray.

use super::{
    count::Counter,
    frustum::Frustum,
    group::{Group, PACKETS},
    leaf::{Prepared, prepare},
    outline::Neighbourhood,
    rounding::{PLANE_ROUNDINGS, ROUNDING},
    simd::{F8, Simd},
    vector,
    world::Geometry,
};
use crate::visibility::hierarchy::bvh::{Child, Leaf, WideBvh};

/// Memory that a thread reuses from group to group.
pub(super) struct Scratch {
    /// Nodes and leaves left to visit, and where each one's box begins along z.
    stack: Vec<(Child, f32)>,
    prepared: Prepared,
    /// The child that last stopped a shadow ray to this light, visited first: in the tree of what rests, and of what
    /// moves.
    pub(super) blockers: [Child; 2],
}

impl Default for Scratch {
    fn default() -> Self {
        Self { stack: Vec::new(), prepared: Prepared::default(), blockers: [Child::None; 2] }
    }
}

pub(super) struct Hits {
    /// 1/z of each ray's nearest hit, by packet; 0 without one.
    pub(super) inverse_depth: [F8; PACKETS],
    /// Index of the triangle that was hit.
    pub(super) triangle: [[u32; 8]; PACKETS],
}

impl Default for Hits {
    fn default() -> Self {
        Self { inverse_depth: [F8::default(); PACKETS], triangle: [[0; 8]; PACKETS] }
    }
}

/// So few packets are tested as fast as ruled out by a triangle's edges.
const FEW_PACKETS: u32 = 2;

/// Boxes are culled with this margin, since 1/z has a relative error.
const DEPTH_SLACK: f32 = 1.0 + 1.0 / (1 << 20) as f32;

/// Finds the nearest triangle of every ray in `group`, which has an apex. `hits` may hold other groups' hits, and this
/// one's in other geometry.
#[inline(always)]
pub(super) fn intersect<S: Simd, C: Counter>(
    s: S,
    geometry: Geometry<'_>,
    group: &Group,
    hits: &mut Hits,
    scratch: &mut Scratch,
    count: &mut C,
) {
    let frustum = Frustum::new::<false>(s, group, 0.0);
    let near = Neighbourhood::of(s, group);
    // The least 1/z that still matters, by packet and overall: that of the farthest hit, 0 while a ray has none.
    let mut packet_far = F8([f32::INFINITY; PACKETS]);
    for p in 0..PACKETS {
        if group.packets >> p & 1 == 1 {
            packet_far.0[p] = 0.0;
        }
    }
    let mut inverse_far = 0.0;
    let mut z_far = f32::INFINITY;
    if geometry.first != 0 {
        // The rays may have hit what rests.
        let nothing = s.splat(f32::INFINITY);
        for p in (0..PACKETS).filter(|p| group.packets >> p & 1 == 1) {
            let best = s.load(&hits.inverse_depth[p]);
            packet_far.0[p] = s.lowest(s.select(s.mask(group.lanes[p]), best, nothing));
        }
        inverse_far = s.lowest(s.load(&packet_far));
        z_far = if inverse_far > 0.0 { DEPTH_SLACK / inverse_far } else { f32::INFINITY };
    }
    let Scratch { stack, prepared, .. } = scratch;
    stack.clear();
    stack.push((Child::Node(0), 0.0));
    count.group();
    while let Some((child, z)) = stack.pop() {
        if z > z_far {
            continue;
        }
        let leaf = match child {
            Child::None => continue,
            Child::Node(n) => {
                count.node();
                push_nearest_last(s, &frustum, geometry.bvh, n, s.splat(z_far), stack);
                continue;
            }
            Child::Leaf(l) => &geometry.bvh.leaves[l as usize],
        };
        count.leaf(leaf.used.count_ones());
        let mut alive = prepare::<S, false, true>(s, leaf, (group, &near), inverse_far, prepared);
        let mut found = false;
        while alive != 0 {
            let slot = alive.trailing_zeros() as usize % 8;
            alive &= alive - 1;
            let mut packets = group.packets;
            if prepared.outlined {
                packets &= near.packets(s, &prepared.outlines, slot);
            }
            let edges_of_slot = prepared.edges_of(s, slot);
            if packets.count_ones() > FEW_PACKETS {
                packets &= edges_of_slot.packets(s, group);
            }
            count.packets(packets.count_ones());
            while packets != 0 {
                let p = packets.trailing_zeros() as usize % 8;
                packets &= packets - 1;
                let (x, y) = (s.load(&group.x[p]), s.load(&group.y[p]));
                let edges = edges_of_slot.at(s, x, y);
                let inverse = prepared.inverse_depth_at(s, slot, x, y);
                let best = s.load(&hits.inverse_depth[p]);
                let inside = s.ge(vector::least(s, edges), s.splat(0.0));
                let mut lanes = s.bits(s.and(inside, s.gt(inverse, best))) & group.lanes[p];
                if lanes == 0 {
                    continue;
                }
                count.candidate();
                if leaf.masked >> slot & 1 == 1 {
                    count.alpha(lanes.count_ones());
                    lanes = alpha_filter(s, geometry, leaf.triangles[slot], edges, lanes);
                    if lanes == 0 {
                        continue;
                    }
                }
                let best = s.select(s.mask(lanes), inverse, best);
                s.store(best, &mut hits.inverse_depth[p]);
                for (lane, triangle) in hits.triangle[p].iter_mut().enumerate() {
                    if lanes >> lane & 1 == 1 {
                        *triangle = geometry.first + leaf.triangles[slot];
                    }
                }
                let nothing = s.splat(f32::INFINITY);
                packet_far.0[p] = s.lowest(s.select(s.mask(group.lanes[p]), best, nothing));
                found = true;
            }
        }
        if found {
            inverse_far = s.lowest(s.load(&packet_far));
            z_far = if inverse_far > 0.0 { DEPTH_SLACK / inverse_far } else { f32::INFINITY };
        }
    }
}

/// Removes from `group` every ray that a triangle stops before its end point in `points` (scene axes, by packet). The
/// remaining rays reach their points. `tree` says which blocker is this geometry's; `size_m` bounds the scene.
#[inline(always)]
pub(super) fn occluded<S: Simd, C: Counter, const PARALLEL: bool>(
    s: S,
    geometry: Geometry<'_>,
    (tree, size_m): (usize, f32),
    group: &mut Group,
    points: &[[F8; PACKETS]; 3],
    scratch: &mut Scratch,
    count: &mut C,
) {
    let mut frustum = Frustum::new::<PARALLEL>(s, group, size_m);
    let near = Neighbourhood::of(s, group);
    let mut swept = group.packets;
    let z_far = s.splat(farthest(s, group, points));
    let Scratch { stack, prepared, blockers } = scratch;
    let blocker = &mut blockers[tree];
    stack.clear();
    stack.push((Child::Node(0), 0.0));
    stack.push((*blocker, 0.0));
    count.group();
    while let Some((child, _)) = stack.pop() {
        if group.packets != swept {
            swept = group.packets;
            group.shrink(s);
            frustum = Frustum::new::<PARALLEL>(s, group, size_m);
        }
        let leaf = match child {
            Child::None => continue,
            Child::Node(n) => {
                count.node();
                push_nearest_last(s, &frustum, geometry.bvh, n, z_far, stack);
                continue;
            }
            Child::Leaf(l) => &geometry.bvh.leaves[l as usize],
        };
        count.leaf(leaf.used.count_ones());
        let mut alive = prepare::<S, PARALLEL, false>(s, leaf, (group, &near), 0.0, prepared);
        while alive != 0 {
            let slot = alive.trailing_zeros() as usize % 8;
            alive &= alive - 1;
            let mut packets = group.packets;
            if prepared.outlined {
                packets &= near.packets(s, &prepared.outlines, slot);
            }
            let edges_of_slot = prepared.edges_of(s, slot);
            if packets.count_ones() > FEW_PACKETS {
                packets &= edges_of_slot.packets(s, group);
            }
            count.packets(packets.count_ones());
            while packets != 0 {
                let p = packets.trailing_zeros() as usize % 8;
                packets &= packets - 1;
                let edges = edges_of_slot.at(s, s.load(&group.x[p]), s.load(&group.y[p]));
                let inside = s.ge(vector::least(s, edges), s.splat(0.0));
                let mut lanes = s.bits(inside) & group.lanes[p];
                if lanes == 0 {
                    continue;
                }
                count.candidate();
                let back = prepared.back >> slot & 1 == 1;
                lanes &= s.bits(behind_plane(s, leaf, slot, back, vector::load_packet(s, points, p)));
                if lanes != 0 && leaf.masked >> slot & 1 == 1 {
                    count.alpha(lanes.count_ones());
                    lanes = alpha_filter(s, geometry, leaf.triangles[slot], edges, lanes);
                }
                if lanes == 0 {
                    continue;
                }
                *blocker = child;
                group.lanes[p] &= !lanes;
                if group.lanes[p] == 0 {
                    group.packets &= !(1 << p);
                    if group.packets == 0 {
                        return;
                    }
                }
            }
        }
    }
}

/// Pushes the children that the group may hit, the nearest last.
#[inline(always)]
fn push_nearest_last<S: Simd>(
    s: S,
    frustum: &Frustum<S>,
    bvh: &WideBvh,
    node: u32,
    z_far: S::F,
    stack: &mut Vec<(Child, f32)>,
) {
    let node = &bvh.nodes[node as usize];
    let (mut hit, z) = frustum.intersect(s, node, z_far);
    if hit == 0 {
        return;
    }
    let mut near = F8::default();
    s.store(z, &mut near);
    let first = stack.len();
    while hit != 0 {
        let slot = hit.trailing_zeros() as usize % 8;
        hit &= hit - 1;
        let entry = (node.child(slot), near.0[slot]);
        prefetch(s, bvh, entry.0);
        stack.push(entry);
        let mut place = stack.len() - 1;
        while place > first && stack[place - 1].1 < entry.1 {
            stack[place] = stack[place - 1];
            place -= 1;
        }
        stack[place] = entry;
    }
}

/// Asks for what the visit of `child` reads first. Siblings are visited meanwhile.
#[inline(always)]
fn prefetch<S: Simd>(s: S, bvh: &WideBvh, child: Child) {
    match child {
        Child::None => {}
        Child::Node(n) => {
            if let Some(node) = bvh.nodes.get(n as usize) {
                s.prefetch(node);
            }
        }
        Child::Leaf(l) => {
            if let Some(leaf) = bvh.leaves.get(l as usize) {
                s.prefetch(&leaf.corners);
                s.prefetch(&leaf.span);
            }
        }
    }
}

/// The z of the group's farthest point, rounded up.
#[inline(always)]
fn farthest<S: Simd>(s: S, group: &Group, points: &[[F8; PACKETS]; 3]) -> f32 {
    let projection = &group.projection;
    let origin = s.splat(projection.origin[2]);
    let sign = s.splat(projection.w_sign);
    let mut far = s.splat(f32::NEG_INFINITY);
    let mut packets = group.packets;
    while packets != 0 {
        let p = packets.trailing_zeros() as usize % 8;
        packets &= packets - 1;
        let z = (s.load(&points[projection.axes[2]][p]) - origin) * sign;
        far = s.select(s.mask(group.lanes[p]), s.max(far, z), far);
    }
    let far = s.highest(far);
    far + far.abs() * (DEPTH_SLACK - 1.0)
}

/// Returns the points behind the plane of triangle `slot`, seen along the rays, by more than the rounding error
/// ([`PLANE_ROUNDINGS`]).
#[inline(always)]
fn behind_plane<S: Simd>(s: S, leaf: &Leaf, slot: usize, back: bool, point: [S::F; 3]) -> S::M {
    let mut distance = s.splat(0.0);
    let mut terms = s.splat(0.0);
    for (axis, position) in point.into_iter().enumerate() {
        let normal = leaf.normals[axis].0[slot];
        let normal = s.splat(if back { normal } else { -normal });
        let way = position - s.splat(leaf.corners[0][axis].0[slot]);
        distance = s.fma(normal, way, distance);
        terms = s.fma(s.abs(normal), s.abs(way), terms);
    }
    s.gt(distance, terms * s.splat(PLANE_ROUNDINGS * ROUNDING))
}

/// Returns the lanes whose hit of a MASK triangle passes the alpha test.
#[inline(always)]
fn alpha_filter<S: Simd>(s: S, geometry: Geometry<'_>, triangle: u32, edges: [S::F; 3], lanes: u8) -> u8 {
    // Texture coordinates keep their order where corners have changed places.
    let edges = if geometry.is_turned(triangle) { [edges[0], edges[2], edges[1]] } else { edges };
    let mut weights = [F8::default(); 3];
    s.store(edges[0], &mut weights[0]);
    s.store(edges[1], &mut weights[1]);
    s.store(edges[2], &mut weights[2]);
    let mut kept = 0;
    for lane in (0..8).filter(|lane| lanes >> lane & 1 == 1) {
        let passes = geometry.alpha.passes(triangle, weights.each_ref().map(|weight| weight.0[lane]));
        kept |= u8::from(passes) << lane;
    }
    kept
}
