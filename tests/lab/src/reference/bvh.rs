//! A plain BVH for the referee: binary, binned surface area heuristic, f64 boxes.
//!
//! Wald, "On fast Construction of SAH-based Bounding Volume Hierarchies", 2007, with sixteen bins. Boxes are grown by a
//! margin, so that traversal also visits triangles that the ray passes within that margin.

use glam::DVec3;

use super::triangle::Ray;

const BINS: usize = 16;
const LEAF: usize = 4;
/// Below this depth nodes are split in half by count, which bounds the tree's depth.
const SAH_DEPTH: usize = 60;
/// [`SAH_DEPTH`] plus 32 halvings, enough for 2^32 triangles.
const STACK: usize = 96;

#[derive(Debug, Clone, Copy)]
struct Bounds {
    min: DVec3,
    max: DVec3,
}

impl Bounds {
    const EMPTY: Self = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    fn join(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    fn half_area(self) -> f64 {
        let size = (self.max - self.min).max(DVec3::ZERO);
        size.x * size.y + size.y * size.z + size.z * size.x
    }

    /// Returns where the ray enters and leaves.
    fn cross(&self, ray: &Ray) -> (f64, f64) {
        // 0·∞ is NaN if the ray runs inside a face; f64 `min` and `max` then return the other argument.
        let (a, b) = ((self.min - ray.origin) * ray.inverse, (self.max - ray.origin) * ray.inverse);
        let near = a.x.min(b.x).max(a.y.min(b.y)).max(a.z.min(b.z));
        let far = a.x.max(b.x).min(a.y.max(b.y)).min(a.z.max(b.z));
        (near, far)
    }
}

#[derive(Debug)]
struct Node {
    bounds: Bounds,
    /// First index into `order` of a leaf, or the first of two children.
    first: u32,
    /// Triangles of a leaf; 0 for inner nodes.
    count: u32,
}

#[derive(Debug)]
pub(super) struct Bvh {
    nodes: Vec<Node>,
    order: Vec<u32>,
}

struct Item {
    bounds: Bounds,
    centre: DVec3,
    index: u32,
}

impl Bvh {
    /// Builds a hierarchy over the triangles, each box grown by `margin_m`.
    #[expect(clippy::cast_possible_truncation, reason = "scenes index their triangles and vertices with u32")]
    pub(super) fn new(triangles: &[[DVec3; 3]], margin_m: f64) -> Self {
        let mut items: Vec<_> = triangles
            .iter()
            .enumerate()
            .map(|(index, [a, b, c])| {
                let bounds = Bounds {
                    min: a.min(*b).min(*c) - DVec3::splat(margin_m),
                    max: a.max(*b).max(*c) + DVec3::splat(margin_m),
                };
                Item { bounds, centre: (bounds.min + bounds.max) * 0.5, index: index as u32 }
            })
            .collect();
        let mut nodes = vec![Node { bounds: Bounds::EMPTY, first: 0, count: 0 }];
        let mut open = vec![(0, 0, items.len(), 0)];
        while let Some((node, start, end, depth)) = open.pop() {
            let range = &mut items[start..end];
            nodes[node].bounds = range.iter().fold(Bounds::EMPTY, |all, item| all.join(item.bounds));
            if range.len() <= LEAF {
                nodes[node].first = start as u32;
                nodes[node].count = range.len() as u32;
                continue;
            }
            let middle = start + split(range, depth);
            let first = nodes.len();
            nodes[node].first = first as u32;
            for _ in 0..2 {
                nodes.push(Node { bounds: Bounds::EMPTY, first: 0, count: 0 });
            }
            open.push((first, start, middle, depth + 1));
            open.push((first + 1, middle, end, depth + 1));
        }
        Self { nodes, order: items.into_iter().map(|item| item.index).collect() }
    }

