//! Reads the chosen animations: which properties change, and how (glTF 2.0, §3.11; KHR_animation_pointer).
//!
//! A channel that cannot be read is left out, and the rest of the file is whole without it.

use std::{borrow::Cow, collections::HashMap};

use gltf::json::Index;

use super::{accessor, materials::choose};
use crate::{
    Interpolation, LoadReport, Track,
    error::{SceneError, place},
    light::f32_of,
    limits::MAX_TRACK_VALUES,
    reader::{
        checks::layout::Layout,
        file::buffers::Buffers,
        json::{Animation, AnimationSampler, ChannelTarget, Document},
        report::WarningKind,
    },
};

/// What the chosen animations change. Tracks that never change are there too.
#[derive(Debug, Default)]
pub(crate) struct Channels {
    /// Name of the first one.
    pub(crate) name: String,
    pub(crate) nodes: HashMap<usize, NodeTracks>,
    /// By index of the definition.
    pub(crate) lights: HashMap<usize, LightTracks>,
    /// Weights of morph targets, by node; and by mesh, for nodes without weights of their own.
    node_weights: HashMap<usize, Track>,
    mesh_weights: HashMap<usize, Track>,
    /// Vertical fields of view, by index of the camera's definition.
    pub(crate) zooms: HashMap<usize, Track>,
}

/// The weights of a node's morph targets.
pub(crate) struct Weights<'a> {
    /// In the pose of the file, or always.
    pub(crate) values: Cow<'a, [f32]>,
    /// `None` if they never change.
    pub(crate) track: Option<&'a Track>,
    /// How many the track has.
    pub(crate) count: usize,
}

#[derive(Debug, Default)]
pub(crate) struct NodeTracks {
    /// A person may move it.
    pub(crate) editable: bool,
    pub(crate) translation: Option<Track>,
    pub(crate) rotation: Option<Track>,
    pub(crate) scale: Option<Track>,
    pub(crate) visible: Option<Track>,
}

#[derive(Debug, Default, Clone)]
pub(crate) struct LightTracks {
    pub(crate) color: Option<Track>,
    pub(crate) intensity: Option<Track>,
    pub(crate) range: Option<Track>,
    pub(crate) inner_cone: Option<Track>,
    pub(crate) outer_cone: Option<Track>,
}

impl NodeTracks {
    /// Returns whether a transform is given, which may never change.
    pub(crate) fn transforms(&self) -> bool {
        self.translation.is_some() || self.rotation.is_some() || self.scale.is_some()
    }

    /// Returns whether nothing ever changes: constant values replace the file's.
    pub(crate) fn rest(&self) -> bool {
        !self.editable && self.never_change()
    }

    /// Returns whether no track changes.
    pub(crate) fn never_change(&self) -> bool {
        let vectors = [(&self.translation, 3), (&self.rotation, 4), (&self.scale, 3), (&self.visible, 1)];
        vectors.iter().all(|(track, width)| track.as_ref().is_none_or(|track| track.is_constant(*width)))
    }
}

/// A property that can change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Property {
    Translation(usize),
    Rotation(usize),
    Scale(usize),
    Visible(usize),
    /// Of a node, of a mesh; and how many they are.
    NodeWeights(usize, usize),
    MeshWeights(usize, usize),
    LightColor(usize),
    LightIntensity(usize),
    LightRange(usize),
    LightInnerCone(usize),
    LightOuterCone(usize),
    CameraYfov(usize),
}

