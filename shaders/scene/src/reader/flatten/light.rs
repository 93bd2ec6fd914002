//! Reads the lights of KHR_lights_punctual, in the order of their nodes.

use glam::DVec3;

use super::{
    channels::{Channels, LightTracks},
    nodes::Placed,
};
use crate::{
    AnimatedLight, Light, LoadReport, Track,
    error::{SceneError, place},
    light::LightSource,
    reader::{
        json::{self, Document},
        report::WarningKind,
    },
};

/// Reads the lights of the placed nodes, and which of them move or change. Scales change neither range nor intensity,
/// as the extension says.
/// Errors if one lies out of reach.
pub(crate) fn read(
    document: &Document,
    channels: &Channels,
    placed: &[Placed],
    origin_m: DVec3,
    report: &mut LoadReport,
) -> Result<(Vec<Light>, Vec<AnimatedLight>), SceneError> {
    let (mut lights, mut animated) = (Vec::new(), Vec::new());
    let still = LightTracks::default();
    for at in placed {
        let Some(node) = document.json.nodes.get(at.node) else { continue };
        let named = node.extensions.as_ref().and_then(|extensions| extensions.khr_lights_punctual.as_ref());
        let Some(index) = named.map(|named| named.light.value()) else { continue };
        let Some(definition) = document.lights.get(index) else { continue };
        let tracks = channels.lights.get(&index).unwrap_or(&still);
        let here = place("node", at.node, node.name.as_deref());
        if !matches!(definition.kind.as_str(), "directional" | "point" | "spot") {
            let what = format!("lights of type {:.32?}, which is not directional, point or spot", definition.kind);
            report.left_out(what, &here);
            continue;
        }
        // Under a scale of 0 the axis itself has no length.
        let axis = at.world_from_node.transform_vector3(DVec3::NEG_Z);
        let direction = if axis.try_normalize().is_some() { axis } else { at.rotation * DVec3::NEG_Z };
        let position = at.world_from_node.w_axis.truncate();
        let source = source(definition, tracks, node.name.as_deref(), position, direction);
        let light = source.mended(origin_m).map_err(|fault| SceneError::invalid(here.as_str(), fault))?;
        for what in light.1 {
            report.add(WarningKind::Mended, what, &here, 1);
        }
        let changing = |track: &Option<Track>, width| track.clone().filter(|track| !track.is_constant(width));
        let moving = AnimatedLight {
            light: u32::try_from(lights.len()).unwrap_or(u32::MAX),
            place: at.place,
            color_track: changing(&tracks.color, 3),
            intensity_track: changing(&tracks.intensity, 1),
            range_track: changing(&tracks.range, 1),
            inner_cone_track: changing(&tracks.inner_cone, 1),
            outer_cone_track: changing(&tracks.outer_cone, 1),
        };
        if moving.place.is_some() || moving.tracks().next().is_some() {
            animated.push(moving);
        }
        lights.push(light.0);
    }
    Ok((lights, animated))
}

/// Returns a light, unchecked. Tracks that never change take the places of the file's values.
fn source<'a>(
    light: &'a json::Light,
    tracks: &LightTracks,
    node_name: Option<&'a str>,
    position: DVec3,
    direction: DVec3,
) -> LightSource<'a> {
    let spot = light.spot.as_ref();
    let constant = |track: &Option<Track>, or: Option<f64>| {
        let track = track.as_ref().filter(|track| track.is_constant(1));
        track.map(|track| track.sample::<1>(0.0)[0]).or(or)
    };
    let color = tracks.color.as_ref().filter(|track| track.is_constant(3));
    LightSource {
        name: light.name.as_deref().or(node_name),
        kind: &light.kind,
        position,
        direction,
        color: color.map(|track| track.sample(0.0)).or(light.color),
        intensity: constant(&tracks.intensity, light.intensity),
        range_m: constant(&tracks.range, light.range),
        inner_cone_rad: constant(&tracks.inner_cone, spot.and_then(|spot| spot.inner_cone_angle)),
        outer_cone_rad: constant(&tracks.outer_cone, spot.and_then(|spot| spot.outer_cone_angle)),
    }
}
