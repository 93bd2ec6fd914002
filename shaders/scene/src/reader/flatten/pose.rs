//! Morph targets and skins, in the pose of the file (glTF 2.0, §3.7.2.2 and §3.7.3). Everything is computed in f64.

use std::{
    borrow::Cow,
    collections::{HashMap, hash_map::Entry},
};

use glam::{DMat3, DMat4, DVec3, DVec4, Vec3, Vec4};
use gltf::json::{Index, mesh::Semantic};

use super::{
    accessor,
    primitive::{Geometry, Source},
};
use crate::{
    LoadReport,
    error::{SceneError, place},
    moment::normal_matrix,
    reader::{
        checks::layout::Layout,
        file::buffers::Buffers,
        json::{Document, JOINTS, Target},
        report::WarningKind,
    },
};

/// How one node poses its mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Pose {
    pub(crate) node: usize,
    pub(crate) skinned: bool,
    /// Whether a morph target has a weight other than 0.
    pub(crate) morphed: bool,
}

/// World transforms that skins give their joints: those of the nodes, times the inverse bind matrices.
#[derive(Default)]
pub(crate) struct Joints(HashMap<usize, Option<Vec<DMat4>>>);

impl Pose {
    /// Returns a node's pose. `None` if it shows its mesh as it is.
    pub(crate) fn of(document: &Document, node: usize) -> Option<Self> {
        let skinned = document.json.nodes.get(node)?.skin.is_some();
        let mesh = document.json.nodes.get(node)?.mesh?.value();
        let morphed = document.targets.get(mesh)?.iter().any(|targets| !targets.is_empty())
            && weights(document, node).iter().any(|weight| *weight != 0.0);
        (skinned || morphed).then_some(Self { node, skinned, morphed })
    }

    /// Returns how many times posing goes through a primitive's vertices, at most.
    pub(crate) fn passes(&self, document: &Document, targets: usize) -> u64 {
        let weights = weights(document, self.node).iter().take(targets).filter(|weight| **weight != 0.0).count();
        weights as u64 + if self.skinned { u64::from(JOINTS.end) } else { 0 }
    }

    /// Returns a primitive's geometry in this pose, and its transform to world space, which is `world_from_node`
    /// unless joints move it.
    /// Errors if bytes are not there.
    pub(crate) fn apply<'g>(
        &self,
        source: &Source<'_>,
        targets: &[Target],
        geometry: &'g Geometry,
        world_from_node: DMat4,
        joints: Option<&[DMat4]>,
        report: &mut LoadReport,
    ) -> Result<(Cow<'g, Geometry>, DMat4), SceneError> {
        let mut posed = Cow::Borrowed(geometry);
        if self.morphed {
            for (target, weight) in targets.iter().zip(weights(source.document, self.node)) {
                if *weight != 0.0 && weight.is_finite() {
                    morph(source, *target, f64::from(*weight), posed.to_mut(), report)?;
                }
            }
        }
        let Some(joints) = joints.filter(|_| self.skinned) else { return Ok((posed, world_from_node)) };
        match blended(source, geometry.positions.len(), joints, report)? {
            Some(matrices) => {
                let around = joints.first().map_or(DVec3::ZERO, |joint| joint.w_axis.truncate());
                skin(posed.to_mut(), &matrices, around);
                Ok((posed, DMat4::from_translation(around)))
            }
            None => Ok((posed, world_from_node)),
        }
    }
}

/// The weights of a node's morph targets: its own, or else its mesh's.
fn weights(document: &Document, node: usize) -> &[f32] {
    let Some(node) = document.json.nodes.get(node) else { return &[] };
    let mesh = || node.mesh.and_then(|mesh| document.json.get(mesh)).and_then(|mesh| mesh.weights.as_deref());
    node.weights.as_deref().or_else(mesh).unwrap_or(&[])
}

/// Adds a morph target's share.
fn morph(
    source: &Source<'_>,
    target: Target,
    weight: f64,
    geometry: &mut Geometry,
    report: &mut LoadReport,
) -> Result<(), SceneError> {
    let count = geometry.positions.len();
    let mut differences = |accessor: Option<u32>| match accessor {
        Some(accessor) => source.elements::<3>(Index::new(accessor), count, report),
        None => Ok(None),
    };
    let moved = |at: Vec3, by: [f32; 3]| (at.as_dvec3() + Vec3::from_array(by).as_dvec3() * weight).as_vec3();
    if let Some(by) = differences(target.position)? {
        for (at, by) in geometry.positions.iter_mut().zip(by) {
            let there = moved(*at, by);
            *at = if there.is_finite() { there } else { *at };
        }
    }
    if let (Some(normals), Some(by)) = (&mut geometry.normals, differences(target.normal)?) {
        normals.iter_mut().zip(by).for_each(|(at, by)| *at = moved(*at, by));
    }
    if let (Some(tangents), Some(by)) = (&mut geometry.tangents, differences(target.tangent)?) {
        tangents.iter_mut().zip(by).for_each(|(at, by)| *at = moved(at.truncate(), by).extend(at.w));
    }
    if let (Some(colors), Some(accessor)) = (&mut geometry.colors, target.color) {
        let wide = Layout::new(&source.document.json, accessor as usize)?.shape.multiplicity() > 3;
        let by: Option<Vec<[f32; 4]>> = if wide {
            source.elements(Index::new(accessor), count, report)?
        } else {
            let by = source.elements::<3>(Index::new(accessor), count, report)?;
            by.map(|by| by.into_iter().map(|[r, g, b]| [r, g, b, 0.0]).collect())
        };
        for (at, by) in colors.iter_mut().zip(by.into_iter().flatten()) {
            *at = (at.as_dvec4() + Vec4::from_array(by).as_dvec4() * weight).as_vec4();
        }
    }
    Ok(())
}

