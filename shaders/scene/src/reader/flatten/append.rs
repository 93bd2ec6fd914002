//! Writes one instance of a primitive into the scene: applies its transform in f64, and rounds once to f32.

use glam::{DMat3, DMat4, DVec3, Vec2, Vec3, Vec4};

use super::{
    deform::{Deformed, Motion},
    primitive::Geometry,
};
use crate::{
    Aabb, Animation, Draw, LoadReport, Piece, Scene,
    error::SceneError,
    limits::MAX_VERTICES,
    scene::normals::{normal_matrix, repair, triangle_normal},
};

/// Appends one instance of a primitive with its transform to world space, and what moves to its animation.
pub(crate) fn append(
    (geometry, world_from_node): (&Geometry, &DMat4),
    material: u32,
    scene: &mut Scene,
    report: &mut LoadReport,
    moving: Option<(Motion, &mut Animation)>,
) -> Result<(), SceneError> {
    let index = |count: usize| {
        let fault = || SceneError::Limit { what: "vertices".to_owned(), count: count as u64, limit: MAX_VERTICES };
        u32::try_from(count).map_err(|_| fault())
    };
    let linear = DMat3::from_mat4(*world_from_node);
    let mirrored = linear.determinant() < 0.0;
    let local = |position: &Vec3| (world_from_node.transform_point3(position.as_dvec3()) - scene.origin_m).as_vec3();
    let positions: Vec<Vec3> = geometry.positions.iter().map(local).collect();
    let motion = moving.as_ref().map(|(motion, _)| motion);
    let own_geometry = motion.and_then(Motion::deformed).map_or(geometry, |deformed| &deformed.geometry);
    let node_from_own = motion.map(Motion::node_from_own);
    // In the space of what moves it.
    let own: Option<Vec<Vec3>> = node_from_own.map(|node_from_own| {
        let own = |position: &Vec3| node_from_own.transform_point3(position.as_dvec3()).as_vec3();
        own_geometry.positions.iter().map(own).collect()
    });
    // Whether what moves it mirrors in the pose of the file: then corners are clockwise in its own space.
    let clockwise = motion.is_some_and(|motion| motion.mirrors(mirrored));
    let reshaped = motion.is_some_and(|motion| motion.deformed().is_some());
    let (mut own_vertices, mut expanded) = (Own::default(), Vec::new());

    let first_vertex = index(scene.positions.len())?;
    let first_triangle = index(scene.triangles.len())?;
    for triangle in &geometry.triangles {
        // A mirror turns counter-clockwise into clockwise; swapping two corners turns it back (§3.7.4).
        let [a, b, c] = if mirrored { [triangle[0], triangle[2], triangle[1]] } else { *triangle };
        let [Some(pa), Some(pb), Some(pc)] = [a, b, c].map(|corner| positions.get(corner as usize).copied()) else {
            continue;
        };
        let in_own = own.as_ref().map(|own| [a, b, c].map(|at| own.get(at as usize).copied().unwrap_or_default()));
        let own_normal = in_own.map(|[a, b, c]| {
            // Another shape may give it an area.
            let stand_in = || triangle_normal(pa, pb, pc).unwrap_or(DVec3::Y);
            triangle_normal(a, b, c).or_else(|| reshaped.then(stand_in))
        });
        // What moves may have no area in the file's pose: its own space counts.
        let normal = match own_normal {
            Some(own_normal) => own_normal.map(|own| triangle_normal(pa, pb, pc).unwrap_or(own)),
            None => triangle_normal(pa, pb, pc),
        };
        let Some(normal) = normal else {
            report.dropped_triangles += 1;
            continue;
        };
        if geometry.normals.is_some() {
            scene.triangles.push([a, b, c].map(|corner| first_vertex + corner));
            continue;
        }
        let first = index(scene.positions.len())?;
        scene.triangles.push([first, first + 1, first + 2]);
        scene.positions.extend([pa, pb, pc]);
        scene.normals.extend([rounded(normal); 3]);
        if let (Some(corners), Some(Some(normal))) = (in_own, own_normal) {
            own_vertices.positions.extend(corners);
            own_vertices.normals.extend([rounded(if clockwise { -normal } else { normal }); 3]);
        }
        let corners = [a, b, c].map(|corner| corner as usize);
        if reshaped {
            expanded.extend(corners);
        }
        scene.uvs.extend(corners.map(|corner| geometry.uvs.get(corner).copied().unwrap_or_default()));
        let mut vertices = OptionalVertices::of(scene, first as usize);
        if let Some(uvs) = &geometry.uvs_1 {
            vertices.uvs_1(corners.map(|corner| uvs.get(corner).copied().unwrap_or_default()));
        }
        if let Some(colors) = &geometry.colors {
            vertices.colors(corners.map(|corner| colors.get(corner).map_or(WHITE, |color| color16(*color))));
        }
    }
    let kept = scene.triangles.get(first_triangle as usize..).unwrap_or_default();
    if kept.is_empty() {
        return Ok(());
    }
    if let Some(normals) = &geometry.normals {
        let turn = normal_matrix(&linear);
        let world = |normal: &Vec3| (turn * normal.as_dvec3()).try_normalize().map_or(Vec3::ZERO, rounded);
        let mut normals: Vec<Vec3> = normals.iter().map(world).collect();
        let mut repaired = repair(&positions, &mut normals, kept, first_vertex);
        if let (Some(node_from_own), Some(own)) = (&node_from_own, &own) {
            // What has no area in the file's pose is not broken.
            (own_vertices, repaired) = Own::of(own_geometry, own, node_from_own, (kept, first_vertex, clockwise));
        }
        report.repaired_normals += repaired;
        scene.positions.extend(positions);
        scene.normals.extend(normals);
        scene.uvs.extend_from_slice(&geometry.uvs);
        let mut vertices = OptionalVertices::of(scene, first_vertex as usize);
        if let Some(uvs) = &geometry.uvs_1 {
            vertices.uvs_1(uvs.iter().copied());
        }
        if let Some(colors) = &geometry.colors {
            vertices.colors(colors.iter().map(|color| color16(*color)));
        }
        if let Some(tangents) = &geometry.tangents {
            let hand = if mirrored { -1.0 } else { 1.0 };
            vertices.tangents(tangents.iter().map(|tangent| turned(*tangent, &linear, hand)));
        }
    }
    let triangles = index(scene.triangles.len())? - first_triangle;
    scene.draws.push(Draw { first_triangle, triangles, material });
    if let Some((motion, animation)) = moving {
        let vertices = index(scene.positions.len())? - first_vertex;
        let bounds = Aabb::around(&own_vertices.positions);
        let node = match &motion {
            Motion::Rigid(place) => place.node,
            Motion::Deformed(deformed) => deformed.node(animation),
        };
        animation.pieces.push(Piece { node, first_vertex, vertices, bounds, mirrored: clockwise });
        animation.positions.append(&mut own_vertices.positions);
        animation.normals.append(&mut own_vertices.normals);
        // Pieces before may have had none.
        animation.tangents.resize(animation.positions.len() - vertices as usize, Vec4::ZERO);
        animation.tangents.append(&mut own_vertices.tangents);
        animation.tangents.resize(animation.positions.len(), Vec4::ZERO);
        if let Motion::Deformed(deformed) = motion {
            deformed.append(geometry.normals.is_none().then_some(expanded), animation);
        }
    }
    Ok(())
}

