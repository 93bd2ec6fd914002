//! Sorts shadow rays that end far apart into groups and packets whose rays run close together.
//!
//! Neighbouring pixels see neighbouring points, except at silhouettes. There a tile's shadow rays form two or more
//! bundles, and a group that spans the gap tests most of its nodes and triangles in vain. Seen from the light the rays
//! are points of a plane, and a group's cost grows with the area that they cover. So the points are split in two
//! wherever that saves area, and each part is sorted into packets of eight neighbours. If no packet is wide, whole
//! packets are split from each other instead ([`packet_sets`]): that is as good, and costs next to nothing.

use super::{
    group::{Group, PACKETS, Projection},
    simd::{F8, Simd},
    surface::Coordinates,
};

/// Rays in a full group.
const RAYS: usize = 8 * PACKETS;

/// A part is split if that leaves less than this share of its area.
const WORTH: f32 = 0.8;

/// A group's rays as a list: x and y on the plane, and the ray's index in the group.
pub(super) struct Regrouping {
    rays: [(f32, f32, u8); RAYS],
    count: usize,
    /// Added to a part's sides before its area is computed, since triangles have a size, too.
    padding: f32,
}

/// Consecutive ranges, stored as their ends. Compact, because every group makes one.
pub(super) struct Ranges {
    ends: [u8; RAYS],
    count: usize,
    next: usize,
    from: usize,
}

impl Iterator for Ranges {
    type Item = (usize, usize);

    #[inline(always)]
    fn next(&mut self) -> Option<(usize, usize)> {
        if self.next == self.count {
            return None;
        }
        let range = (self.from, usize::from(self.ends[self.next]));
        self.next += 1;
        self.from = range.1;
        Some(range)
    }
}

/// Sets of a group's packets, one bit a packet, each of which is a group of its own.
pub(super) struct PacketSets {
    /// A stack: the next set is the last.
    sets: [u8; PACKETS],
    count: usize,
}

impl Iterator for PacketSets {
    type Item = u8;

    #[inline(always)]
    fn next(&mut self) -> Option<u8> {
        self.count = self.count.checked_sub(1)?;
        Some(self.sets[self.count])
    }
}

/// Splits a group between its packets, as [`Regrouping::sort`] does between its rays.
#[inline(always)]
pub(super) fn packet_sets<S: Simd>(s: S, group: &Group, padding: f32) -> PacketSets {
    let mut done = PacketSets { sets: [0; PACKETS], count: 0 };
    let mut open = [0; PACKETS];
    open[0] = group.packets;
    let mut left = 1;
    while left > 0 {
        let set = open[left - 1];
        if let Some(low) = low_half(s, group, set, padding) {
            open[left - 1] = low;
            open[left] = set & !low;
            left += 1;
        } else {
            done.sets[done.count] = set;
            done.count += 1;
            left -= 1;
        }
    }
    done
}

/// The packets of `set` in the lower half of its longer side, if to split it there saves enough area.
#[inline(always)]
fn low_half<S: Simd>(s: S, group: &Group, set: u8, padding: f32) -> Option<u8> {
    let whole = Rectangle::around_packets(s, group, set);
    let (along_x, middle) = whole.longer_side();
    let [low, high] = if along_x { &group.packet_x } else { &group.packet_y };
    let low = s.bits(s.gt(s.splat(2.0 * middle), s.load(low) + s.load(high))) & set;
    if low == 0 || low == set {
        return None;
    }
    let parts = Rectangle::around_packets(s, group, low).area(padding)
        + Rectangle::around_packets(s, group, set & !low).area(padding);
    (parts < whole.area(padding) * WORTH).then_some(low)
}

/// One of the new groups.
pub(super) struct Part {
    pub(super) group: Group,
    /// The rays' points, in the order of the group's packets.
    pub(super) points: Coordinates,
    /// `places[p][i]`: the index in the old group of lane i of packet p, 8 times its packet plus its lane.
    places: [[u8; 8]; PACKETS],
}

impl Regrouping {
    #[inline(always)]
    pub(super) fn of(group: &Group, padding: f32) -> Self {
        let mut this = Self { rays: [(0.0, 0.0, 0); RAYS], count: 0, padding };
        for (p, &lanes) in group.lanes.iter().enumerate() {
            for (lane, &place) in PLACES[p].iter().enumerate() {
                if lanes >> lane & 1 == 1 {
                    this.rays[this.count] = (group.x[p].0[lane], group.y[p].0[lane], place);
                    this.count += 1;
                }
            }
        }
        this
    }

