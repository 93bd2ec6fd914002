//! Skins and morph targets, evaluated by the referee's own code: each joint says where it would have a point, and the
//! point lies at the mean of these places. No matrices are mixed.

use glam::DVec3;
use gnomon_scene::{Animation, Joint, Shape, Track};

/// Where a space's origin and the ends of its axes are in the world.
#[derive(Debug, Clone, Copy)]
struct Frame([DVec3; 4]);

impl Frame {
    fn of(place: impl Fn(DVec3) -> DVec3) -> Self {
        Self([DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(place))
    }

    fn vector(&self, vector: DVec3) -> DVec3 {
        let Self([origin, x, y, z]) = *self;
        (x - origin) * vector.x + (y - origin) * vector.y + (z - origin) * vector.z
    }

    fn point(&self, point: DVec3) -> DVec3 {
        self.0[0] + self.vector(point)
    }

    fn mirrors(&self) -> bool {
        let [x, y, z] = DVec3::AXES.map(|axis| self.vector(axis));
        x.cross(y).dot(z) < 0.0
    }
}

/// A piece that changes its shape, at one time.
#[derive(Debug)]
pub(super) struct Reshaped<'a> {
    animation: &'a Animation,
    shape: &'a Shape,
    /// Its first vertex, influence and delta among the animation's.
    first: usize,
    first_influence: usize,
    first_delta: usize,
    vertices: usize,
    /// Where the vertices are without joints.
    frame: Frame,
    joints: Vec<Frame>,
    weights: Vec<f64>,
}

impl<'a> Reshaped<'a> {
    /// Returns the pieces that change their shape, by their indices. `node` takes a point of a node's space to the
    /// world's, `value` evaluates a track of one component.
    pub(super) fn all(
        animation: &'a Animation,
        node: impl Fn(u32, DVec3) -> DVec3,
        value: impl Fn(&Track) -> f64,
    ) -> Vec<(usize, Self)> {
        let (mut influences, mut deltas) = (0, 0);
        let mut all = Vec::new();
        for shape in &animation.shapes {
            let index = shape.piece as usize;
            let piece = &animation.pieces[index];
            let vertices = piece.vertices as usize;
            let node_from_own = shape.node_from_own;
            let frame = |joint: &Joint| {
                let place = |point| joint.node_from_own.transform_point3(point);
                Frame::of(|point| joint.node.map_or(place(point), |joint| node(joint, place(point))))
            };
            let weight = |(at, weight): (usize, f32)| match &shape.weights_track {
                Some(track) => value(&only(track, shape.targets.len(), at)),
                None => f64::from(weight),
            };
            let of_file = shape.targets.iter().map(|target| target.weight);
            all.push((
                index,
                Self {
                    animation,
                    shape,
                    first: animation.pieces[..index].iter().map(|piece| piece.vertices as usize).sum(),
                    first_influence: influences,
                    first_delta: deltas,
                    vertices,
                    frame: Frame::of(|point| node(piece.node, node_from_own.transform_point3(point))),
                    joints: shape.joints.iter().map(frame).collect(),
                    weights: of_file.enumerate().map(weight).collect(),
                },
            ));
            influences += vertices * shape.sets as usize;
            deltas += vertices * shape.targets.len();
        }
        all
    }

    /// Returns whether it is mirrored now.
    pub(super) fn mirrors(&self) -> bool {
        self.frame_of(0).mirrors()
    }

    /// Returns a vertex's position in the world, and its normal, not normalised. `turned` exchanges two corners of each
    /// triangle.
    pub(super) fn vertex(&self, vertex: usize, turned: bool) -> (DVec3, DVec3) {
        let frame = self.frame_of(vertex);
        let (position, normal) = self.morphed(vertex);
        let position = frame.point(position);
        if self.shape.flat {
            let first = vertex - vertex % 3;
            let [a, b, c] = [0, 1, 2].map(|corner| {
                let (position, _) = self.morphed(first + corner);
                self.frame_of(first + corner).point(position)
            });
            let normal = (b - a).cross(c - a);
            return (position, if turned { -normal } else { normal });
        }
        // Across two directions in the surface, which move as points do.
        let (along, across) = normal.normalize().any_orthonormal_pair();
        let normal = frame.vector(along).cross(frame.vector(across));
        (position, if frame.mirrors() { -normal } else { normal })
    }

    fn morphed(&self, vertex: usize) -> (DVec3, DVec3) {
        let at = self.first + vertex;
        let (mut position, mut normal) =
            (self.animation.positions[at].as_dvec3(), self.animation.normals[at].as_dvec3());
        for (target, weight) in self.weights.iter().enumerate() {
            let delta = self.animation.deltas[self.first_delta + target * self.vertices + vertex];
            position += *weight * delta.position.as_dvec3();
            normal += *weight * delta.normal.as_dvec3();
        }
        (position, normal)
    }

    /// Where the joints have a vertex's space, in the mean.
    fn frame_of(&self, vertex: usize) -> Frame {
        let sets = self.shape.sets as usize;
        if sets == 0 {
            return self.frame;
        }
        let first = self.first_influence + vertex * sets;
        let influences = &self.animation.influences[first..first + sets];
        let pairs = || influences.iter().flat_map(|it| it.joints.into_iter().zip(it.weights));
        let sum: f64 = pairs().map(|(_, weight)| f64::from(weight)).sum();
        let mut mean = [DVec3::ZERO; 4];
        for (joint, weight) in pairs().filter(|(_, weight)| *weight > 0.0) {
            let Frame(places) = self.joints[usize::from(joint)];
            mean.iter_mut().zip(places).for_each(|(mean, place)| *mean += place * (f64::from(weight) / sum));
        }
        Frame(mean)
    }
}

/// One of the components of a track.
fn only(track: &Track, width: usize, at: usize) -> Track {
    let values = track.values.chunks(width).map(|element| element[at]).collect();
    Track { values, times_s: track.times_s.clone(), ..*track }
}