impl Motion {
    fn deformed(&self) -> Option<&Deformed> {
        match self {
            Self::Rigid(_) => None,
            Self::Deformed(deformed) => Some(deformed),
        }
    }

    /// Transform from the geometry's space to that which vertices are kept in.
    fn node_from_own(&self) -> DMat4 {
        match self {
            Self::Rigid(place) => place.node_from_own,
            Self::Deformed(_) => DMat4::IDENTITY,
        }
    }

    /// Returns whether it mirrors in the pose of the file, if the transform of the geometry does.
    fn mirrors(&self, mirrored: bool) -> bool {
        match self {
            Self::Rigid(place) => mirrored != (place.node_from_own.determinant() < 0.0),
            Self::Deformed(deformed) => mirrored != deformed.mirrored,
        }
    }
}

/// Vertices in the space of the node that moves them.
#[derive(Default)]
struct Own {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    tangents: Vec<Vec4>,
}

impl Own {
    /// Returns vertices with normals of their own, and how many were broken. `triangles` are the kept ones.
    fn of(
        geometry: &Geometry,
        positions: &[Vec3],
        node_from_own: &DMat4,
        (triangles, first_vertex, clockwise): (&[[u32; 3]], u32, bool),
    ) -> (Self, u64) {
        let linear = DMat3::from_mat4(*node_from_own);
        let turn = normal_matrix(&linear);
        let own = |normal: &Vec3| (turn * normal.as_dvec3()).try_normalize().map_or(Vec3::ZERO, rounded);
        let mut normals: Vec<Vec3> = geometry.normals.iter().flatten().map(own).collect();
        let repaired = if clockwise {
            let swapped: Vec<[u32; 3]> = triangles.iter().map(|[a, b, c]| [*a, *c, *b]).collect();
            repair(positions, &mut normals, &swapped, first_vertex)
        } else {
            repair(positions, &mut normals, triangles, first_vertex)
        };
        let hand = if linear.determinant() < 0.0 { -1.0 } else { 1.0 };
        let tangents = geometry.tangents.iter().flatten().map(|tangent| turned(*tangent, &linear, hand)).collect();
        (Self { positions: positions.to_vec(), normals, tangents }, repaired)
    }
}