    /// Sorts the rays. Each range of the result is a new group, in the order of its packets.
    pub(super) fn sort(&mut self) -> Ranges {
        let mut done = Ranges { ends: [0; RAYS], count: 0, next: 0, from: 0 };
        // A stack of the ends of the remaining parts. The top part is the first; each begins where the one above ends.
        let mut open = [0; RAYS];
        open[0] = self.count;
        let (mut left, mut from) = (1, 0);
        while left > 0 {
            let to = open[left - 1];
            if let Some(middle) = self.split(from, to) {
                open[left] = middle;
                left += 1;
            } else {
                self.pack(from, to);
                #[expect(clippy::cast_possible_truncation, reason = "at most 64 rays")]
                let end = to as u8;
                done.ends[done.count] = end;
                done.count += 1;
                left -= 1;
                from = to;
            }
        }
        done
    }

    /// Splits `from..to` in the middle of its longer side if that saves enough area. Returns where.
    fn split(&mut self, from: usize, to: usize) -> Option<usize> {
        let rays = &mut self.rays[from..to];
        if rays.len() < 2 {
            return None;
        }
        let whole = Rectangle::around(rays);
        let (along_x, middle) = whole.longer_side();
        let mut low = 0;
        for i in 0..rays.len() {
            if (if along_x { rays[i].0 } else { rays[i].1 }) < middle {
                rays.swap(i, low);
                low += 1;
            }
        }
        if low == 0 || low == rays.len() {
            return None;
        }
        let parts =
            Rectangle::around(&rays[..low]).area(self.padding) + Rectangle::around(&rays[low..]).area(self.padding);
        (parts < whole.area(self.padding) * WORTH).then_some(from + low)
    }

    /// Sorts `from..to` into packets of eight neighbours: halves it across its longer side at a multiple of eight.
    fn pack(&mut self, from: usize, to: usize) {
        let rays = &mut self.rays[from..to];
        if rays.len() <= 8 {
            return;
        }
        let (along_x, _) = Rectangle::around(rays).longer_side();
        let middle = rays.len().div_ceil(8) / 2 * 8;
        if along_x {
            rays.select_nth_unstable_by(middle, |a, b| a.0.total_cmp(&b.0));
        } else {
            rays.select_nth_unstable_by(middle, |a, b| a.1.total_cmp(&b.1));
        }
        self.pack(from, from + middle);
        self.pack(from + middle, to);
    }

    /// Makes the new group from the rays `from..to`. `points` are the old group's.
    #[inline(always)]
    pub(super) fn part<S: Simd>(
        &self,
        s: S,
        (from, to): (usize, usize),
        projection: Projection,
        points: &Coordinates,
    ) -> Part {
        let mut part =
            Part { group: Group::empty(projection), points: [[F8::default(); PACKETS]; 3], places: [[0; 8]; PACKETS] };
        for (p, rays) in self.rays[from..to].chunks(8).enumerate() {
            let (mut x, mut y, mut lanes) = (F8::default(), F8::default(), 0);
            for (lane, ray) in rays.iter().enumerate() {
                (x.0[lane], y.0[lane]) = (ray.0, ray.1);
                let (old_packet, old_lane) = (usize::from(ray.2 / 8), usize::from(ray.2 % 8));
                for (to, from) in part.points.iter_mut().zip(points) {
                    to[p].0[lane] = from[old_packet].0[old_lane];
                }
                part.places[p][lane] = ray.2;
                lanes |= 1 << lane;
            }
            part.group.set_packet(s, p, s.load(&x), s.load(&y), lanes);
        }
        part
    }
}

impl Part {
    /// Adds the rays that remain in the new group to the old group's lanes.
    pub(super) fn add_left(&self, old_lanes: &mut [u8; PACKETS]) {
        for (lanes, places) in self.group.lanes.iter().zip(&self.places) {
            for (lane, place) in places.iter().enumerate() {
                old_lanes[usize::from(place / 8)] |= (lanes >> lane & 1) << (place % 8);
            }
        }
    }
}

