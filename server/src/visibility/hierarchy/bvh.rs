//! A BVH with eight children per node and up to eight triangles per leaf, for code that tests eight boxes at once.
//!
//! A binary tree (`binary`) is collapsed into the cheapest eight-wide one by dynamic programming (Ylitie, Karras and
//! Laine, "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", HPG 2017, §3.1). Boxes stay f32,
//! so they are never rounded inwards.

use glam::Vec3;
use gnomon_scene::triangle_normal;
use obvhs::{aabb::Aabb, bvh2::Bvh2};

use super::binary;

/// Children of a node, and the most triangles in a leaf.
pub const WIDTH: usize = 8;

/// Eight f32, aligned for one vector load.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(C, align(32))]
pub struct F8(pub [f32; WIDTH]);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Child {
    None,
    Node(u32),
    Leaf(u32),
}

/// Set in the word of a child that is a leaf.
pub(super) const LEAF_BIT: u32 = 1 << 31;
/// The word of a missing child.
pub(super) const NO_CHILD: u32 = u32::MAX;

/// A node: its children's boxes side by side. A missing child's box is inverted (+∞ to −∞), so rays never hit it.
#[derive(Debug, Clone)]
#[repr(C, align(64))]
pub struct Node {
    /// Lowest corners, by axis.
    pub min: [F8; 3],
    /// Highest corners, by axis.
    pub max: [F8; 3],
    pub(super) children: [u32; WIDTH],
}

impl Node {
    pub(super) const EMPTY: Self = Self {
        min: [F8([f32::INFINITY; WIDTH]); 3],
        max: [F8([f32::NEG_INFINITY; WIDTH]); 3],
        children: [NO_CHILD; WIDTH],
    };

    /// The child in slot `slot`, which must be below [`WIDTH`].
    #[inline(always)]
    #[must_use]
    pub fn child(&self, slot: usize) -> Child {
        match self.children[slot] {
            NO_CHILD => Child::None,
            word if word & LEAF_BIT != 0 => Child::Leaf(word & !LEAF_BIT),
            word => Child::Node(word),
        }
    }
}

/// How a triangle's material treats rays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TriangleFlags {
    /// Camera rays pass through its back.
    pub single_sided: bool,
    /// Hits must pass the alpha test.
    pub masked: bool,
}

/// Up to eight triangles, side by side.
#[derive(Debug, Clone)]
#[repr(C, align(64))]
pub struct Leaf {
    /// Corner positions: `corners[corner][axis]`. Unused slots are zero.
    pub corners: [[F8; 3]; 3],
    /// Index of each triangle in the list that the tree was built from.
    pub triangles: [u32; WIDTH],
    /// Product of two sides' sizes (sums of absolute coordinates), in square metres. One rounding moves the product of
    /// the normal and a distance by this times the distance.
    pub span: F8,
    /// Bit i: slot i is used.
    pub used: u8,
    /// Bit i: slot i has a triangle, which has no area now unless the slot is used.
    pub(super) there: u8,
    /// Bit i: triangle i is single-sided.
    pub single_sided: u8,
    /// Bit i: triangle i is masked.
    pub masked: u8,
    /// Unit normals of the triangles' planes by axis, from f64. Read last, only where a ray is inside the edges.
    pub normals: [F8; 3],
}

impl Leaf {
    pub(crate) const EMPTY: Self = Self {
        corners: [[F8([0.0; WIDTH]); 3]; 3],
        triangles: [0; WIDTH],
        span: F8([0.0; WIDTH]),
        used: 0,
        there: 0,
        single_sided: 0,
        masked: 0,
        normals: [F8([0.0; WIDTH]); 3],
    };

    /// Puts a triangle with this normal into a slot.
    pub(crate) fn place(&mut self, slot: usize, corners: [Vec3; 3], normal: Vec3) {
        let vectors = self.corners.iter_mut().chain([&mut self.normals]).zip(corners.into_iter().chain([normal]));
        for (places, vector) in vectors {
            for (place, coordinate) in places.iter_mut().zip(vector.to_array()) {
                place.0[slot] = coordinate;
            }
        }
        let [a, b, c] = corners;
        self.span.0[slot] = (b - a).abs().element_sum() * (c - a).abs().element_sum();
        self.used |= 1 << slot;
    }
}