    /// Calls `meet` with every triangle whose grown box the ray crosses before `t_end`, nearer boxes first. `meet`
    /// returns the new `t_end`; a negative one stops the traversal.
    pub(super) fn walk(&self, ray: &Ray, mut t_end: f64, mut meet: impl FnMut(u32) -> f64) {
        let mut stack = [(0_u32, 0.0_f64); STACK];
        let mut height = 1;
        stack[0] = (0, f64::NEG_INFINITY);
        while height > 0 {
            height -= 1;
            let (index, entry) = stack[height];
            if entry > t_end {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.count > 0 {
                for &triangle in &self.order[node.first as usize..(node.first + node.count) as usize] {
                    t_end = meet(triangle);
                    if t_end < 0.0 {
                        return;
                    }
                }
                continue;
            }
            if self.order.is_empty() {
                return;
            }
            let mut children = [node.first, node.first + 1].map(|child| {
                let (near, far) = self.nodes[child as usize].bounds.cross(ray);
                (child, near, near <= far && far >= 0.0 && near <= t_end)
            });
            if children[0].1 < children[1].1 {
                children.swap(0, 1);
            }
            for (child, near, crossed) in children {
                if crossed {
                    stack[height] = (child, near);
                    height += 1;
                }
            }
        }
    }
}

/// Partitions the items and returns how many go left: never none, never all.
fn split(items: &mut [Item], depth: usize) -> usize {
    let half = items.len() / 2;
    let centres = items.iter().fold(Bounds::EMPTY, |all, item| all.join(Bounds { min: item.centre, max: item.centre }));
    let extent = centres.max - centres.min;
    let mut best = (f64::INFINITY, 0, 0);
    for axis in 0..3 {
        if extent[axis] <= 0.0 || depth >= SAH_DEPTH {
            continue;
        }
        let mut bins = [(Bounds::EMPTY, 0_usize); BINS];
        for item in items.iter() {
            let bin = &mut bins[bin_of(item.centre[axis], centres.min[axis], extent[axis])];
            *bin = (bin.0.join(item.bounds), bin.1 + 1);
        }
        let sweep = |bins: &mut dyn Iterator<Item = &(Bounds, usize)>| {
            let mut all = (Bounds::EMPTY, 0_usize);
            bins.map(|bin| {
                all = (all.0.join(bin.0), all.1 + bin.1);
                #[expect(clippy::cast_precision_loss, reason = "a cost needs no more than 53 bits")]
                let cost = if all.1 == 0 { 0.0 } else { all.0.half_area() * all.1 as f64 };
                (cost, all.1)
            })
            .collect::<Vec<_>>()
        };
        let left = sweep(&mut bins.iter());
        let right = sweep(&mut bins.iter().rev());
        for cut in 1..BINS {
            let (l, r) = (left[cut - 1], right[BINS - 1 - cut]);
            if l.1 > 0 && r.1 > 0 && l.0 + r.0 < best.0 {
                best = (l.0 + r.0, axis, cut);
            }
        }
    }
    if best.0.is_finite() {
        let (_, axis, cut) = best;
        let mut left = 0;
        for place in 0..items.len() {
            if bin_of(items[place].centre[axis], centres.min[axis], extent[axis]) < cut {
                items.swap(left, place);
                left += 1;
            }
        }
        return left;
    }
    half
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 16, then bounded to 15")]
fn bin_of(centre: f64, low: f64, extent: f64) -> usize {
    (((centre - low) / extent * 16.0) as usize).min(BINS - 1)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn point(side: f64) -> impl Strategy<Value = DVec3> {
        (-side..side, -side..side, -side..side).prop_map(|(x, y, z)| DVec3::new(x, y, z))
    }

    fn triangles() -> impl Strategy<Value = Vec<[DVec3; 3]>> {
        let shape = (point(10.0), point(3.0), point(3.0)).prop_map(|(a, b, c)| [a, a + b, a + c]);
        // Some are flat along an axis, some are stacked on one spot: both split badly.
        let flat = (point(10.0), point(3.0), point(3.0)).prop_map(|(a, b, c)| [a, a + b, a + c].map(|p| p.with_y(1.0)));
        let stacked = point(1.0).prop_map(|p| [p * 1e-3, DVec3::X, DVec3::Z]);
        prop::collection::vec(prop_oneof![shape, flat, stacked], 0..150)
    }

    proptest! {
        #[test]
        fn a_walk_meets_every_triangle_that_the_ray_crosses(
            triangles in triangles(),
            from in point(15.0),
            towards in prop_oneof![point(1.0), Just(DVec3::X), Just(DVec3::NEG_Y), Just(DVec3::Z)],
            t_end in prop_oneof![Just(f64::INFINITY), 0.0..20.0],
        ) {
            prop_assume!(towards.length() > 1e-3);
            let ray = Ray::new(from, towards);
            let bvh = Bvh::new(&triangles, 1e-6);
            let mut met = vec![0; triangles.len()];
            bvh.walk(&ray, t_end, |triangle| {
                met[triangle as usize] += 1;
                t_end
            });
            for (triangle, times) in triangles.iter().zip(met) {
                prop_assert!(times <= 1);
                let hit = ray.cross(triangle).is_some_and(|c| c.inside_m >= 0.0 && c.t >= 0.0 && c.t <= t_end);
                prop_assert!(!hit || times == 1, "missed {triangle:?}");
            }
        }
    }
}