/// 8·p + i at `[p][i]`.
const PLACES: [[u8; 8]; PACKETS] = {
    let mut places = [[0; 8]; PACKETS];
    let mut place = 0;
    while place < 64 {
        places[(place / 8) as usize][(place % 8) as usize] = place;
        place += 1;
    }
    places
};

#[derive(Clone, Copy)]
struct Rectangle {
    min: (f32, f32),
    max: (f32, f32),
}

impl Rectangle {
    fn around(rays: &[(f32, f32, u8)]) -> Self {
        let mut min = (f32::INFINITY, f32::INFINITY);
        let mut max = (f32::NEG_INFINITY, f32::NEG_INFINITY);
        for &(x, y, _) in rays {
            // Comparisons, because `f32::min` also handles NaN.
            min = (if x < min.0 { x } else { min.0 }, if y < min.1 { y } else { min.1 });
            max = (if x > max.0 { x } else { max.0 }, if y > max.1 { y } else { max.1 });
        }
        Self { min, max }
    }

    /// Around the packets of `set`.
    #[inline(always)]
    fn around_packets<S: Simd>(s: S, group: &Group, set: u8) -> Self {
        let set = s.mask(set);
        let (low, high) = (s.splat(f32::INFINITY), s.splat(f32::NEG_INFINITY));
        let min = [s.select(set, s.load(&group.packet_x[0]), low), s.select(set, s.load(&group.packet_y[0]), low)];
        let max = [s.select(set, s.load(&group.packet_x[1]), high), s.select(set, s.load(&group.packet_y[1]), high)];
        Self { min: (s.lowest(min[0]), s.lowest(min[1])), max: (s.highest(max[0]), s.highest(max[1])) }
    }

    /// Returns true if the longer side is along x, and the middle of that side.
    fn longer_side(self) -> (bool, f32) {
        let along_x = self.max.0 - self.min.0 >= self.max.1 - self.min.1;
        (along_x, if along_x { (self.min.0 + self.max.0) * 0.5 } else { (self.min.1 + self.max.1) * 0.5 })
    }

    fn area(self, padding: f32) -> f32 {
        (self.max.0 - self.min.0 + padding) * (self.max.1 - self.min.1 + padding)
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::visibility::backend::cpu::simd::{Level, WithSimd};

    /// Regroups the given rays, ray i at place i. Returns each part's places and points.
    struct Regroup<'a>(&'a [Option<(f32, f32)>; RAYS]);