/// The tree. Node 0 is the root.
#[derive(Debug, Clone, Default)]
pub struct WideBvh {
    /// Nodes, parents before children.
    pub nodes: Vec<Node>,
    pub leaves: Vec<Leaf>,
    /// Nodes on the longest path from the root to a leaf.
    pub depth: usize,
}

/// Relative costs: visiting a node, and a leaf with n triangles (`LEAF_COST + n·TRIANGLE_COST`).
const NODE_COST: f32 = 1.0;
const LEAF_COST: f32 = 3.0;
const TRIANGLE_COST: f32 = 0.15;

impl WideBvh {
    /// Builds a tree over fewer than 2³¹ triangles, whose indices must be in range and positions finite. Runs on the
    /// current rayon pool.
    #[must_use]
    pub fn build(positions: &[Vec3], triangles: &[[u32; 3]], flags: &dyn Fn(u32) -> TriangleFlags) -> Self {
        if triangles.is_empty() {
            return Self { nodes: vec![Node::EMPTY], leaves: Vec::new(), depth: 1 };
        }
        let bounds = |corners: &[u32; 3]| {
            let [a, b, c] = corners.map(|i| positions[i as usize]);
            Aabb::new(a.min(b).min(c).into(), a.max(b).max(c).into())
        };
        let binary = binary::build(&triangles.iter().map(bounds).collect::<Vec<_>>());
        Collapse::new(&binary).run(positions, triangles, flags)
    }

    /// Memory of nodes and leaves.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&*self.nodes) + size_of_val(&*self.leaves)
    }
}

/// The dynamic programming table: `costs[n][i]` is the least cost of the subtree of binary node n as at most i children
/// of a wide node (i from 1 to 7; slot 0 is unused).
struct Collapse<'a> {
    binary: &'a Bvh2,
    costs: Vec<[f32; WIDTH]>,
    counts: Vec<usize>,
}

impl<'a> Collapse<'a> {
    fn new(binary: &'a Bvh2) -> Self {
        let mut order = Vec::with_capacity(binary.nodes.len());
        let mut stack = vec![0];
        while let Some(n) = stack.pop() {
            order.push(n);
            if let Some(children) = children(binary, n) {
                stack.extend(children);
            }
        }
        let mut this =
            Self { binary, costs: vec![[0.0; WIDTH]; binary.nodes.len()], counts: vec![1; binary.nodes.len()] };
        for &n in order.iter().rev() {
            match children(binary, n) {
                None => this.costs[n] = [this.leaf_cost(n); WIDTH],
                Some([left, right]) => {
                    this.counts[n] = this.counts[left] + this.counts[right];
                    this.costs[n][1] = this.leaf_cost(n).min(this.node_cost(n));
                    for slots in 2..WIDTH {
                        this.costs[n][slots] = this.split(n, slots).0.min(this.costs[n][slots - 1]);
                    }
                }
            }
        }
        this
    }

    fn area(&self, n: usize) -> f32 {
        self.binary.nodes[n].aabb.half_area()
    }

    /// Cost of binary node n as one leaf.
    fn leaf_cost(&self, n: usize) -> f32 {
        match u16::try_from(self.counts[n]) {
            Ok(count) if usize::from(count) <= WIDTH => self.area(n) * (LEAF_COST + TRIANGLE_COST * f32::from(count)),
            _ => f32::INFINITY,
        }
    }

    /// Cost of binary inner node n as one wide node.
    fn node_cost(&self, n: usize) -> f32 {
        self.area(n) * NODE_COST + self.split(n, WIDTH).0
    }

