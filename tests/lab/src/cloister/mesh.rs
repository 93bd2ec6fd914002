//! Meshes: a soup of triangles to model with, and the welded, smoothed mesh made from it.
//!
//! Builders only make corners with a position and a texture coordinate. [`Soup::weld`] rounds positions, drops
//! triangles without area, smooths normals across edges flatter than a crease angle, and shares equal vertices.

use std::collections::HashMap;

use glam::{DAffine3, DVec2, DVec3, Vec2, Vec3};

/// Positions are rounded to this, in metres, so that last-bit differences of maths libraries do not reach the file.
const GRID_M: f64 = 1.0 / 65536.0;
/// Triangles below this area are dropped, in square metres.
const MIN_AREA_M2: f64 = 1e-9;

/// A corner of a triangle: position in metres and texture coordinate.
pub(crate) type Corner = (DVec3, DVec2);

/// Triangles without shared vertices, counter-clockwise seen from outside.
#[derive(Debug, Clone, Default)]
pub(crate) struct Soup {
    triangles: Vec<[Corner; 3]>,
}

#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Mesh {
    pub(crate) positions: Vec<Vec3>,
    pub(crate) normals: Vec<Vec3>,
    pub(crate) uvs: Vec<Vec2>,
    pub(crate) indices: Vec<u32>,
}

impl Soup {
    pub(crate) fn triangle(&mut self, a: Corner, b: Corner, c: Corner) {
        self.triangles.push([a, b, c]);
    }

    /// Adds a four-sided patch, corners counter-clockwise.
    pub(crate) fn quad(&mut self, a: Corner, b: Corner, c: Corner, d: Corner) {
        self.triangle(a, b, c);
        self.triangle(a, c, d);
    }

    /// Adds a grid of `columns` × `rows` quads. Seen from outside, columns go right and rows go up.
    pub(crate) fn grid(&mut self, columns: usize, rows: usize, corner: impl Fn(usize, usize) -> Corner) {
        for row in 0..rows {
            for column in 0..columns {
                self.quad(
                    corner(column, row),
                    corner(column + 1, row),
                    corner(column + 1, row + 1),
                    corner(column, row + 1),
                );
            }
        }
    }

    pub(crate) fn append(&mut self, other: Self) {
        self.triangles.extend(other.triangles);
    }

    /// Transforms the soup. A mirroring transform keeps front faces outside.
    pub(crate) fn placed(&self, placement: DAffine3) -> Self {
        let mirrored = placement.matrix3.determinant() < 0.0;
        let place = |(position, uv): Corner| (placement.transform_point3(position), uv);
        let triangles = self
            .triangles
            .iter()
            .map(|&[a, b, c]| if mirrored { [place(a), place(c), place(b)] } else { [place(a), place(b), place(c)] });
        Self { triangles: triangles.collect() }
    }

    pub(crate) fn moved(&self, by: DVec3) -> Self {
        self.placed(DAffine3::from_translation(by))
    }

    /// Maps every position.
    pub(crate) fn bent(mut self, bend: impl Fn(DVec3) -> DVec3) -> Self {
        for corner in self.triangles.iter_mut().flatten() {
            corner.0 = bend(corner.0);
        }
        self
    }

    /// Maps every texture coordinate.
    pub(crate) fn with_uv(mut self, change: impl Fn(DVec2) -> DVec2) -> Self {
        for corner in self.triangles.iter_mut().flatten() {
            corner.1 = change(corner.1);
        }
        self
    }

    /// Gives each triangle texture coordinates by projection along its main axis; `metres` is the texture's size.
    pub(crate) fn box_mapped(mut self, metres: f64) -> Self {
        for triangle in &mut self.triangles {
            let [a, b, c] = triangle.map(|corner| corner.0);
            let n = (b - a).cross(c - a).abs();
            for corner in triangle {
                let p = corner.0;
                let uv = if n.y >= n.x && n.y >= n.z {
                    DVec2::new(p.x, p.z)
                } else if n.x > n.z {
                    DVec2::new(p.z, -p.y)
                } else {
                    DVec2::new(p.x, -p.y)
                };
                corner.1 = uv / metres;
            }
        }
        self
    }