/// Why a channel changes nothing.
enum Nothing {
    /// It has no target, or one that is not there.
    NoTarget,
    NotDrawn(&'static str),
}

/// Reads the animations that a user wishes to see: `off`, `all`, a name or a number. Without a wish there is none.
/// Errors if there is no such animation.
pub(crate) fn read(
    document: &Document,
    buffers: &Buffers<'_>,
    wanted: Option<&str>,
    report: &mut LoadReport,
) -> Result<Channels, SceneError> {
    let names: Vec<&str> =
        document.animations.iter().map(|animation| animation.name.as_deref().unwrap_or("")).collect();
    let chosen = match wanted {
        None | Some("off") => 0..0,
        Some("all") => 0..names.len(),
        Some(wanted) => choose("animation", wanted, &names).map(|index| index..index + 1)?,
    };
    if chosen.is_empty() {
        let count = names.len() as u64;
        report.add(WarningKind::NotDrawn, "animations: everything stands as the file has it", "", count);
    }
    let mut channels =
        Channels { name: names.get(chosen.start).copied().unwrap_or_default().to_owned(), ..Channels::default() };
    let mut values = 0;
    for index in chosen {
        let Some(animation) = document.animations.get(index) else { continue };
        let here = place("animation", index, animation.name.as_deref());
        Reader { document, buffers, here: &here, values: &mut values }.read(animation, &mut channels, report);
    }
    Ok(channels)
}

impl Channels {
    /// Lets people move the nodes of these names or numbers; `all` means every node.
    /// Errors if there is no such node.
    pub(crate) fn allow_edits(&mut self, document: &Document, wanted: &[String]) -> Result<(), SceneError> {
        let nodes = document.json.nodes.iter();
        let names: Vec<&str> = nodes.map(|node| node.name.as_deref().unwrap_or("")).collect();
        for wanted in wanted {
            let chosen = if wanted == "all" { None } else { Some(choose("node", wanted, &names)?) };
            for (index, name) in names.iter().enumerate() {
                if chosen.is_none_or(|chosen| chosen == index || name == wanted) {
                    self.nodes.entry(index).or_default().editable = true;
                }
            }
        }
        Ok(())
    }
}

const NO_TARGETS: &str = "animated weights of meshes without morph targets";
const OTHERS: &str = "animated properties but transforms, weights, visibility, lights and fields of view";

/// Returns how many morph targets a mesh has.
fn targets(document: &Document, mesh: usize) -> usize {
    document.targets.get(mesh).into_iter().flatten().map(Vec::len).max().unwrap_or(0)
}

struct Reader<'a> {
    document: &'a Document,
    buffers: &'a Buffers<'a>,
    here: &'a str,
    /// Times and values so far.
    values: &'a mut u64,
}

