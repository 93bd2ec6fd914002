//! Morph targets and skins, in the pose of the file (glTF 2.0, §3.7.2.2 and §3.7.3). Everything is computed in f64.
//! What they are at other times: `deform.rs`.

use std::{
    borrow::Cow,
    collections::{HashMap, hash_map::Entry},
};

use glam::{DMat3, DMat4, DVec3, DVec4, Vec3, Vec4};
use gltf::json::{Index, mesh::Semantic};

use super::{
    accessor,
    channels::Channels,
    nodes::Walk,
    primitive::{Geometry, Source},
};
use crate::{
    Aabb, Influence, Joint, LoadReport,
    error::{SceneError, place},
    reader::{
        checks::layout::Layout,
        file::buffers::Buffers,
        json::{Document, JOINTS, Target},
        report::WarningKind,
    },
    scene::{blended, check_shape::MAX_WEIGHT, normals::normal_matrix},
};

/// How one node poses its mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Pose {
    pub(crate) node: usize,
    pub(crate) skinned: bool,
    /// Whether a morph target has a weight other than 0, at any time.
    pub(crate) morphed: bool,
}

/// A skin in the pose of the file. Its last joint is one more: the world, for vertices that name joints which are not
/// there.
pub(crate) struct Skin {
    /// World transforms that it gives its joints: those of the nodes, times the inverse bind matrices.
    worlds: Vec<DMat4>,
    /// What moves them, without bounds.
    pub(crate) joints: Vec<Joint>,
}

/// The skins that were read. `None`: one that cannot be used.
#[derive(Default)]
pub(crate) struct Skins(HashMap<usize, Option<Skin>>);

/// The joints of a primitive's vertices.
#[derive(Default)]
pub(crate) struct Influences {
    /// How many each vertex has.
    pub(crate) sets: u32,
    /// Those of a vertex follow each other.
    pub(crate) list: Vec<Influence>,
}

/// A primitive's geometry in a pose.
pub(crate) struct Posed<'g> {
    pub(crate) geometry: Cow<'g, Geometry>,
    /// Its transform to world space: that of the node, unless joints move it.
    pub(crate) world: DMat4,
    /// Before joints and changing weights move it, if that was asked for.
    pub(crate) own: Option<Geometry>,
    /// `None` without joints.
    pub(crate) influences: Option<Influences>,
    /// The skin mirrors it.
    pub(crate) mirrored: bool,
}

impl<'g> Posed<'g> {
    /// As the file has it.
    pub(crate) fn unchanged(geometry: &'g Geometry, world: DMat4) -> Self {
        Self { geometry: Cow::Borrowed(geometry), world, own: None, influences: None, mirrored: false }
    }
}

impl Pose {
    /// Returns a node's pose. `None` if it shows its mesh as it is.
    pub(crate) fn of(document: &Document, channels: &Channels, node: usize) -> Option<Self> {
        let skinned = document.json.nodes.get(node)?.skin.is_some();
        let mesh = document.json.nodes.get(node)?.mesh?.value();
        let weights = channels.weights(document, node);
        let morphed = document.targets.get(mesh)?.iter().any(|targets| !targets.is_empty())
            && (weights.track.is_some() || weights.values.iter().any(|weight| *weight != 0.0));
        (skinned || morphed).then_some(Self { node, skinned, morphed })
    }

    /// Returns how many times posing goes through a primitive's vertices, at most.
    pub(crate) fn passes(&self, document: &Document, channels: &Channels, targets: usize) -> u64 {
        let weights = channels.weights(document, self.node);
        let counts = |weight: &&f32| **weight != 0.0;
        let morphs = match weights.track {
            Some(_) => targets,
            None => weights.values.iter().take(targets).filter(counts).count(),
        };
        morphs as u64 + if self.skinned { u64::from(JOINTS.end) } else { 0 }
    }

