//! Where each mesh stands: at its nodes, and wherever EXT_mesh_gpu_instancing repeats it.

use glam::{DMat4, DQuat, DVec3};
use gltf::json::Index;
use serde_json::Value;

use super::{accessor, channels::Channels, nodes::Placed, pose::Pose};
use crate::{
    LoadReport, Place,
    error::{SceneError, place, within},
    limits::MAX_DRAWS,
    reader::{checks::layout::Layout, file::buffers::Buffers, json::Document},
};

/// A mesh in the scene.
#[derive(Clone, Copy)]
pub(crate) struct Instance {
    pub(crate) world_from_node: DMat4,
    pub(crate) pose: Option<Pose>,
    /// The animated node that it hangs on. A skinned mesh follows its joints, and not this.
    pub(crate) place: Option<Place>,
}

/// Returns the instances of each mesh, in the order of the nodes.
/// Errors if there are too many, or their transforms cannot be read.
pub(crate) fn collect(
    document: &Document,
    buffers: &Buffers<'_>,
    (placed, channels): (&[Placed], &Channels),
    report: &mut LoadReport,
) -> Result<Vec<Vec<Instance>>, SceneError> {
    let mut instances: Vec<Vec<Instance>> = document.json.meshes.iter().map(|_| Vec::new()).collect();
    let mut total = 0_u64;
    for at in placed {
        let Some(node) = document.json.nodes.get(at.node) else { continue };
        let Some(list) = node.mesh.and_then(|mesh| instances.get_mut(mesh.value())) else { continue };
        let pose = Pose::of(document, channels, at.node);
        let one = Instance { world_from_node: at.world_from_node, pose, place: at.place };
        let extension =
            node.extensions.as_ref().and_then(|extensions| extensions.others.get("EXT_mesh_gpu_instancing"));
        let Some(attributes) = extension.and_then(|extension| extension.get("attributes")) else {
            total += 1;
            list.push(one);
            continue;
        };
        let here = place("node", at.node, node.name.as_deref());
        let Some(count) = count(document, attributes, &here)? else {
            report.left_out("instances without a translation, rotation or scale", &here);
            continue;
        };
        total += count as u64;
        within("instances of the scene", total, MAX_DRAWS)?;
        let before = list.len();
        for local in locals(document, buffers, attributes, count)? {
            let world_from_node = at.world_from_node * local;
            if world_from_node.is_finite() {
                let hung = |place: Place| Place { node_from_own: place.node_from_own * local, ..place };
                list.push(Instance { world_from_node, place: one.place.map(hung), ..one });
            }
        }
        if list.len() - before < count {
            report.left_out("instances whose transform is not finite", &here);
        }
    }
    Ok(instances)
}

const NAMES: [&str; 3] = ["TRANSLATION", "ROTATION", "SCALE"];

/// Returns an attribute's accessor.
fn named(document: &Document, attributes: &Value, name: &str) -> Option<usize> {
    let index = attributes.get(name)?.as_u64().and_then(|index| usize::try_from(index).ok())?;
    (index < document.json.accessors.len()).then_some(index)
}

/// Returns the number of instances. `None` if no attribute gives one.
/// Errors if the attributes disagree.
fn count(document: &Document, attributes: &Value, here: &str) -> Result<Option<usize>, SceneError> {
    let mut count = None;
    for index in NAMES.iter().filter_map(|name| named(document, attributes, name)) {
        let this = Layout::new(&document.json, index)?.count;
        if *count.get_or_insert(this) != this {
            return Err(SceneError::invalid(here, "its instances' attributes have different counts"));
        }
    }
    Ok(count)
}

/// Returns each instance's transform within the node.
fn locals(
    document: &Document,
    buffers: &Buffers<'_>,
    attributes: &Value,
    count: usize,
) -> Result<impl Iterator<Item = DMat4>, SceneError> {
    fn read<const N: usize>(
        document: &Document,
        buffers: &Buffers<'_>,
        index: Option<usize>,
    ) -> Result<Vec<[f32; N]>, SceneError> {
        let index = index.and_then(|index| u32::try_from(index).ok());
        index.map_or(Ok(Vec::new()), |index| accessor::vectors(&document.json, buffers, Index::new(index)))
    }
    let [translations, rotations, scales] = NAMES.map(|name| named(document, attributes, name));
    let translations = read::<3>(document, buffers, translations)?;
    let rotations = read::<4>(document, buffers, rotations)?;
    let scales = read::<3>(document, buffers, scales)?;
    Ok((0..count).map(move |number| {
        let vector = |list: &[[f32; 3]], absent| {
            list.get(number).map_or(absent, |vector| DVec3::from_array(vector.map(f64::from)))
        };
        let rotation = rotations.get(number).map_or(DQuat::IDENTITY, |q| DQuat::from_array(q.map(f64::from)));
        let rotation = if rotation.length_squared().is_normal() { rotation.normalize() } else { DQuat::IDENTITY };
        let (scale, translation) = (vector(&scales, DVec3::ONE), vector(&translations, DVec3::ZERO));
        DMat4::from_scale_rotation_translation(scale, rotation, translation)
    }))
}