impl Reader<'_> {
    fn read(&mut self, animation: &Animation, channels: &mut Channels, report: &mut LoadReport) {
        // A round ends with the last key of any property, drawn or not.
        let mut period_s = 0.0_f64;
        let mut tracks = Vec::new();
        for channel in &animation.channels {
            let sampler = channel.sampler.and_then(|sampler| animation.samplers.get(sampler as usize));
            let Some(sampler) = sampler else {
                report.left_out("an animation's channel without a sampler", self.here);
                continue;
            };
            let property = match self.property(channel.target.as_ref()) {
                Ok(property) => Some(property),
                Err(Nothing::NotDrawn(what)) => {
                    report.not_drawn(what, self.here);
                    None
                }
                Err(Nothing::NoTarget) => {
                    report.left_out("an animation's channel of nothing", self.here);
                    continue;
                }
            };
            let Some(times) = self.times(sampler, report) else {
                report.left_out("an animation's channel whose times cannot be read", self.here);
                continue;
            };
            period_s =
                times.iter().fold(period_s, |end, time| if time.is_finite() { end.max(f64::from(*time)) } else { end });
            let Some(property) = property else { continue };
            match self.track(property, sampler, &times, report) {
                Some(track) => tracks.push((property, track)),
                None => report.left_out("an animation's channel whose values cannot be read", self.here),
            }
        }
        for (property, track) in tracks {
            channels.set(property, Track { period_s, ..track });
        }
    }

    fn property(&self, target: Option<&ChannelTarget>) -> Result<Property, Nothing> {
        let target = target.ok_or(Nothing::NoTarget)?;
        let pointer = target.extensions.as_ref().and_then(|extensions| extensions.pointer.as_ref());
        if let Some(pointer) = pointer.and_then(|pointer| pointer.pointer.as_deref()) {
            return self.pointed(pointer);
        }
        let node = target.node.ok_or(Nothing::NoTarget)? as usize;
        self.of_node(node, target.path.as_deref().unwrap_or_default())
    }

    fn of_node(&self, node: usize, path: &str) -> Result<Property, Nothing> {
        if node >= self.document.json.nodes.len() {
            return Err(Nothing::NoTarget);
        }
        match path {
            "translation" => Ok(Property::Translation(node)),
            "rotation" => Ok(Property::Rotation(node)),
            "scale" => Ok(Property::Scale(node)),
            "extensions/KHR_node_visibility/visible" => Ok(Property::Visible(node)),
            "weights" => {
                let mesh = self.document.json.nodes.get(node).and_then(|node| node.mesh);
                let count = mesh.map_or(0, |mesh| targets(self.document, mesh.value()));
                if count > 0 { Ok(Property::NodeWeights(node, count)) } else { Err(Nothing::NotDrawn(NO_TARGETS)) }
            }
            _ => Err(Nothing::NotDrawn(OTHERS)),
        }
    }

    /// Reads a JSON pointer (RFC 6901).
    fn pointed(&self, pointer: &str) -> Result<Property, Nothing> {
        let within = |list: &str| {
            let (index, rest) = pointer.strip_prefix(list)?.split_once('/')?;
            Some((index.parse::<usize>().ok()?, rest))
        };
        let other = Nothing::NotDrawn(OTHERS);
        if let Some((node, path)) = within("/nodes/") {
            return self.of_node(node, path);
        }
        if let Some((mesh, "weights")) = within("/meshes/") {
            let count = targets(self.document, mesh);
            return if count > 0 { Ok(Property::MeshWeights(mesh, count)) } else { Err(Nothing::NotDrawn(NO_TARGETS)) };
        }
        if let Some((light, path)) = within("/extensions/KHR_lights_punctual/lights/") {
            if light >= self.document.lights.len() {
                return Err(Nothing::NoTarget);
            }
            return match path {
                "color" => Ok(Property::LightColor(light)),
                "intensity" => Ok(Property::LightIntensity(light)),
                "range" => Ok(Property::LightRange(light)),
                "spot/innerConeAngle" => Ok(Property::LightInnerCone(light)),
                "spot/outerConeAngle" => Ok(Property::LightOuterCone(light)),
                _ => Err(other),
            };
        }
        match within("/cameras/") {
            Some((camera, "perspective/yfov")) if camera < self.document.cameras.len() => {
                Ok(Property::CameraYfov(camera))
            }
            Some((camera, _)) if camera >= self.document.cameras.len() => Err(Nothing::NoTarget),
            _ => Err(other),
        }
    }

    /// Returns an accessor's elements. `None` if it cannot be read, or all tracks together are too long.
    fn elements<const N: usize>(&mut self, accessor: Option<u32>, report: &mut LoadReport) -> Option<Vec<[f32; N]>> {
        let json = &self.document.json;
        let index = accessor.map(Index::new)?;
        let layout = Layout::new(json, index.value()).ok()?;
        let values = self.values.saturating_add(layout.count as u64 * N as u64);
        if values > MAX_TRACK_VALUES {
            let what = format!("times and values of animations beyond the first {MAX_TRACK_VALUES}");
            report.left_out(what, self.here);
            return None;
        }
        *self.values = values;
        accessor::vectors(json, self.buffers, index).ok()
    }

    fn times(&mut self, sampler: &AnimationSampler, report: &mut LoadReport) -> Option<Vec<f32>> {
        let times: Vec<f32> = self.elements::<1>(sampler.input, report)?.into_iter().flatten().collect();
        (!times.is_empty()).then_some(times)
    }

    fn track(
        &mut self,
        property: Property,
        sampler: &AnimationSampler,
        times: &[f32],
        report: &mut LoadReport,
    ) -> Option<Track> {
        let interpolation = match sampler.interpolation.as_deref() {
            // Nothing lies between visible and hidden.
            _ if matches!(property, Property::Visible(_)) => Interpolation::Step,
            None | Some("LINEAR") => Interpolation::Linear,
            Some("STEP") => Interpolation::Step,
            Some("CUBICSPLINE") => Interpolation::CubicSpline,
            Some(_) => {
                report.mended("an interpolation that does not exist: LINEAR", self.here);
                Interpolation::Linear
            }
        };
        let output = sampler.output;
        match property {
            Property::Translation(_) | Property::Scale(_) | Property::LightColor(_) => {
                let values = self.elements::<3>(output, report)?;
                self.keys((interpolation, 1), times, &values, report)
            }
            Property::Rotation(_) => {
                let values = self.elements::<4>(output, report)?;
                self.keys((interpolation, 1), times, &values, report)
            }
            Property::NodeWeights(_, count) | Property::MeshWeights(_, count) => {
                let values = self.elements::<1>(output, report)?;
                self.keys((interpolation, count), times, &values, report)
            }
            _ => {
                let values = self.elements::<1>(output, report)?;
                self.keys((interpolation, 1), times, &values, report)
            }
        }
    }

    /// Returns the keys that make sense, of so many values each. `None` if there are none.
    fn keys<const N: usize>(
        &self,
        (interpolation, width): (Interpolation, usize),
        times: &[f32],
        values: &[[f32; N]],
        report: &mut LoadReport,
    ) -> Option<Track> {
        let elements = interpolation.elements() * width;
        if values.len() != times.len() * elements {
            report.mended("an animation with another number of values than its times ask for: cut", self.here);
        }
        let mut track = Track { period_s: 0.0, interpolation, times_s: Vec::new(), values: Vec::new() };
        let mut strange = 0;
        for (time, key) in times.iter().zip(values.chunks_exact(elements)) {
            let forwards = track.times_s.last().is_none_or(|before| time >= before);
            if time.is_finite() && forwards && key.iter().flatten().all(|value| value.is_finite()) {
                track.times_s.push(*time);
                track.values.extend(key.iter().flatten());
            } else {
                strange += 1;
            }
        }
        let what = "keys of animations that are not finite, or go back in time";
        report.add(WarningKind::LeftOut, what, self.here, strange);
        (!track.times_s.is_empty()).then_some(track)
    }
}