    /// Returns the finished mesh. Edges whose faces meet at less than `crease_deg` are smooth.
    pub(crate) fn weld(&self, crease_deg: f64) -> Mesh {
        let rounded = self.triangles.iter().map(|triangle| triangle.map(|(p, uv)| ((p / GRID_M).round() * GRID_M, uv)));
        let faces: Vec<([Corner; 3], DVec3)> = rounded
            .map(|t| (t, (t[1].0 - t[0].0).cross(t[2].0 - t[0].0)))
            .filter(|(_, area)| area.length() * 0.5 > MIN_AREA_M2)
            .collect();
        let mut around: HashMap<[u64; 3], Vec<usize>> = HashMap::new();
        for (index, (triangle, _)) in faces.iter().enumerate() {
            for corner in triangle {
                around.entry(position_key(corner.0)).or_default().push(index);
            }
        }
        let limit = crease_deg.to_radians().cos();
        let mut mesh = Mesh::default();
        let mut shared: HashMap<[u32; 8], u32> = HashMap::new();
        for (triangle, area) in &faces {
            let own = area.normalize();
            for corner in triangle {
                let mut normal = DVec3::ZERO;
                for &face in around.get(&position_key(corner.0)).into_iter().flatten() {
                    let (other, other_area) = &faces[face];
                    if other_area.normalize().dot(own) >= limit {
                        normal += other_area.normalize() * corner_angle(other, corner.0);
                    }
                }
                let normal = normal.try_normalize().unwrap_or(own);
                mesh.push(&mut shared, corner.0, normal, corner.1);
            }
        }
        mesh
    }
}

impl Mesh {
    fn push(&mut self, shared: &mut HashMap<[u32; 8], u32>, position: DVec3, normal: DVec3, uv: DVec2) {
        // + 0.0 makes −0 into 0, so that equal vertices have equal bits.
        let position = position.as_vec3() + 0.0;
        let normal = ((normal * 16384.0).round() / 16384.0).as_vec3() + 0.0;
        let uv = ((uv * 16384.0).round() / 16384.0).as_vec2() + 0.0;
        let key = [position.x, position.y, position.z, normal.x, normal.y, normal.z, uv.x, uv.y].map(f32::to_bits);
        let next = u32::try_from(self.positions.len()).unwrap_or(u32::MAX);
        let index = *shared.entry(key).or_insert(next);
        if index == next {
            self.positions.push(position);
            self.normals.push(normal);
            self.uvs.push(uv);
        }
        self.indices.push(index);
    }

    pub(crate) fn triangle_count(&self) -> usize {
        self.indices.len() / 3
    }
}

fn position_key(position: DVec3) -> [u64; 3] {
    (position + 0.0).to_array().map(f64::to_bits)
}

/// The angle of a triangle at one of its corners, in radians.
fn corner_angle(triangle: &[Corner; 3], at: DVec3) -> f64 {
    let mut others = triangle.iter().map(|corner| corner.0).filter(|&p| p != at);
    match (others.next(), others.next()) {
        (Some(a), Some(b)) => (a - at).angle_between(b - at),
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner(x: f64, y: f64, z: f64) -> Corner {
        (DVec3::new(x, y, z), DVec2::ZERO)
    }

    fn roof(rise: f64) -> Soup {
        let mut soup = Soup::default();
        soup.quad(corner(-1.0, 0.0, 1.0), corner(0.0, rise, 1.0), corner(0.0, rise, 0.0), corner(-1.0, 0.0, 0.0));
        soup.quad(corner(0.0, rise, 1.0), corner(1.0, 0.0, 1.0), corner(1.0, 0.0, 0.0), corner(0.0, rise, 0.0));
        soup
    }

    #[test]
    fn flat_edges_share_their_vertices_and_sharp_ones_do_not() {
        assert_eq!(roof(0.1).weld(30.0).positions.len(), 6);
        assert_eq!(roof(1.0).weld(30.0).positions.len(), 8);
    }

    #[test]
    fn triangles_without_area_are_dropped() {
        let mut soup = roof(0.1);
        soup.triangle(corner(0.0, 0.0, 0.0), corner(1.0, 0.0, 0.0), corner(2.0, 0.0, 0.0));
        assert_eq!(soup.weld(30.0).triangle_count(), 4);
    }

    #[test]
    fn a_mirrored_soup_keeps_its_outside() {
        let mirrored = roof(0.1).placed(DAffine3::from_scale(DVec3::new(1.0, 1.0, -1.0))).weld(30.0);
        assert!(mirrored.normals.iter().all(|n| n.y > 0.9));
    }
}
