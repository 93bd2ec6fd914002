//! Hierarchies of what moves: refitted in place, and joined under a small top for each frame.
//!
//! A rigid piece's triangles stay together however it moves, so its tree keeps its shape: only boxes and corners
//! change. One that changes its shape keeps its tree, too: neighbours on a surface stay neighbours. Boxes are computed
//! from the moved triangles, which are f32 in the scene's space like all others, so a tree of moved triangles is
//! traversed by the same code, with the same error bounds, as one of resting ones (`shaders/scene/docs/living.md`).

use std::ops::Range;

use glam::Vec3;
use rayon::iter::{
    IndexedParallelIterator as _, IntoParallelIterator as _, IntoParallelRefMutIterator as _, ParallelIterator as _,
};

use super::bvh::{Child, LEAF_BIT, Leaf, NO_CHILD, Node, WIDTH, WideBvh, word};

/// Leaves that a thread takes at once.
const RUN: usize = 256;

/// Lowest and highest corner. Inverted around nothing.
pub type Bounds = [Vec3; 2];

/// Bounds of nothing.
pub(crate) const NOTHING: Bounds = [Vec3::INFINITY, Vec3::NEG_INFINITY];

pub(crate) fn joined(one: Bounds, other: Bounds) -> Bounds {
    [one[0].min(other[0]), one[1].max(other[1])]
}

/// Trees of what moves, side by side, behind room for a small top. Each frame has a copy, in which
/// [`Self::refit`] writes whatever a frame may change: a copy of an earlier frame serves as well.
pub struct Forest {
    trees: Vec<Tree>,
    unmoved: WideBvh,
}

/// Where a tree lies. Its first node is its root.
struct Tree {
    nodes: Range<usize>,
    leaves: Range<usize>,
    depth: usize,
}

impl Forest {
    /// Takes trees. Indices of triangles stay as they are.
    #[must_use]
    pub fn new(trees: Vec<WideBvh>) -> Self {
        // Every node of the top has two children at least, but for a root alone.
        let nodes = vec![Node::EMPTY; trees.len().max(1)];
        let mut all = Self { trees: Vec::new(), unmoved: WideBvh { nodes, leaves: Vec::new(), depth: 1 } };
        for mut tree in trees {
            let WideBvh { nodes, leaves, .. } = &mut all.unmoved;
            let (first_node, first_leaf) = (nodes.len(), leaves.len());
            for node in &mut tree.nodes {
                node.children = std::array::from_fn(|slot| match node.child(slot) {
                    Child::None => NO_CHILD,
                    Child::Node(child) => word(child as usize + first_node),
                    Child::Leaf(child) => word(child as usize + first_leaf) | LEAF_BIT,
                });
            }
            nodes.append(&mut tree.nodes);
            leaves.append(&mut tree.leaves);
            let (nodes, leaves) = (first_node..nodes.len(), first_leaf..leaves.len());
            all.trees.push(Tree { nodes, leaves, depth: tree.depth });
        }
        all
    }

    pub(crate) fn memory_bytes(&self) -> usize {
        self.unmoved.memory_bytes()
    }

    /// Returns a copy for a frame.
    #[must_use]
    pub fn copy(&self) -> WideBvh {
        self.unmoved.clone()
    }

    /// Moves the triangles of the trees that are shown, and joins these, in a copy. `placed` returns a triangle's
    /// corners and its unit normal, or `None` if it has no area: then nothing hits it. Returns the bounds of all, if
    /// there is anything.
    pub fn refit(
        &self,
        copy: &mut WideBvh,
        shown: impl Fn(usize) -> bool,
        placed: impl Fn(u32) -> Option<([Vec3; 3], Vec3)> + Sync,
    ) -> Option<Bounds> {
        let WideBvh { nodes, leaves, depth } = copy;
        let (top_nodes, mut nodes) = nodes.split_at_mut(self.trees.len().max(1));
        let mut leaves = &mut leaves[..];
        let mut tasks = Vec::with_capacity(self.trees.len());
        for (number, tree) in self.trees.iter().enumerate() {
            let of_tree = nodes.split_off_mut(..tree.nodes.len()).zip(leaves.split_off_mut(..tree.leaves.len()));
            tasks.extend(of_tree.filter(|_| shown(number)).map(|of_tree| (number, tree, of_tree)));
        }
        let refitted =
            tasks.into_par_iter().map(|(number, tree, (nodes, leaves))| (number, tree.refit(nodes, leaves, &placed)));
        // What has no area has inverted bounds.
        let refitted: Vec<(usize, Bounds)> =
            refitted.collect::<Vec<_>>().into_iter().filter(|(_, [min, max])| min.cmple(*max).all()).collect();
        let boxes: Vec<Bounds> = refitted.iter().map(|(_, bounds)| *bounds).collect();
        let (mut joined_nodes, levels) = top(&boxes, WIDTH);
        // In the top, leaves stand for whole trees.
        for child in joined_nodes.iter_mut().flat_map(|node| &mut node.children) {
            if *child != NO_CHILD && *child & LEAF_BIT != 0 {
                let (number, _) = refitted[(*child & !LEAF_BIT) as usize];
                *child = word(self.trees[number].nodes.start);
            }
        }
        for (place, node) in top_nodes.iter_mut().zip(joined_nodes) {
            *place = node;
        }
        let deepest = refitted.iter().map(|(number, _)| self.trees[*number].depth).max().unwrap_or(0);
        *depth = levels + deepest;
        boxes.into_iter().reduce(joined)
    }
}

