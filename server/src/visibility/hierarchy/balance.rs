//! Bounds the depth of a binary hierarchy: rebuilds only subtrees that are too deep, from equal halves.
//!
//! The surface-area heuristic turns a chain of triangles at growing distances into a chain of nodes. The kernels' stack
//! has a fixed size, and parts of obvhs recurse, so every hierarchy must fit by construction.

use obvhs::bvh2::{Bvh2, node::Bvh2Node};

/// Rebuilds as little of `binary` as possible, so that no path from the root has more than `levels` inner nodes. Each
/// leaf holds one primitive. Raises `levels` to the least depth for the number of leaves.
pub(crate) fn bound_depth(binary: &mut Bvh2, levels: u32) {
    if binary.nodes.is_empty() {
        return;
    }
    let subtrees = measure(&binary.nodes);
    let levels = levels.max(halvings(subtrees[0].leaves));
    let mut open = vec![(0, 0)];
    while let Some((n, depth)) = open.pop() {
        if depth + subtrees[n].height <= levels {
            continue;
        }
        // Each child has fewer leaves, so it can still be balanced one level down.
        if depth + 1 + halvings(subtrees[n].leaves - 1) <= levels {
            let first = binary.nodes[n].first_index as usize;
            open.extend([(first, depth + 1), (first + 1, depth + 1)]);
        } else {
            balance(&mut binary.nodes, n);
        }
    }
    // The builder's data describe the old tree.
    binary.parents.clear();
    binary.primitives_to_nodes.clear();
    binary.children_are_ordered_after_parents = false;
}

#[derive(Debug, Clone, Copy)]
struct Subtree {
    leaves: usize,
    /// Inner nodes on the longest path to a leaf.
    height: u32,
}

/// Inner nodes on the longest path from the root to a leaf.
pub(crate) fn height(nodes: &[Bvh2Node]) -> u32 {
    measure(nodes).first().map_or(0, |root| root.height)
}

fn measure(nodes: &[Bvh2Node]) -> Vec<Subtree> {
    let mut order = Vec::with_capacity(nodes.len());
    let mut open = vec![0];
    while let Some(n) = open.pop() {
        order.push(n);
        if !nodes[n].is_leaf() {
            let first = nodes[n].first_index as usize;
            open.extend([first, first + 1]);
        }
    }
    let mut subtrees = vec![Subtree { leaves: 1, height: 0 }; nodes.len()];
    for &n in order.iter().rev().filter(|&&n| !nodes[n].is_leaf()) {
        let first = nodes[n].first_index as usize;
        let [left, right] = [subtrees[first], subtrees[first + 1]];
        subtrees[n] = Subtree { leaves: left.leaves + right.leaves, height: 1 + left.height.max(right.height) };
    }
    subtrees
}

/// Number of halvings until each leaf is alone.
fn halvings(leaves: usize) -> u32 {
    leaves.max(1).next_power_of_two().trailing_zeros()
}

/// Replaces the subtree at `root` by a balanced tree over its leaves, in place.
fn balance(nodes: &mut [Bvh2Node], root: usize) {
    let (mut leaves, mut pairs) = (Vec::new(), Vec::new());
    let mut open = vec![root];
    while let Some(n) = open.pop() {
        if nodes[n].is_leaf() {
            leaves.push(nodes[n]);
        } else {
            pairs.push(nodes[n].first_index);
            let first = nodes[n].first_index as usize;
            open.extend([first, first + 1]);
        }
    }
    let mut open = vec![(root, 0..leaves.len())];
    while let Some((n, range)) = open.pop() {
        let part = &mut leaves[range.clone()];
        let Some((first, others)) = part.split_first() else { continue };
        let Some(pair) = (if others.is_empty() { None } else { pairs.pop() }) else {
            nodes[n] = *first;
            continue;
        };
        let bounds = others.iter().fold(*first.aabb(), |bounds, leaf| bounds.union(leaf.aabb()));
        let middle = part.len() / 2;
        let axis = bounds.largest_axis();
        part.select_nth_unstable_by(middle, |a, b| a.aabb().center()[axis].total_cmp(&b.aabb().center()[axis]));
        nodes[n] = Bvh2Node::new(bounds, 0, pair);
        let pair = pair as usize;
        open.extend([(pair, range.start..range.start + middle), (pair + 1, range.start + middle..range.end)]);
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3A;
    use obvhs::{BvhBuildParams, aabb::Aabb, bvh2::builder::build_bvh2_from_tris, triangle::Triangle};

    use super::*;

    /// Triangles at these distances along a diagonal.
    fn chain(places: impl Iterator<Item = f32>) -> Vec<Triangle> {
        places
            .map(|at| {
                let v0 = Vec3A::new(1.0, 0.4, -0.7) * at;
                Triangle { v0, v1: v0 + Vec3A::X * at * 0.1, v2: v0 + Vec3A::Y * at * 0.1 }
            })
            .collect()
    }

    fn built(shapes: &[Triangle]) -> Bvh2 {
        let parameters = BvhBuildParams { pre_split: false, max_prims_per_leaf: 1, ..BvhBuildParams::medium_build() };
        build_bvh2_from_tris(shapes, parameters, &mut std::time::Duration::default())
    }

    /// The sorted primitives of all leaves. Checks that each box holds its children.
    fn primitives(binary: &Bvh2) -> Vec<u32> {
        let mut found = Vec::new();
        let mut open = vec![(0, Aabb::new(Vec3A::splat(f32::MIN), Vec3A::splat(f32::MAX)))];
        while let Some((n, around)) = open.pop() {
            let node = &binary.nodes[n];
            let own = *node.aabb();
            assert!(own.min.cmpge(around.min).all() && own.max.cmple(around.max).all());
            let first = node.first_index as usize;
            if node.is_leaf() {
                found.push(binary.primitive_indices[first]);
            } else {
                open.extend([(first, own), (first + 1, own)]);
            }
        }
        found.sort_unstable();
        found
    }

    #[test]
    fn a_deep_chain_becomes_shallow_and_loses_no_leaf() {
        let shapes = chain((0..120).map(|i| 2.0_f32.powi(i - 60)));
        for levels in [32, 12, 7, 3] {
            let mut binary = built(&shapes);
            assert!(height(&binary.nodes) > 32, "the chain is not deep");
            bound_depth(&mut binary, levels);
            // 120 leaves need 7 levels.
            assert!(height(&binary.nodes) <= levels.max(7));
            assert_eq!(primitives(&binary), (0..120).collect::<Vec<_>>());
        }
    }

    #[test]
    fn shallow_parts_are_not_changed() {
        let mut shapes = chain((0..4000_u16).map(|i| 1.0 + f32::from(i)));
        let chain = chain((0..100).map(|i| 1e-3 * 2.0_f32.powi(i - 90)));
        shapes.extend(&chain);
        let mut binary = built(&shapes);
        let before = binary.nodes.clone();
        bound_depth(&mut binary, 32);
        let changed = |(a, b): &(&Bvh2Node, &Bvh2Node)| bytemuck::bytes_of(*a) != bytemuck::bytes_of(*b);
        let changed = before.iter().zip(&binary.nodes).filter(changed).count();
        assert!((1..=2 * chain.len()).contains(&changed), "{changed} nodes changed");
        assert_eq!(primitives(&binary).len(), shapes.len());
        assert!(height(&binary.nodes) <= 32);
    }
}