/// Returns each vertex's transform to world space: the mean of its joints', by weight. `None` if the primitive names no
/// joints. Weights are normalised; a vertex without any follows the first joint that it names.
fn blended(
    source: &Source<'_>,
    vertices: usize,
    joints: &[DMat4],
    report: &mut LoadReport,
) -> Result<Option<Vec<DMat4>>, SceneError> {
    let mut sums: Vec<(DMat4, f64)> = Vec::new();
    let mut first = Vec::new();
    for set in JOINTS {
        let names = source.optional::<4>(Semantic::Joints(set), vertices, report)?;
        let weights = source.optional::<4>(Semantic::Weights(set), vertices, report)?;
        let (Some(names), Some(weights)) = (names, weights) else { continue };
        if sums.is_empty() {
            sums = vec![(DMat4::ZERO, 0.0); vertices];
            first = names.iter().map(|[name, ..]| joint(joints, *name).unwrap_or(DMat4::IDENTITY)).collect();
        }
        let mut strange = 0;
        for ((sum, names), weights) in sums.iter_mut().zip(names).zip(weights) {
            for (name, weight) in names.into_iter().zip(weights) {
                if weight == 0.0 {
                    continue;
                }
                match joint(joints, name).filter(|_| weight > 0.0 && weight.is_finite()) {
                    Some(matrix) => {
                        sum.0 += matrix * f64::from(weight);
                        sum.1 += f64::from(weight);
                    }
                    None => strange += 1,
                }
            }
        }
        report.add(WarningKind::LeftOut, "joints that a skin has not, or weights below 0", source.place, strange);
    }
    if sums.is_empty() {
        report.left_out("a skin without joints or weights at the vertices", source.place);
        return Ok(None);
    }
    let mean = |((sum, weight), first)| if weight > 0.0 { sum * (1.0 / weight) } else { first };
    Ok(Some(sums.into_iter().zip(first).map(mean).collect()))
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "indices of at most 16 bits")]
fn joint(joints: &[DMat4], name: f32) -> Option<DMat4> {
    joints.get(name as usize).copied()
}

/// Moves vertices by their transforms, to positions around a point of the world.
fn skin(geometry: &mut Geometry, matrices: &[DMat4], around: DVec3) {
    let mirrored = matrices.first().is_some_and(|matrix| DMat3::from_mat4(*matrix).determinant() < 0.0);
    for (position, matrix) in geometry.positions.iter_mut().zip(matrices) {
        *position = (matrix.transform_point3(position.as_dvec3()) - around).as_vec3();
    }
    for (normal, matrix) in geometry.normals.iter_mut().flatten().zip(matrices) {
        let normal_to_world = normal_matrix(&DMat3::from_mat4(*matrix));
        *normal = (normal_to_world * normal.as_dvec3()).try_normalize().map_or(Vec3::ZERO, DVec3::as_vec3);
    }
    for (tangent, matrix) in geometry.tangents.iter_mut().flatten().zip(matrices) {
        let turned = matrix.transform_vector3(tangent.truncate().as_dvec3());
        let w = if mirrored { -tangent.w } else { tangent.w };
        *tangent = turned.try_normalize().map_or(Vec3::ZERO, DVec3::as_vec3).extend(w);
    }
    if mirrored {
        geometry.triangles.iter_mut().for_each(|[_, b, c]| std::mem::swap(b, c));
    }
}

impl Joints {
    /// Returns the joints of a node's skin. `None`, with a warning, if it has none that can be used.
    /// Errors if bytes are not there.
    pub(crate) fn of(
        &mut self,
        document: &Document,
        buffers: &Buffers<'_>,
        worlds: &[DMat4],
        node: usize,
        report: &mut LoadReport,
    ) -> Result<Option<&[DMat4]>, SceneError> {
        let Some(skin) = document.json.nodes.get(node).and_then(|node| node.skin) else { return Ok(None) };
        let index = skin.value();
        let joints = match self.0.entry(index) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(unknown) => unknown.insert(read(document, buffers, worlds, index)?),
        };
        let joints = joints.as_deref();
        if joints.is_none() {
            report.left_out("a skin without joints, or whose joints overflow", &place("skin", index, None));
        }
        Ok(joints)
    }
}

fn read(
    document: &Document,
    buffers: &Buffers<'_>,
    worlds: &[DMat4],
    skin: usize,
) -> Result<Option<Vec<DMat4>>, SceneError> {
    let Some(skin) = document.skins.get(skin).filter(|skin| !skin.joints.is_empty()) else { return Ok(None) };
    let binds: Vec<[f32; 16]> = match skin.inverse_bind_matrices {
        Some(index) => accessor::vectors(&document.json, buffers, Index::new(index))?,
        None => Vec::new(),
    };
    let bind = |number: usize| match binds.get(number) {
        Some(bind) => {
            let columns = [0, 4, 8, 12].map(|at| {
                let column = |row: usize| f64::from(bind.get(at + row).copied().unwrap_or_default());
                DVec4::new(column(0), column(1), column(2), if at == 12 { 1.0 } else { 0.0 })
            });
            DMat4::from_cols(columns[0], columns[1], columns[2], columns[3])
        }
        None => DMat4::IDENTITY,
    };
    let joints = skin.joints.iter().enumerate();
    let joints = joints.map(|(number, joint)| worlds.get(*joint as usize).map(|world| *world * bind(number)));
    Ok(joints.collect::<Option<Vec<_>>>().filter(|joints| joints.iter().all(DMat4::is_finite)))
}
