//! What moves, evaluated by the referee's own code: points are taken through the nodes one by one, rotations by their
//! axis, splines by Bézier's control points. It shares the data with `gnomon_scene::Scene::moment`, and nothing else.

use std::collections::HashMap;

use glam::{DQuat, DVec3, DVec4};
use gnomon_scene::{AnimatedLight, Animation, Interpolation, Light, LightKind, Piece, Scene, Track};

use super::shape::Reshaped;

/// A scene's animation at one time.
pub(super) struct Animated<'a> {
    scene: &'a Scene,
    animation: &'a Animation,
    time_s: f64,
    /// Pieces that change their shape, by index.
    shapes: HashMap<usize, Reshaped<'a>>,
}

/// A vertex that moves.
pub(super) struct Vertex {
    /// In the scene's local space, not rounded.
    pub(super) position: DVec3,
    pub(super) normal: DVec3,
}

impl<'a> Animated<'a> {
    pub(super) fn new(scene: &'a Scene, time_s: f64) -> Option<Self> {
        scene.animation.as_deref().map(|animation| {
            let mut animated = Self { scene, animation, time_s, shapes: HashMap::new() };
            let node = |node, point| animated.point(node, point);
            let shapes = Reshaped::all(animation, node, |track| animated.value::<1>(track)[0]);
            animated.shapes = shapes.into_iter().collect();
            animated
        })
    }

    /// Returns the piece that a triangle belongs to.
    pub(super) fn piece(&self, corners: [u32; 3]) -> Option<usize> {
        let holds = |piece: &Piece| (piece.first_vertex..piece.first_vertex + piece.vertices).contains(&corners[0]);
        self.animation.pieces.iter().position(holds)
    }

    pub(super) fn is_shown(&self, piece: usize) -> bool {
        let mut node = Some(self.animation.pieces[piece].node);
        while let Some(index) = node {
            let here = &self.animation.nodes[index as usize];
            let shown = here.visible_track.as_ref().map_or(here.visible, |track| self.value::<1>(track) != [0.0]);
            if !shown {
                return false;
            }
            node = here.parent;
        }
        true
    }

    /// Returns whether two corners of the piece's triangles change places.
    pub(super) fn is_turned(&self, piece: usize) -> bool {
        if let Some(reshaped) = self.shapes.get(&piece) {
            return reshaped.mirrors() != self.animation.pieces[piece].mirrored;
        }
        let piece = &self.animation.pieces[piece];
        let [x, y, z] = DVec3::AXES.map(|axis| self.vector(piece.node, axis));
        (x.cross(y).dot(z) < 0.0) != piece.mirrored
    }

    pub(super) fn vertex(&self, piece: usize, vertex: u32) -> Vertex {
        if let Some(reshaped) = self.shapes.get(&piece) {
            let own = vertex - self.animation.pieces[piece].first_vertex;
            let (position, normal) = reshaped.vertex(own as usize, self.is_turned(piece));
            return Vertex { position: position - self.scene.origin_m, normal };
        }
        let before = self.animation.pieces[..piece].iter().map(|piece| piece.vertices).sum::<u32>();
        let piece = &self.animation.pieces[piece];
        let at = (before + vertex - piece.first_vertex) as usize;
        let position = self.point(piece.node, self.animation.positions[at].as_dvec3()) - self.scene.origin_m;
        // Across two directions in the surface, which move as points do.
        let (along, across) = self.animation.normals[at].as_dvec3().any_orthonormal_pair();
        let [along, across] = [along, across].map(|tangent| self.vector(piece.node, tangent));
        let [x, y, z] = DVec3::AXES.map(|axis| self.vector(piece.node, axis));
        Vertex { position, normal: along.cross(across) * x.cross(y).dot(z).signum() }
    }

    pub(super) fn lights(&self) -> Vec<Light> {
        let mut lights = self.scene.lights.clone();
        for moving in &self.animation.lights {
            self.move_light(&mut lights[moving.light as usize], moving);
        }
        lights
    }

