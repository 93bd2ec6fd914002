//! Binary hierarchies with a bounded build time for any scene. The back ends convert them to wide ones.
//!
//! They are built bottom up: boxes are sorted along a space-filling curve, and in each round mutual nearest neighbours
//! merge (Meister and Bittner, "Parallel Locally-Ordered Clustering for Bounding Volume Hierarchy Construction", 2018).
//! obvhs' reinsertion follows. obvhs has this clustering, too, but its time grows with the square of the number of
//! boxes whose distances tie. A row of equal triangles, many copies of one, or shells around one centre have one pair
//! of mutual nearest boxes per round, and a million of them would take hours. Here a hash breaks ties, and a round that
//! finds few pairs merges neighbours on the curve.

use obvhs::{
    aabb::Aabb,
    bvh2::{Bvh2, node::Bvh2Node, reinsertion::ReinsertionOptimizer},
};
use rayon::prelude::*;

use super::balance::{bound_depth, height};

/// A round that would merge fewer than one pair in this many boxes pairs neighbours on the curve instead.
const STALLED: usize = 8;

/// Most inner nodes on a path from the root to a leaf.
const MOST_LEVELS: u32 = 96;

/// How far along the curve to search the nearest box, to either side. This and [`REINSERTION`] are obvhs' values for a
/// slow build, since a scene is built once and traced for days. On Sponza a group of camera rays visits 21.4 nodes and
/// 22.9 leaves; with half the reach and a quarter of the share it visits 23.3 and 27.3.
const REACH: usize = 24;
/// Share of nodes that the first reinsertion pass moves to better places.
const REINSERTION: f32 = 0.2;

/// Builds a hierarchy with a leaf for each of fewer than 2³¹ boxes. Runs on the current rayon pool.
pub(crate) fn build(boxes: &[Aabb]) -> Bvh2 {
    let mut tree = Bvh2 { primitive_indices: (0..).take(boxes.len()).collect(), ..Bvh2::default() };
    if boxes.is_empty() {
        return tree;
    }
    let mut clusters = along_curve(boxes);
    tree.nodes = vec![Bvh2Node::default(); 2 * boxes.len() - 1];
    // Siblings are allocated from the end, so that the top of the tree comes first, as reinsertion expects.
    let mut free = tree.nodes.len();
    while clusters.len() > 1 {
        let nearest = nearest(&clusters);
        let mutual = |i: usize| nearest[nearest[i]] == i;
        let pairs = (0..clusters.len()).filter(|&i| mutual(i)).count() / 2;
        let partner = |i: usize| {
            if pairs * STALLED >= clusters.len() {
                mutual(i).then(|| nearest[i])
            } else {
                Some(i ^ 1).filter(|&other| other < clusters.len())
            }
        };
        let mut merged = Vec::with_capacity(clusters.len());
        for (i, cluster) in clusters.iter().enumerate() {
            match partner(i) {
                None => merged.push(*cluster),
                Some(other) if other > i => {
                    free -= 2;
                    tree.nodes[free] = *cluster;
                    tree.nodes[free + 1] = clusters[other];
                    merged.push(Bvh2Node::new(cluster.aabb().union(clusters[other].aabb()), 0, place(free)));
                }
                // Already merged by its partner.
                Some(_) => {}
            }
        }
        clusters = merged;
    }
    tree.nodes[0] = clusters[0];
    let mut optimizer = ReinsertionOptimizer::default();
    // The passes of obvhs' own loop, which overflows its stack if one pass makes the tree deeper than the next expects.
    for pass in (1_u8..32).step_by(2) {
        tree.max_depth = tree.max_depth.max(height(&tree.nodes) as usize + 1);
        optimizer.run(&mut tree, REINSERTION, Some(vec![1.0 / f32::from(pass)]));
    }
    bound_depth(&mut tree, MOST_LEVELS);
    tree
}

/// Leaves, sorted by their centres along a Z-curve.
fn along_curve(boxes: &[Aabb]) -> Vec<Bvh2Node> {
    let centres = boxes.iter().fold(Aabb::empty(), |mut all, bounds| *all.extend(bounds.center()));
    // Cells are cubes: 2²¹ along the longest side.
    let cells_per_m = 2_097_151.0 / centres.diagonal().max_element().max(f32::MIN_POSITIVE);
    let mut leaves: Vec<_> = (0..)
        .zip(boxes)
        .map(|(index, bounds)| {
            let cell = (bounds.center() - centres.min) * cells_per_m;
            let code = spread(cell.x) | spread(cell.y) << 1 | spread(cell.z) << 2;
            (code, Bvh2Node::new(*bounds, 1, index))
        })
        .collect();
    leaves.par_sort_by_key(|&(code, _)| code);
    leaves.into_iter().map(|(_, leaf)| leaf).collect()
}

/// Spreads a cell's 21 bits to every third of 63.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "what is out of range is clamped")]
fn spread(cell: f32) -> u64 {
    let mut bits = u64::from((cell as u32).min(0x1f_ffff));
    bits = (bits | bits << 32) & 0x001f_0000_0000_ffff;
    bits = (bits | bits << 16) & 0x001f_0000_ff00_00ff;
    bits = (bits | bits << 8) & 0x100f_00f0_0f00_f00f;
    bits = (bits | bits << 4) & 0x10c3_0c30_c30c_30c3;
    (bits | bits << 2) & 0x1249_2492_4924_9249
}

