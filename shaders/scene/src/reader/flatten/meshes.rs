//! Flattens the placed meshes: applies transforms in f64, recentres, and rounds once to f32.
//!
//! Two passes over the primitives spare an f64 copy of the geometry: the first finds the bounds, and with them the
//! origin; the second writes vertices relative to it.

use std::rc::Rc;

use glam::{DMat4, DVec3, Vec3};
use gltf::json::mesh;

use super::{
    append::append,
    channels::Channels,
    coordinates::Plan,
    deform::{self, Motion},
    instances::{self, Instance},
    materials::Materials,
    nodes::Walk,
    pose::{Posed, Skins},
    primitive::{self, Mode, Source},
};
use crate::{
    Animation, LoadReport, Scene,
    error::{SceneError, place, within},
    limits::{MAX_COORDINATE_M, MAX_DRAWS, MAX_POSE_STEPS, MAX_TRIANGLES, MAX_VERTICES, in_reach},
    reader::{
        file::buffers::Buffers,
        json::{Document, Target},
    },
};

/// A primitive and its instances.
struct Part<'a> {
    primitive: &'a mesh::Primitive,
    targets: &'a [Target],
    place: String,
    mode: Mode,
    material: u32,
    plan: Plan,
    instances: Rc<[Instance]>,
}

/// What meshes are made of.
pub(crate) struct Meshes<'a> {
    pub(crate) document: &'a Document,
    pub(crate) buffers: &'a Buffers<'a>,
    pub(crate) walk: &'a Walk,
    pub(crate) channels: &'a Channels,
}