    /// Returns a primitive's geometry in this pose. `keep` asks for [`Posed::own`], too.
    /// Errors if bytes are not there.
    pub(crate) fn apply<'g>(
        &self,
        (source, channels): (&Source<'_>, &Channels),
        targets: &[Target],
        (geometry, world_from_node): (&'g Geometry, DMat4),
        skin: Option<&Skin>,
        keep: bool,
        report: &mut LoadReport,
    ) -> Result<Posed<'g>, SceneError> {
        let mut posed = Cow::Borrowed(geometry);
        let weights = channels.weights(source.document, self.node);
        if self.morphed {
            for (target, weight) in targets.iter().zip(&*weights.values) {
                if *weight != 0.0 && weight.is_finite() {
                    morph(source, *target, f64::from(*weight), posed.to_mut(), report)?;
                }
            }
        }
        let own = keep.then(|| if weights.track.is_some() { geometry.clone() } else { posed.clone().into_owned() });
        let mut posed = Posed { geometry: posed, own, ..Posed::unchanged(geometry, world_from_node) };
        let Some(skin) = skin.filter(|_| self.skinned) else { return Ok(posed) };
        posed.influences = influences(source, geometry.positions.len(), skin.joints.len() - 1, report)?;
        if let Some(influences) = &posed.influences {
            let around = skin.worlds.first().map_or(DVec3::ZERO, |joint| joint.w_axis.truncate());
            let of_vertices = influences.list.chunks(influences.sets.max(1) as usize);
            let matrices: Vec<DMat4> =
                of_vertices.map(|it| blended(&skin.worlds, it).unwrap_or(DMat4::IDENTITY)).collect();
            posed.mirrored = bend(posed.geometry.to_mut(), &matrices, around);
            posed.world = DMat4::from_translation(around);
        }
        Ok(posed)
    }
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

/// Returns the joints of each vertex. `None` if the primitive names none. Of so many joints, those that are not there
/// count for nothing; a vertex without any weight follows the first joint that it names, or else the world, which is
/// the joint after the last.
fn influences(
    source: &Source<'_>,
    vertices: usize,
    joints: usize,
    report: &mut LoadReport,
) -> Result<Option<Influences>, SceneError> {
    let mut sets = Vec::new();
    for set in JOINTS {
        let names = source.optional::<4>(Semantic::Joints(set), vertices, report)?;
        let weights = source.optional::<4>(Semantic::Weights(set), vertices, report)?;
        let (Some(names), Some(weights)) = (names, weights) else { continue };
        let mut strange = 0;
        let influence = |(names, weights): ([f32; 4], [f32; 4])| {
            let mut influence = Influence::default();
            let places = influence.joints.iter_mut().zip(&mut influence.weights);
            for ((joint, share), (name, weight)) in places.zip(names.into_iter().zip(weights)) {
                if weight == 0.0 {
                    continue;
                }
                match index(name, joints).filter(|_| weight > 0.0 && weight <= MAX_WEIGHT) {
                    Some(index) => (*joint, *share) = (index, weight),
                    None => strange += 1,
                }
            }
            let first = index(names[0], joints);
            (influence, first)
        };
        let set: Vec<(Influence, Option<u16>)> = names.into_iter().zip(weights).map(influence).collect();
        report.add(WarningKind::LeftOut, "joints that a skin has not, or weights below 0", source.place, strange);
        sets.push(set);
    }
    if sets.is_empty() {
        report.left_out("a skin without joints or weights at the vertices", source.place);
        return Ok(None);
    }
    let world = u16::try_from(joints).unwrap_or(u16::MAX);
    let mut list = Vec::with_capacity(vertices * sets.len());
    for vertex in 0..vertices {
        let first = list.len();
        let of_vertex = sets.iter().filter_map(|set| set.get(vertex));
        list.extend(of_vertex.map(|(influence, _)| *influence));
        let unmoved = list.get(first..).unwrap_or_default().iter().all(|it| it.each().next().is_none());
        let named = sets.first().and_then(|set| set.get(vertex)).and_then(|(_, first)| *first);
        if let Some(influence) = list.get_mut(first).filter(|_| unmoved) {
            *influence = Influence { joints: [named.unwrap_or(world), 0, 0, 0], weights: [1.0, 0.0, 0.0, 0.0] };
        }
    }
    Ok(Some(Influences { sets: u32::try_from(sets.len()).unwrap_or(0), list }))
}

/// Returns the number of a joint, of so many.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "indices of at most 16 bits")]
fn index(name: f32, joints: usize) -> Option<u16> {
    let index = name as u16;
    (usize::from(index) < joints && name <= f32::from(u16::MAX)).then_some(index)
}

/// Moves vertices by their transforms, to positions around a point of the world. Returns whether that mirrors them.
fn bend(geometry: &mut Geometry, matrices: &[DMat4], around: DVec3) -> bool {
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
    mirrored
}

impl Skins {
    /// Returns a node's skin. `None`, with a warning, if it has no joints that can be used.
    /// Errors if bytes are not there.
    pub(crate) fn of(
        &mut self,
        document: &Document,
        buffers: &Buffers<'_>,
        walk: &Walk,
        node: usize,
        report: &mut LoadReport,
    ) -> Result<Option<&Skin>, SceneError> {
        let Some(skin) = document.json.nodes.get(node).and_then(|node| node.skin) else { return Ok(None) };
        let index = skin.value();
        let skin = match self.0.entry(index) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(unknown) => unknown.insert(read(document, buffers, walk, index)?),
        };
        if skin.is_none() {
            report.left_out("a skin without joints, or whose joints overflow", &place("skin", index, None));
        }
        Ok(skin.as_ref())
    }
}

fn read(document: &Document, buffers: &Buffers<'_>, walk: &Walk, skin: usize) -> Result<Option<Skin>, SceneError> {
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
    let bounds = Aabb { min: Vec3::ZERO, max: Vec3::ZERO };
    let (mut worlds, mut joints) = (Vec::new(), Vec::new());
    for (number, joint) in skin.joints.iter().enumerate() {
        let Some(world) = walk.worlds.get(*joint as usize) else { return Ok(None) };
        let world = *world * bind(number);
        worlds.push(world);
        joints.push(match walk.places.get(*joint as usize).copied().flatten() {
            Some(place) => Joint { node: Some(place.node), node_from_own: place.node_from_own * bind(number), bounds },
            None => Joint { node: None, node_from_own: world, bounds },
        });
    }
    worlds.push(DMat4::IDENTITY);
    joints.push(Joint { node: None, node_from_own: DMat4::IDENTITY, bounds });
    Ok(Some(Skin { worlds, joints }).filter(|skin| skin.worlds.iter().all(DMat4::is_finite)))
}