/// A unit vector, rounded to f32.
fn rounded(unit: DVec3) -> Vec3 {
    unit.as_vec3().normalize()
}

/// Returns a tangent in world space. All zeros if it has no direction.
fn turned(tangent: Vec4, linear: &DMat3, hand: f32) -> Vec4 {
    let w = if tangent.w < 0.0 { -hand } else { hand };
    (*linear * tangent.truncate().as_dvec3()).try_normalize().map_or(Vec4::ZERO, |unit| rounded(unit).extend(w))
}

/// Rounds a vertex colour. NaN counts as 1.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "rounded, within 0 to 65535")]
fn color16(color: Vec4) -> [u16; 4] {
    color.to_array().map(|v| if v.is_nan() { u16::MAX } else { (v.clamp(0.0, 1.0) * 65535.0).round() as u16 })
}

const WHITE: [u16; 4] = [u16::MAX; 4];

/// Attributes that a scene has only if one of its vertices has them. The vertices before get stand-ins when the first
/// one comes.
struct OptionalVertices<'a> {
    scene: &'a mut Scene,
    before: usize,
}

impl<'a> OptionalVertices<'a> {
    /// For the vertices after the first `before`.
    fn of(scene: &'a mut Scene, before: usize) -> Self {
        Self { scene, before }
    }

    fn uvs_1(&mut self, uvs: impl IntoIterator<Item = Vec2>) {
        self.scene.uvs_1.resize(self.before, Vec2::ZERO);
        self.scene.uvs_1.extend(uvs);
    }

    fn tangents(&mut self, tangents: impl IntoIterator<Item = Vec4>) {
        self.scene.tangents.resize(self.before, Vec4::ZERO);
        self.scene.tangents.extend(tangents);
    }

    fn colors(&mut self, colors: impl IntoIterator<Item = [u16; 4]>) {
        self.scene.colors.resize(self.before, WHITE);
        self.scene.colors.extend(colors);
    }
}

/// Fills optional attributes up to the last vertex, and drops colours that are all white.
pub(crate) fn finish(scene: &mut Scene, animation: &mut Animation) {
    let count = scene.positions.len();
    if scene.tangents.is_empty() {
        animation.tangents = Vec::new();
    }
    if !scene.uvs_1.is_empty() {
        scene.uvs_1.resize(count, Vec2::ZERO);
    }
    if !scene.tangents.is_empty() {
        scene.tangents.resize(count, Vec4::ZERO);
    }
    if scene.colors.iter().all(|color| *color == WHITE) {
        scene.colors = Vec::new();
    } else {
        scene.colors.resize(count, WHITE);
    }
}