    /// The cheapest split of `slots` ≥ 2 children between the sides of binary inner node n: its cost, and how many go
    /// left.
    fn split(&self, n: usize, slots: usize) -> (f32, usize) {
        let Some([left, right]) = children(self.binary, n) else { return (f32::INFINITY, 0) };
        (1..slots)
            .map(|k| (self.costs[left][k] + self.costs[right][slots - k], k))
            .fold((f32::INFINITY, 1), |best, option| if option.0 < best.0 { option } else { best })
    }

    /// Returns the binary nodes that become the children of binary node n's wide node.
    fn wide_children(&self, n: usize) -> Vec<usize> {
        let mut found = Vec::with_capacity(WIDTH);
        let mut open = vec![(n, WIDTH)];
        while let Some((n, slots)) = open.pop() {
            let cost = if slots == WIDTH { f32::NEG_INFINITY } else { self.costs[n][slots] };
            match children(self.binary, n) {
                _ if slots == 1 => found.push(n),
                None => found.push(n),
                Some(_) if cost == self.costs[n][slots - 1] => open.push((n, slots - 1)),
                Some([left, right]) => {
                    let (_, k) = self.split(n, slots);
                    open.push((right, slots - k));
                    open.push((left, k));
                }
            }
        }
        found
    }

    fn run(&self, positions: &[Vec3], triangles: &[[u32; 3]], flags: &dyn Fn(u32) -> TriangleFlags) -> WideBvh {
        let mut wide = WideBvh { nodes: vec![Node::EMPTY], leaves: Vec::new(), depth: 1 };
        // Binary node, wide node, depth of the wide node.
        let mut open = vec![(0, 0, 1)];
        while let Some((n, place, depth)) = open.pop() {
            wide.depth = wide.depth.max(depth);
            let members = if children(self.binary, n).is_some() { self.wide_children(n) } else { vec![n] };
            let first_open = open.len();
            for (slot, &member) in members.iter().enumerate() {
                let aabb = self.binary.nodes[member].aabb;
                for axis in 0..3 {
                    wide.nodes[place].min[axis].0[slot] = aabb.min[axis];
                    wide.nodes[place].max[axis].0[slot] = aabb.max[axis];
                }
                let leaf_cost = self.leaf_cost(member);
                let is_leaf = children(self.binary, member).is_none()
                    || (leaf_cost.is_finite() && leaf_cost <= self.node_cost(member));
                wide.nodes[place].children[slot] = if is_leaf {
                    wide.leaves.push(self.leaf(member, positions, triangles, flags));
                    word(wide.leaves.len() - 1) | LEAF_BIT
                } else {
                    wide.nodes.push(Node::EMPTY);
                    open.push((member, wide.nodes.len() - 1, depth + 1));
                    word(wide.nodes.len() - 1)
                };
            }
            // The first child's subtree comes next, to be near its parent in memory.
            open[first_open..].reverse();
        }
        wide
    }

    fn leaf(&self, n: usize, positions: &[Vec3], triangles: &[[u32; 3]], flags: &dyn Fn(u32) -> TriangleFlags) -> Leaf {
        let mut leaf = Leaf::EMPTY;
        let mut slot = 0;
        let mut open = vec![n];
        while let Some(n) = open.pop() {
            if let Some([left, right]) = children(self.binary, n) {
                open.extend([right, left]);
                continue;
            }
            let triangle = self.binary.primitive_indices[self.binary.nodes[n].first_index as usize];
            leaf.triangles[slot] = triangle;
            let corners = triangles[triangle as usize].map(|index| positions[index as usize]);
            let [a, b, c] = corners;
            leaf.place(slot, corners, triangle_normal(a, b, c).unwrap_or_default().as_vec3());
            let flags = flags(triangle);
            leaf.there |= 1 << slot;
            leaf.single_sided |= u8::from(flags.single_sided) << slot;
            leaf.masked |= u8::from(flags.masked) << slot;
            slot += 1;
        }
        leaf
    }
}

/// Returns the children of binary node n, or `None` for a leaf, which has one triangle.
fn children(binary: &Bvh2, n: usize) -> Option<[usize; 2]> {
    let node = &binary.nodes[n];
    let first = node.first_index as usize;
    (!node.is_leaf()).then_some([first, first + 1])
}