impl Meshes<'_> {
    /// Writes the geometry of `scene` and the materials that it uses; what moves is written to `animation` too.
    /// Errors if a primitive cannot be read, or the flattened scene goes beyond [`limits`](crate::limits).
    pub(crate) fn flatten(
        &self,
        materials: &mut Materials,
        scene: &mut Scene,
        animation: &mut Animation,
        report: &mut LoadReport,
    ) -> Result<(), SceneError> {
        let parts = self.parts(materials, scene, report)?;
        let mut skins = Skins::default();
        scene.origin_m = self.origin(&parts, &mut skins)?;
        // OPAQUE, MASK, BLEND: tracers read a prefix, and the rasteriser sets each state once.
        for order in 0..3 {
            for part in &parts {
                let material = materials.materials.get(part.material as usize);
                if material.map_or(0, |material| material.alpha.order()) != order {
                    continue;
                }
                self.each(part, &mut skins, Some(&mut *animation), report, |posed, motion, animation, report| {
                    let moving = motion.zip(animation);
                    append((&posed.geometry, &posed.world), part.material, scene, report, moving)
                })?;
            }
        }
        Ok(())
    }

    /// Reads a primitive, and hands each of its instances out, with what moves it if there is an animation for it.
    fn each(
        &self,
        part: &Part<'_>,
        skins: &mut Skins,
        mut animation: Option<&mut Animation>,
        report: &mut LoadReport,
        mut use_it: impl FnMut(
            &Posed<'_>,
            Option<Motion>,
            Option<&mut Animation>,
            &mut LoadReport,
        ) -> Result<(), SceneError>,
    ) -> Result<(), SceneError> {
        let Self { document, buffers, walk, channels } = *self;
        let source = Source { document, buffers, primitive: part.primitive, place: &part.place };
        let geometry = source.read(part.mode, &part.plan, report)?;
        for instance in part.instances.iter() {
            let world = instance.world_from_node;
            let rigid = instance.place.map(Motion::Rigid);
            let Some(pose) = instance.pose else {
                let posed = Posed::unchanged(&geometry, world);
                use_it(&posed, rigid, animation.as_deref_mut(), report)?;
                continue;
            };
            let skin = skins.of(document, buffers, walk, pose.node, report)?;
            let keep = animation.is_some();
            let source = (&source, channels);
            let mut posed = pose.apply(source, part.targets, (&geometry, world), skin, keep, report)?;
            let mut motion = rigid.filter(|_| !pose.skinned);
            if let Some(animation) = &animation {
                let of_instance = (&pose, instance.place.as_ref(), world);
                let of_primitive = (part.targets, &mut posed);
                let read =
                    deform::read(source.0, (walk, channels), of_instance, of_primitive, skin, animation, report)?;
                motion = read.map(|deformed| Motion::Deformed(Box::new(deformed))).or(motion);
            }
            use_it(&posed, motion, animation.as_deref_mut(), report)?;
        }
        Ok(())
    }

    /// Returns the primitives of all placed meshes, and checks their sums against [`limits`](crate::limits).
    fn parts(
        &self,
        materials: &mut Materials,
        scene: &mut Scene,
        report: &mut LoadReport,
    ) -> Result<Vec<Part<'_>>, SceneError> {
        let document = self.document;
        let instances = instances::collect(document, self.buffers, (&self.walk.placed, self.channels), report)?;
        let shown = instances.iter().map(Vec::len).sum::<usize>();
        scene.instances = u32::try_from(shown).unwrap_or(u32::MAX);
        let mut parts = Vec::new();
        let (mut triangles, mut vertices, mut draws, mut steps) = (0_u64, 0_u64, 0_u64, 0_u64);
        for ((index, mesh), instances) in document.json.meshes.iter().enumerate().zip(instances) {
            let instances: Rc<[Instance]> = instances.into();
            for (number, primitive) in mesh.primitives.iter().enumerate() {
                let place = format!("{}, primitive {number}", place("mesh", index, mesh.name.as_deref()));
                let times = instances.len() as u64;
                let Some(mode) = Mode::of(primitive, &place)? else {
                    report.skipped_primitives += times;
                    continue;
                };
                if times == 0 {
                    continue;
                }
                let Some(size) = primitive::size(document, primitive, mode, &place, report)? else {
                    report.skipped_primitives += times;
                    continue;
                };
                // Each factor is bounded, so the products fit.
                triangles += size.triangles * times;
                vertices += size.vertices * times;
                draws += times;
                within("triangles of the scene, shared meshes counted for each instance", triangles, MAX_TRIANGLES)?;
                within("vertices of the scene, shared meshes counted for each instance", vertices, MAX_VERTICES)?;
                within("primitives of the scene, shared meshes counted for each instance", draws, MAX_DRAWS)?;
                let targets = document.targets.get(index).and_then(|targets| targets.get(number));
                let targets = targets.map(Vec::as_slice).unwrap_or_default();
                for pose in instances.iter().filter_map(|instance| instance.pose) {
                    steps = steps.saturating_add(size.vertices * pose.passes(document, self.channels, targets.len()));
                }
                within("vertices that morph targets and skins move, counted for each", steps, MAX_POSE_STEPS)?;
                let material = materials.get(document, primitive, report)?;
                let plan = materials.plan(material);
                let instances = Rc::clone(&instances);
                parts.push(Part { primitive, targets, place, mode, material, plan, instances });
            }
        }
        let reserve = |count: u64| usize::try_from(count).unwrap_or(0);
        scene.positions.reserve_exact(reserve(vertices));
        scene.normals.reserve_exact(reserve(vertices));
        scene.uvs.reserve_exact(reserve(vertices));
        scene.triangles.reserve_exact(reserve(triangles));
        Ok(parts)
    }

    /// Returns the scene's origin: the centre of its bounds, rounded to a multiple of the smallest power of two above
    /// the bounds' longest side. So a scene around the world's origin keeps its coordinates bit for bit, and one far
    /// away has local coordinates of at most one and a half times its size.
    fn origin(&self, parts: &[Part<'_>], skins: &mut Skins) -> Result<DVec3, SceneError> {
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let mut bound = |position: &Vec3, world: &DMat4, place: &str| {
            let there = world.transform_point3(position.as_dvec3());
            if !in_reach(there) {
                let fault = format!("position {position} lies at {there}, beyond ±{MAX_COORDINATE_M} m");
                return Err(SceneError::invalid(place, fault));
            }
            min = min.min(there);
            max = max.max(there);
            Ok(())
        };
        for part in parts {
            // What is wrong is told when the geometry is read again.
            let mut told = LoadReport::default();
            self.each(part, skins, None, &mut told, |Posed { geometry, world, .. }, _, _, _| {
                // Flat triangles take the vertices that they use, others all.
                let corners = geometry.triangles.iter().flatten().filter(|_| geometry.normals.is_none());
                let mut corners = corners.filter_map(|corner| geometry.positions.get(*corner as usize));
                let mut all = geometry.positions.iter().filter(|_| geometry.normals.is_some());
                corners.try_for_each(|position| bound(position, world, &part.place))?;
                all.try_for_each(|position| bound(position, world, &part.place))
            })?;
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
}
