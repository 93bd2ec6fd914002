//! Flattens the placed meshes: applies transforms in f64, recentres, and rounds once to f32.
//!
//! Two passes over the primitives spare an f64 copy of the geometry: the first finds the bounds, and with them the
//! origin; the second writes vertices relative to it.

use glam::{DMat3, DMat4, DVec3, Vec3};
use gltf::json::mesh;

use super::{
    material::Materials,
    nodes::Placed,
    primitive::{self, Geometry, Mode, TextureCoordinates},
};
use crate::{
    Draw, LoadReport, Scene,
    error::{SceneError, place, within},
    limits::{MAX_COORDINATE_M, MAX_DRAWS, MAX_TRIANGLES, MAX_VERTICES, in_reach},
    reader::{file::buffers::Buffers, json::Document},
    scene::normals::{repair, triangle_normal},
};

/// A primitive and its instances.
struct Part<'a> {
    primitive: &'a mesh::Primitive,
    place: String,
    mode: Mode,
    material: u32,
    /// World transforms of its mesh's instances.
    instances: Vec<DMat4>,
}

/// Writes the geometry of `scene` and the materials that it uses.
/// Errors if a primitive is malformed, or the flattened scene goes beyond [`limits`](crate::limits).
pub(crate) fn flatten(
    document: &Document,
    buffers: &Buffers<'_>,
    placed: &[Placed],
    materials: &mut Materials,
    scene: &mut Scene,
    report: &mut LoadReport,
) -> Result<(), SceneError> {
    let parts = parts(document, placed, materials, scene, report)?;
    scene.origin_m = origin(document, buffers, &parts)?;
    // OPAQUE, MASK, BLEND: tracers read a prefix, and the rasteriser sets each state once.
    for order in 0..3 {
        for part in &parts {
            let material = materials.materials.get(part.material as usize);
            if material.map_or(0, |material| material.alpha.order()) != order {
                continue;
            }
            let geometry = read(document, buffers, part)?;
            for world_from_node in &part.instances {
                append(&geometry, world_from_node, part, scene, report)?;
            }
        }
    }
    Ok(())
}

/// Returns the primitives of all placed meshes, and checks their sums against [`limits`](crate::limits).
fn parts<'a>(
    document: &'a Document,
    placed: &[Placed],
    materials: &mut Materials,
    scene: &mut Scene,
    report: &mut LoadReport,
) -> Result<Vec<Part<'a>>, SceneError> {
    let mut instances: Vec<Vec<DMat4>> = vec![Vec::new(); document.json.meshes.len()];
    for at in placed {
        let mesh = document.json.nodes.get(at.node).and_then(|node| node.mesh);
        if let Some(list) = mesh.and_then(|mesh| instances.get_mut(mesh.value())) {
            list.push(at.world_from_node);
            scene.instances = scene.instances.saturating_add(1);
        }
    }
    let mut parts = Vec::new();
    let (mut triangles, mut vertices, mut draws) = (0_u64, 0_u64, 0_u64);
    for ((index, mesh), instances) in document.json.meshes.iter().enumerate().zip(instances) {
        for (number, primitive) in mesh.primitives.iter().enumerate() {
            let place = format!("{}, primitive {number}", place("mesh", index, mesh.name.as_deref()));
            let times = instances.len() as u64;
            let Some(mode) = Mode::of(primitive, &place)? else {
                report.skipped_primitives += times;
                continue;
            };
            let Some(size) = primitive::size(&document.json, primitive, mode, &place)? else {
                report.skipped_primitives += times;
                continue;
            };
            if times == 0 {
                continue;
            }
            report.ignored_morph_targets += primitive.targets.as_ref().map_or(0, Vec::len) as u64;
            // Each factor is bounded, so the products fit.
            triangles += size.triangles * times;
            vertices += size.vertices * times;
            draws += times;
            within("triangles of the scene, shared meshes counted for each instance", triangles, MAX_TRIANGLES)?;
            within("vertices of the scene, shared meshes counted for each instance", vertices, MAX_VERTICES)?;
            within("primitives of the scene, shared meshes counted for each instance", draws, MAX_DRAWS)?;
            let material = materials.get(document, primitive.material)?;
            parts.push(Part { primitive, place, mode, material, instances: instances.clone() });
        }
    }
    let reserve = |count: u64| usize::try_from(count).unwrap_or(0);
    scene.positions.reserve_exact(reserve(vertices));
    scene.normals.reserve_exact(reserve(vertices));
    scene.uvs.reserve_exact(reserve(vertices));
    scene.triangles.reserve_exact(reserve(triangles));
    Ok(parts)
}