#[expect(clippy::cast_possible_truncation, reason = "there are fewer nodes and leaves than triangles, below 2^31")]
pub(super) fn word(index: usize) -> u32 {
    index as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pseudo-randomly scattered triangles, which make an unbalanced tree.
    fn scattered(count: u32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let mut state = 1_u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 16_777_216.0
        };
        let mut positions = Vec::new();
        for _ in 0..count {
            let centre = Vec3::new(next(), next() * next(), next()) * 50.0;
            for _ in 0..3 {
                positions.push(centre + Vec3::new(next(), next(), next()) * next());
            }
        }
        (positions, (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect())
    }

    #[test]
    fn every_triangle_is_in_one_leaf_inside_all_boxes_above_it() {
        for count in [0, 1, 2, 7, 8, 9, 65, 5000] {
            let (positions, triangles) = scattered(count);
            let flags = |t: u32| TriangleFlags { single_sided: t.is_multiple_of(2), masked: t.is_multiple_of(3) };
            let wide = WideBvh::build(&positions, &triangles, &flags);
            let mut seen = vec![0; triangles.len()];
            let everywhere = (Vec3::INFINITY * -1.0, Vec3::INFINITY);
            let mut open = vec![(Child::Node(0), everywhere, 0)];
            while let Some((child, (min, max), depth)) = open.pop() {
                assert!(depth <= wide.depth);
                match child {
                    Child::None => {}
                    Child::Node(n) => {
                        let node = &wide.nodes[n as usize];
                        for slot in 0..WIDTH {
                            let low = Vec3::from_array([0, 1, 2].map(|axis| node.min[axis].0[slot]));
                            let high = Vec3::from_array([0, 1, 2].map(|axis| node.max[axis].0[slot]));
                            if node.child(slot) == Child::None {
                                assert!(low.cmpgt(high).all());
                            } else {
                                assert!(low.cmpge(min).all() && high.cmple(max).all());
                                open.push((node.child(slot), (low, high), depth + 1));
                            }
                        }
                    }
                    Child::Leaf(l) => {
                        let leaf = &wide.leaves[l as usize];
                        assert!(leaf.used != 0);
                        for slot in (0..WIDTH).filter(|slot| leaf.used >> slot & 1 == 1) {
                            let triangle = leaf.triangles[slot];
                            seen[triangle as usize] += 1;
                            assert_eq!(leaf.single_sided >> slot & 1 == 1, triangle.is_multiple_of(2));
                            assert_eq!(leaf.masked >> slot & 1 == 1, triangle.is_multiple_of(3));
                            for (corner, &index) in triangles[triangle as usize].iter().enumerate() {
                                let at = Vec3::from_array([0, 1, 2].map(|axis| leaf.corners[corner][axis].0[slot]));
                                assert_eq!(at, positions[index as usize]);
                                assert!(at.cmpge(min).all() && at.cmple(max).all());
                            }
                        }
                    }
                }
            }
            assert!(seen.iter().all(|&n| n == 1));
        }
    }

    #[test]
    fn leaves_of_a_mesh_are_filled() {
        let positions: Vec<Vec3> =
            (0..65 * 65).map(|i| Vec3::new((i % 65) as f32, ((i * 7) % 5) as f32 * 0.1, (i / 65) as f32)).collect();
        let quads = (0..64).flat_map(|z| (0..64).map(move |x| 65 * z + x));
        let triangles: Vec<[u32; 3]> = quads.flat_map(|i| [[i, i + 65, i + 66], [i, i + 66, i + 1]]).collect();
        let wide = WideBvh::build(&positions, &triangles, &|_| TriangleFlags::default());
        // 3.9 triangles a leaf.
        assert!(wide.leaves.len() * 15 < triangles.len() * 4, "{} leaves", wide.leaves.len());
        assert!(wide.nodes.len() * 4 < wide.leaves.len(), "{} nodes", wide.nodes.len());
    }
}