    impl WithSimd for Regroup<'_> {
        type Output = Vec<Vec<Vec<(u8, [f32; 3])>>>;
        #[inline(always)]
        fn run<S: Simd>(self, s: S) -> Self::Output {
            let mut group = Group::empty(Projection::from_apex(Vec3::ZERO, 0));
            let mut points = [[F8::default(); PACKETS]; 3];
            for p in 0..PACKETS {
                let (mut x, mut y, mut lanes) = (F8::default(), F8::default(), 0);
                for (lane, &place) in PLACES[p].iter().enumerate() {
                    points[0][p].0[lane] = f32::from(place);
                    if let Some(at) = self.0[8 * p + lane] {
                        (x.0[lane], y.0[lane]) = at;
                        (points[1][p].0[lane], points[2][p].0[lane]) = at;
                        lanes |= 1 << lane;
                    }
                }
                if lanes != 0 {
                    group.set_packet(s, p, s.load(&x), s.load(&y), lanes);
                }
            }
            let mut regrouping = Regrouping::of(&group, 0.01);
            let mut parts = Vec::new();
            let mut left = [0; PACKETS];
            for range in regrouping.sort() {
                let part = regrouping.part(s, range, group.projection, &points);
                part.add_left(&mut left);
                let packets = (0..PACKETS).filter(|&p| part.group.lanes[p] != 0).map(|p| {
                    let lanes = (0..8).filter(|lane| part.group.lanes[p] >> lane & 1 == 1);
                    lanes
                        .map(|lane| (part.places[p][lane], [0, 1, 2].map(|axis| part.points[axis][p].0[lane])))
                        .collect()
                });
                parts.push(packets.collect());
            }
            assert_eq!(left, group.lanes);
            parts
        }
    }

    fn spread(i: usize) -> (f32, f32) {
        let i = u16::try_from(i).unwrap();
        (f32::from(i * 37 % 64) / 640.0, f32::from(i * 23 % 61) / 610.0)
    }

    #[test]
    fn every_ray_keeps_its_place_and_its_point_in_full_packets() {
        for every in [1, 2, 5, 40] {
            let at = std::array::from_fn(|i| (i % every == 0).then(|| spread(i)));
            let parts = Level::detect().dispatch(Regroup(&at));
            let mut seen = [false; RAYS];
            for packets in &parts {
                // All packets of a part except the last are full.
                assert!(packets.iter().rev().skip(1).all(|packet| packet.len() == 8));
                for &(place, point) in packets.iter().flatten() {
                    let (x, y) = at[usize::from(place)].unwrap();
                    assert_eq!(point, [f32::from(place), x, y]);
                    assert!(!std::mem::replace(&mut seen[usize::from(place)], true));
                }
            }
            assert_eq!(seen.map(usize::from).iter().sum::<usize>(), at.iter().flatten().count());
        }
    }

    #[test]
    fn two_bundles_become_two_groups_and_one_stays_one() {
        let one = std::array::from_fn(|i| Some(spread(i)));
        assert_eq!(Level::detect().dispatch(Regroup(&one)).len(), 1);
        let two = std::array::from_fn(|i| {
            let (x, y) = spread(i);
            Some(if i % 3 == 0 { (x, y) } else { (x + 0.8, y) })
        });
        let parts = Level::detect().dispatch(Regroup(&two));
        assert_eq!(parts.len(), 2);
        for packets in parts {
            let far: Vec<bool> = packets.iter().flatten().map(|(_, point)| point[1] > 0.5).collect();
            assert!(far.iter().all(|&it| it == far[0]));
        }
    }

    /// Sets of packets, each eight rays at one place.
    struct Sets<'a>(&'a [Option<(f32, f32)>; PACKETS]);

    impl WithSimd for Sets<'_> {
        type Output = Vec<u8>;
        #[inline(always)]
        fn run<S: Simd>(self, s: S) -> Vec<u8> {
            let mut group = Group::empty(Projection::from_apex(Vec3::ZERO, 0));
            for (p, at) in self.0.iter().enumerate() {
                if let Some((x, y)) = *at {
                    group.set_packet(s, p, s.splat(x), s.splat(y), 0xff);
                }
            }
            packet_sets(s, &group, 0.01).collect()
        }
    }

    #[test]
    fn each_packet_is_in_one_set_with_its_neighbours() {
        let near = |p: usize| (spread(p).0 * 0.01, spread(p).1 * 0.01);
        for there in [0b1111_1111_u8, 0b1010_0110, 0b0000_1000] {
            let packets = |from: fn(usize) -> f32| {
                std::array::from_fn(|p| (there >> p & 1 == 1).then(|| (near(p).0 + from(p), near(p).1 + from(p))))
            };
            assert_eq!(Level::detect().dispatch(Sets(&packets(|_| 0.0))), [there]);
            let mut sets = Level::detect().dispatch(Sets(&packets(|p| if p < 4 { 0.8 } else { 0.0 })));
            sets.sort_unstable();
            let expected: Vec<u8> = [there & 0x0f, there & 0xf0].into_iter().filter(|set| *set != 0).collect();
            assert_eq!(sets, expected);
            let apart: Vec<u8> = Level::detect().dispatch(Sets(&packets(|p| p as f32)));
            assert!(apart.iter().all(|set| set.count_ones() == 1));
            assert_eq!(apart.iter().fold(0, |all, set| all | set), there);
        }
    }

    #[test]
    fn a_packets_rays_are_neighbours() {
        // An 8×8 grid in scrambled order. Well packed, no packet spans more than 4×2 of it.
        let at = std::array::from_fn(|i| {
            let i = u16::try_from(i * 29 % 64).unwrap();
            Some((f32::from(i % 8), f32::from(i / 8)))
        });
        for packet in Level::detect().dispatch(Regroup(&at)).iter().flatten() {
            let rays: Vec<_> = packet.iter().map(|(_, point)| (point[1], point[2], 0)).collect();
            let Rectangle { min, max } = Rectangle::around(&rays);
            assert!((max.0 - min.0) * (max.1 - min.1) <= 3.0, "{packet:?}");
        }
    }
}
