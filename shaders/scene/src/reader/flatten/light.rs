//! Reads the lights of KHR_lights_punctual, in the order of their nodes.

use glam::DVec3;

use super::nodes::Placed;
use crate::{
    Light,
    error::{SceneError, place},
    light::LightSource,
    reader::json::{self, Document},
};

/// Reads the lights of the placed nodes. Scales change neither range nor intensity, as the extension says.
/// Errors if a light is malformed, used or not.
pub(crate) fn read(document: &Document, placed: &[Placed], origin_m: DVec3) -> Result<Vec<Light>, SceneError> {
    let definitions = &document.lights;
    for (index, definition) in definitions.iter().enumerate() {
        if definition.kind == "spot" && definition.spot.is_none() {
            return Err(SceneError::invalid(
                place("light", index, definition.name.as_deref()),
                "it is a spot without a \"spot\" object",
            ));
        }
        source(definition, None, DVec3::ZERO, DVec3::NEG_Z)
            .light(DVec3::ZERO)
            .map_err(|fault| SceneError::invalid(place("light", index, definition.name.as_deref()), fault))?;
    }
    let mut lights = Vec::new();
    for at in placed {
        let Some(node) = document.json.nodes.get(at.node) else { continue };
        let named = node.extensions.as_ref().and_then(|extensions| extensions.khr_lights_punctual.as_ref());
        let Some(definition) = named.and_then(|named| definitions.get(named.light.value())) else { continue };
        let position = at.world_from_node.w_axis.truncate();
        let direction = at.world_from_node.transform_vector3(DVec3::NEG_Z);
        let light = source(definition, node.name.as_deref(), position, direction).light(origin_m);
        lights.push(light.map_err(|fault| SceneError::invalid(place("node", at.node, node.name.as_deref()), fault))?);
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