impl Tree {
    fn refit(
        &self,
        nodes: &mut [Node],
        leaves: &mut [Leaf],
        placed: &(impl Fn(u32) -> Option<([Vec3; 3], Vec3)> + Sync),
    ) -> Bounds {
        let leaves: Vec<Bounds> = leaves.par_iter_mut().with_min_len(RUN).map(|leaf| leaf.refit(placed)).collect();
        let mut bounds = vec![NOTHING; nodes.len()];
        // Children come after their parents.
        for (n, node) in nodes.iter_mut().enumerate().rev() {
            for slot in 0..WIDTH {
                let of_child = match node.child(slot) {
                    Child::None => continue,
                    Child::Node(child) => bounds[child as usize - self.nodes.start],
                    Child::Leaf(child) => leaves[child as usize - self.leaves.start],
                };
                node.set_bounds(slot, of_child);
                bounds[n] = joined(bounds[n], of_child);
            }
        }
        bounds.first().copied().unwrap_or(NOTHING)
    }
}

impl Leaf {
    fn refit(&mut self, placed: &impl Fn(u32) -> Option<([Vec3; 3], Vec3)>) -> Bounds {
        let mut bounds = NOTHING;
        let there = self.there;
        self.used = 0;
        for slot in (0..WIDTH).filter(|slot| there >> slot & 1 == 1) {
            let Some((corners, normal)) = placed(self.triangles[slot]) else { continue };
            self.place(slot, corners, normal);
            bounds = corners.into_iter().fold(bounds, |bounds, position| joined(bounds, [position; 2]));
        }
        bounds
    }
}

impl Node {
    fn set_bounds(&mut self, slot: usize, [min, max]: Bounds) {
        for axis in 0..3 {
            self.min[axis].0[slot] = min[axis];
            self.max[axis].0[slot] = max[axis];
        }
    }
}