    #[expect(clippy::cast_possible_truncation, reason = "lights are f32")]
    fn move_light(&self, light: &mut Light, moving: &AnimatedLight) {
        let value = |track: &Option<Track>| track.as_ref().map(|track| self.value::<1>(track)[0].max(0.0) as f32);
        if let Some(track) = &moving.color_track {
            light.color = DVec3::from_array(self.value(track)).max(DVec3::ZERO).as_vec3();
        }
        light.intensity = value(&moving.intensity_track).unwrap_or(light.intensity);
        light.range_m = value(&moving.range_track).unwrap_or(light.range_m);
        if let LightKind::Spot { inner_cone_rad, outer_cone_rad } = &mut light.kind {
            *outer_cone_rad = value(&moving.outer_cone_track).unwrap_or(*outer_cone_rad);
            *inner_cone_rad = value(&moving.inner_cone_track).unwrap_or(*inner_cone_rad).min(*outer_cone_rad);
        }
        let Some(place) = moving.place else { return };
        let at = |point: DVec3| self.point(place.node, place.node_from_own.transform_point3(point));
        light.position = (at(DVec3::ZERO) - self.scene.origin_m).as_vec3();
        light.direction = (at(DVec3::NEG_Z) - at(DVec3::ZERO)).as_vec3().normalize();
    }

    /// Takes a point of a node's space to the world's.
    fn point(&self, node: u32, point: DVec3) -> DVec3 {
        let mut point = point;
        let mut next = Some(node);
        while let Some(index) = next {
            let here = &self.animation.nodes[index as usize];
            let vector = |track: &Option<Track>, fixed| {
                track.as_ref().map_or(fixed, |track| DVec3::from_array(self.value(track)))
            };
            let turned = here.rotation_track.as_ref().map_or(here.rotation, |track| self.rotation(track));
            let scaled = point * vector(&here.scale_track, here.scale);
            point = turned * scaled + vector(&here.translation_track, here.translation_m);
            point = here.above.transform_point3(point);
            next = here.parent;
        }
        point
    }

    fn vector(&self, node: u32, vector: DVec3) -> DVec3 {
        self.point(node, vector) - self.point(node, DVec3::ZERO)
    }

    fn value<const N: usize>(&self, track: &Track) -> [f64; N] {
        let (first, second, share, step_s) = self.keys::<N>(track);
        if share == 0.0 || track.interpolation == Interpolation::Step {
            return first[1];
        }
        std::array::from_fn(|i| {
            let (from, to) = (first[1][i], second[1][i]);
            if track.interpolation == Interpolation::Linear {
                return from + (to - from) * share;
            }
            let mut control = [from, from + first[2][i] * step_s / 3.0, to - second[0][i] * step_s / 3.0, to];
            for left in (1..4).rev() {
                for place in 0..left {
                    control[place] += (control[place + 1] - control[place]) * share;
                }
            }
            control[0]
        })
    }

    fn rotation(&self, track: &Track) -> DQuat {
        let unit = |value| DQuat::from_vec4(DVec4::from_array(value).normalize());
        let (first, second, share, _) = self.keys::<4>(track);
        if share == 0.0 || track.interpolation != Interpolation::Linear {
            return unit(self.value(track));
        }
        let (from, to) = (unit(first[1]), unit(second[1]));
        let (axis, angle) = (from.inverse() * to).to_axis_angle();
        let turn = std::f64::consts::TAU;
        // The other way round is shorter.
        let angle = if angle > turn / 2.0 { angle - turn } else { angle };
        from * DQuat::from_axis_angle(axis, angle * share)
    }

    /// Returns two keys as in-tangent, value and out-tangent, how far the time is between them, and how long that
    /// takes.
    fn keys<const N: usize>(&self, track: &Track) -> ([[f64; N]; 3], [[f64; N]; 3], f64, f64) {
        let cubic = track.interpolation == Interpolation::CubicSpline;
        let key = |number: usize| -> [[f64; N]; 3] {
            let element = |element: usize| {
                let first = N * if cubic { 3 * number + element } else { number };
                std::array::from_fn(|i| f64::from(track.values[first + i]))
            };
            [element(0), element(1), element(2)]
        };
        let period_s = track.period_s;
        let time_s = if period_s > 0.0 { self.time_s - period_s * (self.time_s / period_s).floor() } else { 0.0 };
        let last = track.times_s.len() - 1;
        let before = (0..=last).rev().find(|number| f64::from(track.times_s[*number]) <= time_s);
        match before {
            None => (key(0), key(0), 0.0, 0.0),
            Some(before) if before == last => (key(last), key(last), 0.0, 0.0),
            Some(before) => {
                let from_s = f64::from(track.times_s[before]);
                let step_s = f64::from(track.times_s[before + 1]) - from_s;
                (key(before), key(before + 1), (time_s - from_s) / step_s, step_s)
            }
        }
    }
}
