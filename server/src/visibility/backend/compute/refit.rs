//! Compressed nodes of what moves: refitted to moved triangles, and joined with what rests under a small top.
//!
//! A node's children keep their places, and so their order, however a piece turns. Only their boxes change: they are
//! those of the moved triangles, rounded outwards to the node's grid as obvhs does.

use glam::{DVec3, Vec3};
use gnomon_shaders::host::TracedTriangle;
use obvhs::cwbvh::node::CwBvhNode;

use crate::visibility::hierarchy::{
    bvh::{Child, WIDTH},
    moving::{Bounds, NOTHING, joined, top},
};

/// Steps of a node's grid.
const STEPS: f64 = 255.0;
/// Least extent of a node along an axis, in metres: obvhs' own.
const LEAST_EXTENT_M: f64 = 1e-20;
/// What a slot that holds a node says of it, besides its own number.
const INNER: u8 = 0b0011_1000;

/// A tree's first node, and the bounds of its triangles.
#[derive(Debug, Clone, Copy)]
pub(super) struct Root {
    pub(super) node: CwBvhNode,
    pub(super) bounds: Bounds,
}

/// Moved triangles, each with its normals, of which the last is zero for one without an area.
pub(super) struct Moved<'a> {
    pub(super) triangles: &'a [TracedTriangle],
    pub(super) normals: &'a [[Vec3; 4]],
}

impl Moved<'_> {
    /// Bounds of `count` triangles. Nothing hits those without an area.
    fn bounds(&self, first: u32, count: u32) -> Bounds {
        let range = first as usize..(first + count) as usize;
        let all =
            self.triangles.get(range.clone()).into_iter().flatten().zip(self.normals.get(range).into_iter().flatten());
        all.filter(|(_, normals)| normals[3] != Vec3::ZERO).fold(NOTHING, |bounds, (triangle, _)| {
            let [a, b, c] = [triangle.a, triangle.b, triangle.c].map(Vec3::from_array);
            joined(bounds, [a.min(b).min(c), a.max(b).max(c)])
        })
    }
}

/// Writes the nodes of `tree` around its moved triangles. The tree's indices count from 0, those of `nodes` from these
/// first ones on. `bounds` has room for one a node.
pub(super) fn refit(
    tree: &[CwBvhNode],
    moved: &Moved<'_>,
    (first_node, first_triangle): (u32, u32),
    nodes: &mut [CwBvhNode],
    bounds: &mut [Bounds],
) -> Root {
    // Children come after their parents.
    for (n, (node, of)) in nodes.iter_mut().zip(tree).enumerate().rev() {
        *node = *of;
        node.child_base_idx = of.child_base_idx + first_node;
        node.primitive_base_idx = of.primitive_base_idx + first_triangle;
        bounds[n] = set_boxes(
            node,
            std::array::from_fn(|slot| {
                if of.is_child_empty(slot) {
                    NOTHING
                } else if of.is_leaf(slot) {
                    let (first, count) = of.child_primitives(slot);
                    moved.bounds(first, count)
                } else {
                    bounds[of.child_node_index(slot) as usize]
                }
            }),
        );
    }
    Root { node: nodes.first().copied().unwrap_or_default(), bounds: bounds.first().copied().unwrap_or(NOTHING) }
}

/// Sets the grid of a node and the boxes of its children, inverted where there is nothing. Returns the bounds of all.
/// A node with nothing keeps the boxes that it had: its parent's box of it is inverted, so no ray visits it, and a
/// block of rays that does finds triangles without an area.
fn set_boxes(node: &mut CwBvhNode, boxes: [Bounds; WIDTH]) -> Bounds {
    let all = boxes.into_iter().reduce(joined).unwrap_or(NOTHING);
    let [min, max] = all;
    if !min.cmple(max).all() {
        return all;
    }
    node.p = min;
    let corner = min.as_dvec3();
    let exponents = (max.as_dvec3() - corner).to_array().map(exponent);
    node.e = exponents.map(|(biased, _)| biased);
    // Of powers of two: products are exact.
    let per_m = DVec3::from_array(exponents.map(|(_, spacing)| spacing.recip()));
    for (slot, [low, high]) in boxes.into_iter().enumerate() {
        let (low, high) = if low.cmple(high).all() {
            let [low, high] = [low, high].map(|corner_of_box| ((corner_of_box.as_dvec3() - corner) * per_m).to_array());
            (low.map(rounded_down), high.map(rounded_up))
        } else {
            ([u8::MAX; 3], [0; 3])
        };
        [node.child_min_x[slot], node.child_min_y[slot], node.child_min_z[slot]] = low;
        [node.child_max_x[slot], node.child_max_y[slot], node.child_max_z[slot]] = high;
    }
    all
}