/// Returns for each of at least two clusters the one within reach whose union with it is smallest.
fn nearest(clusters: &[Bvh2Node]) -> Vec<usize> {
    let among = |i: usize| {
        let own = clusters[i].aabb();
        let (mut best, mut best_cost) = (i ^ 1, (f32::INFINITY, 0));
        let begin = i.saturating_sub(REACH);
        let within_reach = &clusters[begin..(i + REACH + 1).min(clusters.len())];
        for (other, candidate) in (begin..).zip(within_reach) {
            // Ties must look the same from both ends, and must not all favour the same side.
            let cost = (own.union(candidate.aabb()).half_area(), tie_break(i.min(other), i.max(other)));
            if other != i && cost < best_cost {
                (best, best_cost) = (other, cost);
            }
        }
        best.min(clusters.len() - 1)
    };
    (0..clusters.len()).into_par_iter().with_min_len(1024).map(among).collect()
}

/// A pseudo-random number for a pair of places.
fn tie_break(low: usize, high: usize) -> u64 {
    let mixed = (low as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (high as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
    (mixed ^ mixed >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9)
}

#[expect(clippy::cast_possible_truncation, reason = "there are fewer nodes than 2^32")]
fn place(node: usize) -> u32 {
    node as u32
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use glam::Vec3A;

    use super::*;

    fn cube(centre: Vec3A, side: f32) -> Aabb {
        Aabb::new(centre - side * 0.5, centre + side * 0.5)
    }

    /// Checks that every box is in one leaf, inside all boxes above it.
    fn check(tree: &Bvh2, boxes: &[Aabb]) {
        let mut seen = vec![false; boxes.len()];
        let mut open = vec![0];
        while let Some(n) = open.pop() {
            let node = &tree.nodes[n];
            let first = node.first_index as usize;
            if node.is_leaf() {
                let index = tree.primitive_indices[first] as usize;
                assert!(!std::mem::replace(&mut seen[index], true) && *node.aabb() == boxes[index]);
                continue;
            }
            let children = tree.nodes[first].aabb().union(tree.nodes[first + 1].aabb());
            assert!(*node.aabb() == children);
            open.extend([first, first + 1]);
        }
        assert!(seen.iter().all(|&seen| seen));
    }

    /// Sum of the areas of all inner boxes, relative to the root's.
    fn cost_of(tree: &Bvh2) -> f32 {
        let inner = tree.nodes.iter().filter(|node| !node.is_leaf()).map(|node| node.aabb().half_area());
        inner.sum::<f32>() / tree.nodes[0].aabb().half_area()
    }

    #[test]
    fn heaps_rows_and_shells_build_in_normal_time() {
        let count = 20_000_u16;
        let at = |i: u16| f32::from(i);
        for (name, make) in [
            ("one place", &(|_| cube(Vec3A::ONE, 0.1)) as &dyn Fn(u16) -> Aabb),
            ("a diagonal row", &|i| cube(Vec3A::splat(at(i)), 0.2)),
            ("shells", &|i| cube(Vec3A::ONE, 1e-3 * (1.0 + at(i)))),
            ("one line", &|i| Aabb::new(Vec3A::X * at(i), Vec3A::X * (at(i) + 0.5))),
            ("a chain", &|i| cube(Vec3A::splat(2.0_f32.powi(i32::from(i % 120) - 60)), 1e-20)),
        ] {
            let boxes: Vec<_> = (0..count).map(make).collect();
            let tree = build(&boxes);
            check(&tree, &boxes);
            let deepest = height(&tree.nodes);
            assert!(deepest <= MOST_LEVELS, "{name}: {deepest} levels");
        }
        for few in 0..5 {
            let boxes: Vec<_> = (0..few).map(|i| cube(Vec3A::splat(at(i)), 0.2)).collect();
            let tree = build(&boxes);
            if few > 0 {
                check(&tree, &boxes);
            }
            assert_eq!(tree.nodes.len(), usize::from(few * 2).saturating_sub(1));
        }
    }

    #[test]
    fn trees_are_as_good_as_those_of_the_builder_that_they_replace() {
        let mut state = 1_u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 16_777_216.0
        };
        let boxes: Vec<_> =
            (0..20_000).map(|_| cube(Vec3A::new(next(), next() * next(), next()) * 50.0, next() * next())).collect();
        let theirs = obvhs::bvh2::builder::build_bvh2(
            &boxes,
            obvhs::BvhBuildParams { pre_split: false, max_prims_per_leaf: 1, ..obvhs::BvhBuildParams::slow_build() },
            &mut Duration::default(),
        );
        let ours = build(&boxes);
        check(&ours, &boxes);
        let (ours, theirs) = (cost_of(&ours), cost_of(&theirs));
        assert!(ours <= theirs * 1.02, "{ours}, and obvhs' {theirs}");
    }
}
