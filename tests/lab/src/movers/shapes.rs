//! What movers look like: closed shapes with a known number of triangles.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};

use crate::cloister::mesh::Mesh;

/// Returns a closed ellipsoid of 2 · `sectors` · (`rings` − 1) triangles.
pub(super) fn ellipsoid(centre: Vec3, half: Vec3, (sectors, rings): (u32, u32)) -> Mesh {
    let mut unit = vec![Vec3::Y];
    for ring in 1..rings {
        let (sine, height) = (PI * ring as f32 / rings as f32).sin_cos();
        for sector in 0..sectors {
            let (z, x) = (TAU * sector as f32 / sectors as f32).sin_cos();
            unit.push(Vec3::new(x * sine, height, z * sine));
        }
    }
    unit.push(Vec3::NEG_Y);
    let at = |ring: u32, sector: u32| match ring {
        0 => 0,
        ring if ring == rings => 1 + (rings - 1) * sectors,
        _ => 1 + (ring - 1) * sectors + sector % sectors,
    };
    let mut indices = Vec::new();
    for ring in 0..rings {
        for sector in 0..sectors {
            let [a, b] = [at(ring, sector), at(ring, sector + 1)];
            let [c, d] = [at(ring + 1, sector), at(ring + 1, sector + 1)];
            if ring > 0 {
                indices.extend([a, b, d]);
            }
            if ring + 1 < rings {
                indices.extend([a, d, c]);
            }
        }
    }
    Mesh {
        positions: unit.iter().map(|at| centre + *at * half).collect(),
        normals: unit.iter().map(|at| (*at / half).normalize()).collect(),
        uvs: vec![Vec2::ZERO; unit.len()],
        indices,
    }
}

/// Returns a closed box whose faces are grids of so many cells along x, y and z.
pub(super) fn cuboid(low: Vec3, high: Vec3, cells: [u32; 3]) -> Mesh {
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        let (across, along) = ((axis + 1) % 3, (axis + 2) % 3);
        for (outside, normal) in [(low[axis], -1.0), (high[axis], 1.0)] {
            let first = u32::try_from(mesh.positions.len()).unwrap_or(u32::MAX);
            let (columns, rows) = (cells[across], cells[along]);
            for row in 0..=rows {
                for column in 0..=columns {
                    let share = Vec2::new(column as f32 / columns as f32, row as f32 / rows as f32);
                    let mut at = Vec3::ZERO;
                    at[axis] = outside;
                    at[across] = low[across] + (high[across] - low[across]) * share.x;
                    at[along] = low[along] + (high[along] - low[along]) * share.y;
                    let mut out = Vec3::ZERO;
                    out[axis] = normal;
                    mesh.positions.push(at);
                    mesh.normals.push(out);
                    mesh.uvs.push(share);
                }
            }
            for row in 0..rows {
                for column in 0..columns {
                    let a = first + row * (columns + 1) + column;
                    let [b, c, d] = [a + 1, a + columns + 2, a + columns + 1];
                    mesh.indices.extend(if normal > 0.0 { [a, b, c, a, c, d] } else { [a, c, b, a, d, c] });
                }
            }
        }
    }
    mesh
}

/// Returns a fan of leaves around the x axis, turned out of its plane, each with a whole picture.
pub(super) fn fan(leaves: u8, from: f32, to: f32) -> Mesh {
    let mut mesh = Mesh::default();
    for leaf in 0..leaves {
        let outwards = glam::Quat::from_rotation_x(TAU * f32::from(leaf) / f32::from(leaves)) * Vec3::Y;
        let wide = (outwards.cross(Vec3::X) + Vec3::X * 0.5).normalize() * (to - from) * 0.3;
        let first = u32::try_from(mesh.positions.len()).unwrap_or(u32::MAX);
        for (u, v) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            mesh.positions.push(outwards * (from + (to - from) * v) + wide * (2.0 * u - 1.0));
            mesh.normals.push(wide.cross(outwards).normalize());
            mesh.uvs.push(Vec2::new(u, v));
        }
        mesh.indices.extend([0, 1, 2, 0, 2, 3].map(|corner| first + corner));
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six times the volume, in the direction of the front faces.
    fn volume(mesh: &Mesh) -> f32 {
        let corners = mesh.indices.as_chunks::<3>().0.iter();
        corners.map(|face| face.map(|at| mesh.positions[at as usize])).map(|[a, b, c]| a.dot(b.cross(c))).sum()
    }

    #[test]
    fn closed_shapes_face_outwards() {
        let ball = ellipsoid(Vec3::splat(5.0), Vec3::ONE, (25, 21));
        assert_eq!(ball.triangle_count(), 1000);
        assert!((24.0..25.13).contains(&volume(&ball)), "{}", volume(&ball));
        let door = cuboid(Vec3::new(0.0, 0.0, -0.1), Vec3::new(1.0, 2.0, 0.1), [6, 20, 5]);
        assert_eq!(door.triangle_count(), 1000);
        assert!((volume(&door) - 2.4).abs() < 1e-4, "{}", volume(&door));
        let sides = fan(8, 0.2, 1.0);
        let [a, b, c] = [0, 1, 2].map(|corner| sides.positions[sides.indices[corner] as usize]);
        assert!((b - a).cross(c - a).dot(sides.normals[0]) > 0.0);
    }
}