impl Channels {
    /// Returns the weights of a node's morph targets: its own, or else its mesh's. Those that never change take the
    /// places of the file's.
    pub(crate) fn weights<'a>(&'a self, document: &'a Document, node: usize) -> Weights<'a> {
        let nothing = Weights { values: Cow::Borrowed(&[]), track: None, count: 0 };
        let Some((here, mesh)) = document.json.nodes.get(node).and_then(|node| Some((node, node.mesh?))) else {
            return nothing;
        };
        let of_mesh = || document.json.get(mesh).and_then(|mesh| mesh.weights.as_deref());
        let of_file = here.weights.as_deref().or_else(of_mesh).unwrap_or(&[]);
        let of_mesh = || self.mesh_weights.get(&mesh.value()).filter(|_| here.weights.is_none());
        let (track, count) = (self.node_weights.get(&node).or_else(of_mesh), targets(document, mesh.value()));
        match track {
            Some(track) if track.is_constant(count) => {
                let mut values = vec![0.0; count];
                track.sample_into(0.0, &mut values);
                Weights { values: values.into_iter().map(f32_of).collect(), ..nothing }
            }
            track => Weights { values: Cow::Borrowed(of_file), track, count },
        }
    }

    /// Of several tracks of a property, the last one counts.
    fn set(&mut self, property: Property, track: Track) {
        let place = match property {
            Property::Translation(node) => &mut self.nodes.entry(node).or_default().translation,
            Property::Rotation(node) => &mut self.nodes.entry(node).or_default().rotation,
            Property::Scale(node) => &mut self.nodes.entry(node).or_default().scale,
            Property::Visible(node) => &mut self.nodes.entry(node).or_default().visible,
            Property::NodeWeights(node, _) => {
                self.node_weights.insert(node, track);
                return;
            }
            Property::MeshWeights(mesh, _) => {
                self.mesh_weights.insert(mesh, track);
                return;
            }
            Property::LightColor(light) => &mut self.lights.entry(light).or_default().color,
            Property::LightIntensity(light) => &mut self.lights.entry(light).or_default().intensity,
            Property::LightRange(light) => &mut self.lights.entry(light).or_default().range,
            Property::LightInnerCone(light) => &mut self.lights.entry(light).or_default().inner_cone,
            Property::LightOuterCone(light) => &mut self.lights.entry(light).or_default().outer_cone,
            Property::CameraYfov(camera) => {
                self.zooms.insert(camera, track);
                return;
            }
        };
        *place = Some(track);
    }
}
