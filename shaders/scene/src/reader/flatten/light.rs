//! Reads the lights of KHR_lights_punctual, in the order of their nodes.

use glam::DVec3;

use super::nodes::Placed;
use crate::{
    Light, LoadReport,
    error::{SceneError, place},
    light::LightSource,
    reader::{
        json::{self, Document},
        report::WarningKind,
    },
};

/// Reads the lights of the placed nodes. Scales change neither range nor intensity, as the extension says.
/// Errors if one lies out of reach.
pub(crate) fn read(
    document: &Document,
    placed: &[Placed],
    origin_m: DVec3,
    report: &mut LoadReport,
) -> Result<Vec<Light>, SceneError> {
    let mut lights = Vec::new();
    for at in placed {
        let Some(node) = document.json.nodes.get(at.node) else { continue };
        let named = node.extensions.as_ref().and_then(|extensions| extensions.khr_lights_punctual.as_ref());
        let Some(definition) = named.and_then(|named| document.lights.get(named.light.value())) else { continue };
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
        let source = source(definition, node.name.as_deref(), position, direction);
        let light = source.mended(origin_m).map_err(|fault| SceneError::invalid(here.as_str(), fault))?;
        for what in light.1 {
            report.add(WarningKind::Mended, what, &here, 1);
        }
        lights.push(light.0);
    }
    Ok(lights)
}

fn source<'a>(
    light: &'a json::Light,
    node_name: Option<&'a str>,
    position: DVec3,
    direction: DVec3,
) -> LightSource<'a> {
    let spot = light.spot.as_ref();
    LightSource {
        name: light.name.as_deref().or(node_name),
        kind: &light.kind,
        position,
        direction,
        color: light.color,
        intensity: light.intensity,
        range_m: light.range,
        inner_cone_rad: spot.and_then(|spot| spot.inner_cone_angle),
        outer_cone_rad: spot.and_then(|spot| spot.outer_cone_angle),
    }
}