fn read(document: &Document, buffers: &Buffers<'_>, part: &Part<'_>) -> Result<Geometry, SceneError> {
    let texture = part.primitive.material.and_then(|index| {
        let info = document.json.get(index)?.pbr_metallic_roughness.base_color_texture.as_ref()?;
        let transform = document.factors.get(index.value())?.texture_transform.as_ref();
        Some(TextureCoordinates::new(info, transform))
    });
    primitive::read(&document.json, buffers, part.primitive, part.mode, texture.as_ref(), &part.place)
}

/// Returns the scene's origin: the centre of its bounds, rounded to a multiple of the smallest power of two above the
/// bounds' longest side. So a scene around the world's origin keeps its coordinates bit for bit, and one far away has
/// local coordinates of at most one and a half times its size.
fn origin(document: &Document, buffers: &Buffers<'_>, parts: &[Part<'_>]) -> Result<DVec3, SceneError> {
    let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for part in parts {
        let geometry = read(document, buffers, part)?;
        for world_from_node in &part.instances {
            for position in &geometry.positions {
                let world = world_from_node.transform_point3(position.as_dvec3());
                if !in_reach(world) {
                    let fault = format!("position {position} lies at {world}, beyond ±{MAX_COORDINATE_M} m");
                    return Err(SceneError::invalid(part.place.as_str(), fault));
                }
                min = min.min(world);
                max = max.max(world);
            }
        }
    }
    let extent = (max - min).max_element();
    // Negated to catch NaN: an empty scene has infinite bounds. A scene of one point ends here too.
    if !(extent > 0.0 && extent.is_finite()) {
        return Ok(if min.is_finite() { min.round() + DVec3::ZERO } else { DVec3::ZERO });
    }
    let step = (extent.log2().floor() + 1.0).exp2();
    // Adding zero turns -0 into 0, which prints better.
    Ok(((min + max) / 2.0 / step).round() * step + DVec3::ZERO)
}

/// Appends one instance of a primitive.
fn append(
    geometry: &Geometry,
    world_from_node: &DMat4,
    part: &Part<'_>,
    scene: &mut Scene,
    report: &mut LoadReport,
) -> Result<(), SceneError> {
    let index = |count: usize| {
        let fault = || SceneError::Limit { what: "vertices".to_owned(), count: count as u64, limit: MAX_VERTICES };
        u32::try_from(count).map_err(|_| fault())
    };
    let linear = DMat3::from_mat4(*world_from_node);
    let mirrored = linear.determinant() < 0.0;
    let local = |position: &Vec3| (world_from_node.transform_point3(position.as_dvec3()) - scene.origin_m).as_vec3();
    let positions: Vec<Vec3> = geometry.positions.iter().map(local).collect();

    let first_vertex = index(scene.positions.len())?;
    let first_triangle = index(scene.triangles.len())?;
    for triangle in &geometry.triangles {
        // A mirror turns counter-clockwise into clockwise; swapping two corners turns it back (§3.7.4).
        let [a, b, c] = if mirrored { [triangle[0], triangle[2], triangle[1]] } else { *triangle };
        let [Some(pa), Some(pb), Some(pc)] = [a, b, c].map(|corner| positions.get(corner as usize).copied()) else {
            continue;
        };
        let Some(normal) = triangle_normal(pa, pb, pc) else {
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
        scene.uvs.extend([a, b, c].map(|corner| geometry.uvs.get(corner as usize).copied().unwrap_or_default()));
    }
    let kept = scene.triangles.get(first_triangle as usize..).unwrap_or_default();
    if kept.is_empty() {
        return Ok(());
    }
    if let Some(normals) = &geometry.normals {
        let turn = normal_matrix(&linear);
        let world = |normal: &Vec3| (turn * normal.as_dvec3()).try_normalize().map_or(Vec3::ZERO, rounded);
        let mut normals: Vec<Vec3> = normals.iter().map(world).collect();
        report.repaired_normals += repair(&positions, &mut normals, kept, first_vertex);
        scene.positions.extend(positions);
        scene.normals.extend(normals);
        scene.uvs.extend_from_slice(&geometry.uvs);
    }
    let triangles = index(scene.triangles.len())? - first_triangle;
    scene.draws.push(Draw { first_triangle, triangles, material: part.material });
    Ok(())
}

/// Returns the inverse transpose of a transform, up to a positive factor: its cofactors, with the sign of its
/// determinant. They exist even if a scale of 0 leaves no inverse.
fn normal_matrix(linear: &DMat3) -> DMat3 {
    let (x, y, z) = (linear.x_axis, linear.y_axis, linear.z_axis);
    let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
    if linear.determinant() < 0.0 { -cofactors } else { cofactors }
}

/// A unit vector, rounded to f32.
fn rounded(unit: DVec3) -> Vec3 {
    unit.as_vec3().normalize()
}
