//! An old olive-like tree: a branching skeleton of tapered bars, twigs of alpha-masked leaves at its ends.

use std::f64::consts::TAU;

use glam::{DQuat, DVec2, DVec3};

use super::mesh::Soup;
use super::plants::card;
use super::rng::Rng;
use super::shapes::{part, smooth};
use super::sweep::{Ends, tube};
use super::textures::leaves::TWIG;

pub(crate) struct Tree {
    pub(crate) wood: Soup,
    pub(crate) leaves: Soup,
}

struct Branch {
    from: DVec3,
    direction: DVec3,
    length: f64,
    radius: f64,
    level: usize,
}

pub(crate) fn grow(rng: &mut Rng) -> Tree {
    let mut tree = Tree { wood: Soup::default(), leaves: Soup::default() };
    let trunk = Branch {
        from: DVec3::new(0.0, -0.15, 0.0),
        direction: DVec3::new(0.10, 1.0, -0.06).normalize(),
        length: 1.75,
        radius: 0.17,
        level: 0,
    };
    add(&mut tree, rng, &trunk);
    // Bars run along u, the wood's grain along v.
    tree.wood = tree.wood.with_uv(|uv| DVec2::new(uv.y, uv.x));
    tree
}

fn add(tree: &mut Tree, rng: &mut Rng, branch: &Branch) {
    // A crooked path that bends upwards again.
    let steps = if branch.level == 0 { 5 } else { 4 };
    let mut points = vec![branch.from];
    let mut direction = branch.direction;
    for _ in 0..steps {
        let sway = DVec3::new(rng.between(-1.0, 1.0), rng.between(-0.3, 0.6), rng.between(-1.0, 1.0));
        direction = (direction + sway * 0.22).normalize();
        points.push(points[points.len() - 1] + direction * branch.length / steps as f64);
    }
    let path = smooth(&points, if branch.level == 0 { 3 } else { 1 });
    let sides = [12, 8, 6, 4][branch.level.min(3)];
    let thin = branch.radius * 0.55;
    let flare = if branch.level == 0 { 0.13 } else { 0.0 };
    tree.wood.append(tube(&path, sides, Ends::Open, |t| {
        branch.radius + (thin - branch.radius) * t + flare * (1.0 - t * 5.0).max(0.0).powi(2)
    }));
    if branch.level >= 2 {
        leaf_twigs(tree, rng, &points, branch.level);
    }
    if branch.level == 3 {
        return;
    }
    let children = [5, 4, 4][branch.level];
    let turn = rng.between(0.0, TAU);
    for child in 0..children {
        let reach = if branch.level == 0 { rng.between(0.82, 1.0) } else { rng.between(0.45, 1.0) };
        let at = reach * steps as f64;
        let (index, rest) = (at.floor().min(steps as f64 - 1.0), at - at.floor().min(steps as f64 - 1.0));
        let base = (0..steps).find(|&i| i as f64 >= index).unwrap_or(0);
        let from = points[base].lerp(points[base + 1], rest);
        let around = DQuat::from_axis_angle(direction, turn + TAU * (part(child, children) + rng.between(-0.06, 0.06)));
        let out = around * direction.any_orthonormal_vector();
        let spread = [0.78, 0.85, 0.85][branch.level] * rng.between(0.8, 1.2);
        let grown = (direction + out * spread + DVec3::Y * 0.10).normalize();
        let child = Branch {
            from,
            direction: grown,
            length: branch.length * [0.66, 0.70, 0.72][branch.level] * rng.between(0.8, 1.12),
            radius: branch.radius * (1.0 - 0.45 * reach) * 0.62,
            level: branch.level + 1,
        };
        add(tree, rng, &child);
    }
}

fn leaf_twigs(tree: &mut Tree, rng: &mut Rng, points: &[DVec3], level: usize) {
    let count = if level == 3 { 17 } else { 9 };
    for _ in 0..count {
        let segment = rng.below(points.len() - 1);
        let foot = points[segment].lerp(points[segment + 1], rng.unit());
        let along = (points[segment + 1] - points[segment]).normalize();
        let out =
            DVec3::new(rng.between(-1.0, 1.0), rng.between(-0.5, 0.9), rng.between(-1.0, 1.0)).normalize_or_zero();
        let direction = (along * 0.5 + out).normalize();
        let side = direction.cross(DVec3::new(rng.between(-0.5, 0.5), 1.0, rng.between(-0.5, 0.5))).normalize_or_zero();
        let size = rng.between(0.19, 0.29);
        tree.leaves.append(card(TWIG, foot, direction * size, side * size * 0.45, DVec2::new(0.0, 0.0)));
    }
}