/// A place from 0 on, to a whole step.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "stops at 0 and 255")]
fn rounded_down(place: f64) -> u8 {
    place as u8
}

fn rounded_up(place: f64) -> u8 {
    let below = rounded_down(place);
    below.saturating_add(u8::from(f64::from(below) < place))
}

/// The least power of two of which [`STEPS`] cover an extent: as the exponent of an f32, and itself.
fn exponent(extent_m: f64) -> (u8, f64) {
    let bits = (extent_m.max(LEAST_EXTENT_M) / STEPS).to_bits();
    let fraction = bits & ((1 << 52) - 1);
    // An extent between f32 has an exponent that an f32 has too: the largest is 2^128 / 255.
    let power = i64::try_from(bits >> 52).unwrap_or_default() - 1023 + i64::from(fraction > 0);
    let biased = u8::try_from(power + 127).unwrap_or(u8::MAX - 1);
    (biased, 2.0_f64.powi(i32::from(biased) - 127))
}

/// Most nodes that [`join`] writes for so many trees that move.
pub(super) fn most_joined(trees: usize) -> usize {
    // Every node of the top has two children at least; all roots are there again.
    2 * trees + 2
}

/// Most levels that [`join`] puts above so many trees that move: a node has a quarter of its parent's trees at most.
pub(super) fn most_levels(mut trees: usize) -> u32 {
    let mut levels = 1;
    while trees > 4 {
        trees = trees.div_ceil(4);
        levels += 1;
    }
    levels
}