/// Returns a small tree over boxes, whose leaves are the boxes' indices, and its number of levels. Each node halves its
/// largest part until there are eight, along the longest side of the centres. The root has at most `most_in_root`.
pub(crate) fn top(boxes: &[Bounds], most_in_root: usize) -> (Vec<Node>, usize) {
    let (mut nodes, mut levels) = (vec![Node::EMPTY], 1);
    // Centres, twice as far out, and indices.
    let mut order: Vec<(Vec3, usize)> = boxes.iter().map(|[min, max]| min + max).zip(0..).collect();
    let mut open = vec![(0, 0..boxes.len(), 1)];
    while let Some((place, range, level)) = open.pop() {
        levels = levels.max(level);
        let mut parts = vec![range];
        let most = if place == 0 { most_in_root } else { WIDTH };
        while parts.len() < most {
            let largest = (0..parts.len()).max_by_key(|part| parts[*part].len()).unwrap_or(0);
            let part = parts[largest].clone();
            if part.len() < 2 {
                break;
            }
            let members = &mut order[part.clone()];
            let [min, max] = members.iter().fold(NOTHING, |bounds, (centre, _)| joined(bounds, [*centre; 2]));
            let axis = (max - min).max_position();
            let half = members.len() / 2;
            members.select_nth_unstable_by(half, |(a, _), (b, _)| a[axis].total_cmp(&b[axis]));
            let middle = part.start + half;
            parts[largest] = part.start..middle;
            parts.push(middle..part.end);
        }
        for (slot, part) in parts.into_iter().filter(|part| !part.is_empty()).enumerate() {
            let bounds = order[part.clone()].iter().fold(NOTHING, |bounds, (_, index)| joined(bounds, boxes[*index]));
            nodes[place].set_bounds(slot, bounds);
            nodes[place].children[slot] = if part.len() == 1 {
                word(order[part.start].1) | LEAF_BIT
            } else {
                nodes.push(Node::EMPTY);
                open.push((nodes.len() - 1, part, level + 1));
                word(nodes.len() - 1)
            };
        }
    }
    (nodes, levels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visibility::hierarchy::bvh::TriangleFlags;

    /// A strip of triangles that starts at `at`; every third of them has no area once it has moved.
    fn strip(at: Vec3, count: u32) -> (WideBvh, Vec<[Vec3; 3]>) {
        let along = |i: u32| at + Vec3::new(i as f32, (i * i % 7) as f32, 0.0);
        let corners: Vec<[Vec3; 3]> = (0..count).map(|i| [along(i), along(i) + Vec3::Z, along(i) + Vec3::Y]).collect();
        let positions: Vec<Vec3> = corners.iter().flatten().copied().collect();
        let triangles: Vec<[u32; 3]> = (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        (WideBvh::build(&positions, &triangles, &|_| TriangleFlags::default()), corners)
    }

    #[test]
    fn moved_triangles_lie_in_all_boxes_above_them_and_flat_ones_are_hit_by_nothing() {
        for trees in [0_u32, 1, 2, 8, 9, 70] {
            let moved = |tree: u32, triangle: u32, corners: &[Vec3; 3]| {
                let turn = glam::Quat::from_rotation_x(tree as f32);
                (!triangle.is_multiple_of(3)).then(|| corners.map(|corner| turn * corner * 3.0 - Vec3::Y))
            };
            let strips: Vec<_> = (0..trees).map(|tree| strip(Vec3::splat(10.0 * tree as f32), 40)).collect();
            let of_tree = |(tree, (bvh, _)): (u32, &(WideBvh, Vec<[Vec3; 3]>))| {
                let mut bvh = bvh.clone();
                // Indices tell trees apart.
                bvh.leaves.iter_mut().for_each(|leaf| leaf.triangles = leaf.triangles.map(|t| t + 40 * tree));
                bvh
            };
            let forest = Forest::new((0..).zip(&strips).map(of_tree).collect());
            let mut joined = forest.copy();
            let placed = |triangle: u32| {
                let (tree, triangle) = (triangle / 40, triangle % 40);
                Some((moved(tree, triangle, &strips[tree as usize].1[triangle as usize])?, Vec3::Y))
            };
            // An earlier frame's copy, with fewer trees and elsewhere.
            let elsewhere = |triangle| placed(triangle + 1 - 2 * (triangle % 2));
            forest.refit(&mut joined, |tree| tree % 2 == 0, elsewhere);
            forest.refit(&mut joined, |tree| tree != 1, placed);
            let mut seen = vec![0; 40 * trees as usize];
            let mut open = vec![(Child::Node(0), [Vec3::NEG_INFINITY, Vec3::INFINITY], 0)];
            while let Some((child, [min, max], depth)) = open.pop() {
                assert!(depth <= joined.depth, "{depth} of {}", joined.depth);
                match child {
                    Child::None => {}
                    Child::Node(n) => {
                        let node = &joined.nodes[n as usize];
                        for slot in (0..WIDTH).filter(|slot| node.child(*slot) != Child::None) {
                            let side = |of: &[super::super::bvh::F8; 3]| {
                                Vec3::from_array([0, 1, 2].map(|axis| of[axis].0[slot]))
                            };
                            let (low, high) = (side(&node.min), side(&node.max));
                            assert!(low.cmpge(min).all() && high.cmple(max).all());
                            open.push((node.child(slot), [low, high], depth + 1));
                        }
                    }
                    Child::Leaf(l) => {
                        let leaf = &joined.leaves[l as usize];
                        for slot in (0..WIDTH).filter(|slot| leaf.used >> slot & 1 == 1) {
                            let (tree, triangle) = (leaf.triangles[slot] / 40, leaf.triangles[slot] % 40);
                            seen[leaf.triangles[slot] as usize] += 1;
                            let (_, corners) = strip(Vec3::splat(10.0 * tree as f32), 40);
                            let expected = moved(tree, triangle, &corners[triangle as usize]).unwrap();
                            for (corner, expected) in leaf.corners.iter().zip(expected) {
                                let at = Vec3::from_array([0, 1, 2].map(|axis| corner[axis].0[slot]));
                                assert_eq!(at, expected);
                                assert!(at.cmpge(min).all() && at.cmple(max).all());
                            }
                        }
                    }
                }
            }
            for (triangle, seen) in seen.into_iter().enumerate() {
                let shown = triangle / 40 != 1 && !(triangle % 40).is_multiple_of(3);
                assert_eq!(seen, u32::from(shown), "{triangle}");
            }
        }
    }
}