/// Joins trees under a new root, that of what rests right below it. Writes the top and the trees' first nodes, which
/// are numbered from `first_node` on; the first is the root. Returns where it wrote the first node of each of `moving`.
pub(super) fn join(resting: Option<&Root>, moving: &[Root], first_node: u32, nodes: &mut [CwBvhNode]) -> Vec<usize> {
    let mut places = vec![0; moving.len()];
    let boxes: Vec<Bounds> = moving.iter().map(|root| root.bounds).collect();
    let (tree, _) = top(&boxes, WIDTH - usize::from(resting.is_some()));
    let mut end = 1;
    // Nodes of the top, and their places in `nodes`.
    let mut open = vec![(0, 0)];
    while let Some((n, place)) = open.pop() {
        let of = &tree[n];
        let mut children: Vec<(Bounds, Under<'_>)> = (0..WIDTH)
            .filter_map(|slot| {
                let side = |planes: &[_; 3]| Vec3::from_array(std::array::from_fn(|axis| plane(&planes[axis], slot)));
                let under = match of.child(slot) {
                    Child::None => return None,
                    Child::Node(below) => Under::Top(below as usize),
                    Child::Leaf(tree) => Under::Tree(tree as usize),
                };
                Some(([side(&of.min), side(&of.max)], under))
            })
            .collect();
        if n == 0 {
            children.extend(resting.map(|root| (root.bounds, Under::Resting(root))));
        }
        let mut node = CwBvhNode { child_base_idx: first_node + index(end), ..CwBvhNode::default() };
        let mut boxes = [NOTHING; WIDTH];
        for (slot, child) in in_slots(children).into_iter().enumerate() {
            let Some((bounds, under)) = child else { continue };
            boxes[slot] = bounds;
            node.imask |= 1 << slot;
            node.child_meta[slot] = INNER | u8::try_from(slot).unwrap_or_default();
            match under {
                Under::Top(below) => open.push((below, end)),
                Under::Resting(root) => nodes[end] = root.node,
                Under::Tree(tree) => (nodes[end], places[tree]) = (moving[tree].node, end),
            }
            end += 1;
        }
        set_boxes(&mut node, boxes);
        nodes[place] = node;
    }
    places
}

/// What lies under a slot of the top.
#[derive(Clone, Copy)]
enum Under<'a> {
    Top(usize),
    /// What rests.
    Resting(&'a Root),
    /// One of what moves.
    Tree(usize),
}

fn plane(planes: &crate::visibility::hierarchy::bvh::F8, slot: usize) -> f32 {
    planes.0[slot]
}

/// Nodes are fewer than 2³².
fn index(place: usize) -> u32 {
    u32::try_from(place).unwrap_or(u32::MAX)
}

/// Puts children in slots, so that rays of each octant meet nearer ones first: the child and slot that suit each other
/// best, again and again.
fn in_slots<T: Copy>(children: Vec<(Bounds, T)>) -> [Option<(Bounds, T)>; WIDTH] {
    let centre = |bounds: Bounds| bounds[0] + bounds[1];
    let middle = children.iter().map(|(bounds, _)| centre(*bounds)).sum::<Vec3>() / children.len().max(1) as f32;
    let way = |slot: usize| Vec3::from_array([4, 2, 1].map(|bit| if slot & bit == 0 { 1.0 } else { -1.0 }));
    let ways: [Vec3; WIDTH] = std::array::from_fn(way);
    let mut slots = [None; WIDTH];
    let mut left: Vec<_> =
        (children.into_iter()).map(|child| (child, ways.map(|way| way.dot(centre(child.0) - middle)))).collect();
    while !left.is_empty() {
        let mut best = (f32::INFINITY, 0, 0);
        for (child, (_, costs)) in left.iter().enumerate() {
            for slot in (0..WIDTH).filter(|slot| slots[*slot].is_none()) {
                if costs[slot] < best.0 || best.0 == f32::INFINITY {
                    best = (costs[slot], child, slot);
                }
            }
        }
        slots[best.2] = Some(left.swap_remove(best.1).0);
    }
    slots
}

#[cfg(test)]
mod tests {
    use glam::Quat;
    use obvhs::triangle::Triangle;

    use super::*;
    use crate::visibility::backend::compute::geometry::{build_hierarchy, plane_normal};

    fn box_of(node: &CwBvhNode, slot: usize) -> [DVec3; 2] {
        let spacing = DVec3::from_array(node.e.map(|e| f64::from(f32::from_bits(u32::from(e) << 23))));
        let place = |x: [u8; 8], y: [u8; 8], z: [u8; 8]| {
            node.p.as_dvec3() + spacing * DVec3::from_array([x[slot], y[slot], z[slot]].map(f64::from))
        };
        [
            place(node.child_min_x, node.child_min_y, node.child_min_z),
            place(node.child_max_x, node.child_max_y, node.child_max_z),
        ]
    }

    #[test]
    fn every_moved_triangle_lies_in_all_boxes_above_it() {
        let mut state = 7_u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        let mut point = |size: f32| Vec3::new(next(), next(), next()) * size;
        for trees in [1_usize, 2, 7, 8, 9, 60] {
            for with_resting in [false, true] {
                let per_tree = 50;
                let mut all = Vec::new();
                let (mut nodes, mut roots) = (vec![CwBvhNode::default(); most_joined(trees)], Vec::new());
                for tree in 0..=trees {
                    let centre = point(100.0);
                    let shapes: Vec<[Vec3; 3]> =
                        (0..per_tree).map(|_| std::array::from_fn(|_| centre + point(2.0))).collect();
                    let as_triangle =
                        |[v0, v1, v2]: [Vec3; 3]| Triangle { v0: v0.into(), v1: v1.into(), v2: v2.into() };
                    let hierarchy = build_hierarchy(&shapes.iter().copied().map(as_triangle).collect::<Vec<_>>(), 20);
                    let turn = Quat::from_rotation_x(tree as f32);
                    let moved: Vec<TracedTriangle> = (hierarchy.primitive_indices.iter())
                        .map(|at| {
                            let [a, b, c] = shapes[*at as usize].map(|corner| turn * corner * 1.7 - Vec3::Y);
                            // Every ninth has no area any more.
                            let c = if at % 9 == 0 { b } else { c };
                            let [a, b, c] = [a, b, c].map(|corner| corner.to_array());
                            TracedTriangle { a, kind: 0, b, first_uv: 0, c, unused: 0 }
                        })
                        .collect();
                    let normals: Vec<[Vec3; 4]> = (moved.iter())
                        .map(|t| [Vec3::X, Vec3::X, Vec3::X, plane_normal([t.a, t.b, t.c].map(Vec3::from_array))])
                        .collect();
                    let of = Moved { triangles: &moved, normals: &normals };
                    let mut own = vec![CwBvhNode::default(); hierarchy.nodes.len()];
                    let mut bounds = vec![NOTHING; own.len()];
                    let firsts = (index(nodes.len()), index(all.len()));
                    roots.push(refit(&hierarchy.nodes, &of, firsts, &mut own, &mut bounds));
                    nodes.append(&mut own);
                    all.extend(moved.into_iter().zip(normals));
                }
                let resting = roots.pop().filter(|_| with_resting);
                let shown = per_tree * (trees + usize::from(with_resting));
                // The nodes of the device count from elsewhere: here, from 0.
                let places = join(resting.as_ref(), &roots, 0, &mut nodes);
                assert!(places.iter().all(|place| *place < most_joined(trees)));
                assert!(places.iter().zip(&roots).all(|(place, root)| nodes[*place] == root.node));
                let mut seen = vec![0; all.len()];
                let whole = [DVec3::NEG_INFINITY, DVec3::INFINITY];
                let (mut open, mut deepest) = (vec![(0, whole, 1)], 0);
                while let Some((n, [min, max], level)) = open.pop() {
                    deepest = deepest.max(level);
                    let node: &CwBvhNode = &nodes[n];
                    for slot in (0..WIDTH).filter(|slot| !node.is_child_empty(*slot)) {
                        let own = box_of(node, slot);
                        let [low, high] = [own[0].max(min), own[1].min(max)];
                        if !node.is_leaf(slot) {
                            open.push((node.child_node_index(slot) as usize, [low, high], level + 1));
                            continue;
                        }
                        let (first, count) = node.child_primitives(slot);
                        for triangle in first..first + count {
                            let (t, normals) = &all[triangle as usize];
                            seen[triangle as usize] += 1;
                            let corners = [t.a, t.b, t.c].map(|corner| Vec3::from_array(corner).as_dvec3());
                            let inside = corners.iter().all(|at| at.cmpge(low).all() && at.cmple(high).all());
                            assert!(inside || normals[3] == Vec3::ZERO, "{corners:?} in {low} to {high}");
                        }
                    }
                }
                assert!(deepest <= most_levels(trees) + 20, "{deepest} levels");
                assert!(seen[..shown].iter().all(|seen| *seen == 1) && seen[shown..].iter().all(|seen| *seen == 0));
            }
        }
    }

    #[test]
    fn a_grid_covers_its_extent_and_no_coarser_one_would_do() {
        for extent in [0.0, 1e-30, 1e-9, 0.1, 1.0, 254.999, 255.0, 255.001, 2e9, f64::from(f32::MAX)] {
            let (biased, spacing) = exponent(extent);
            assert!(spacing * STEPS >= extent, "{extent}");
            assert!(spacing * STEPS <= 2.0 * extent.max(LEAST_EXTENT_M) * (1.0 + 1e-9), "{extent}");
            assert_eq!(f64::from(f32::from_bits(u32::from(biased) << 23)).to_bits(), spacing.to_bits());
        }
    }
}
