//! The sun, four lanterns in the walks, and a spot light on the well.

use glam::{DQuat, DVec3};
use serde_json::{Value, json};

use super::furnishing::WELL;
use super::glb::{Glb, Id, at, mesh_node};
use super::house::CREASE_DEG;
use super::lantern;
use super::layout::{GARTH, SPRINGING, VAULT_RISE, bay_x};
use super::materials::Palette;
use super::vault::in_walk;

/// The sun stands in the south-west, 38 degrees high: long shadows, and sun through the northern and eastern arches.
const SUN: (f64, f64) = (38.0, 36.0);
/// Position of the spot light: below the southern eave, in front of the well.
const SPOT: DVec3 = DVec3::new(2.55, 3.72, 7.25);

/// Lanterns: side, bay, name. Sides are south, east, north, west.
const LANTERNS: [(usize, usize, &str); 4] =
    [(0, 1, "lantern south-west"), (0, 5, "lantern south-east"), (3, 3, "lantern west"), (1, 4, "lantern east")];

fn light_node(name: &str, light: Id) -> Value {
    json!({ "name": name, "extensions": { "KHR_lights_punctual": { "light": light } } })
}

/// A node turned so that its −Z axis, along which lights shine, points along `direction`.
fn aimed(mut node: Value, direction: DVec3) -> Value {
    let turn = DQuat::from_rotation_arc(DVec3::NEG_Z, direction.normalize());
    node["rotation"] = json!(turn.as_quat().to_array());
    node
}

/// The direction in which sunlight travels: towards the north-east (+x, −z) and down.
pub(crate) fn sun_direction() -> DVec3 {
    let (elevation, azimuth) = (SUN.0.to_radians(), SUN.1.to_radians());
    DVec3::new(azimuth.sin() * elevation.cos(), -elevation.sin(), -azimuth.cos() * elevation.cos())
}

/// Adds the sun. Its node comes before all others, so that it is light 0.
pub(crate) fn add_sun(glb: &mut Glb) {
    let sun = glb.light(json!({ "name": "sun", "type": "directional", "color": [1.0, 0.91, 0.76], "intensity": 12.0 }));
    glb.node(None, at(aimed(light_node("sun", sun), sun_direction()), DVec3::new(-9.0, 14.0, 12.0)));
}

pub(crate) fn add_lamps(glb: &mut Glb, palette: &Palette, sides: [Id; 4]) {
    let body = glb.mesh(
        "lantern",
        &[
            (palette.iron, lantern::iron().weld(30.0)),
            (palette.wax, lantern::candle().weld(CREASE_DEG)),
            (palette.glass, lantern::glass().weld(10.0)),
            (palette.flame, lantern::flame().weld(60.0)),
        ],
    );
    let hook = DVec3::Y * (SPRINGING + VAULT_RISE - 0.16);
    for (side, bay, name) in LANTERNS {
        let flame = glb.light(json!({ "name": name, "type": "point", "color": [1.0, 0.67, 0.36], "intensity": 22.0,
            "range": 16.0 }));
        let node = glb.node(Some(sides[side]), at(mesh_node(name, body), in_walk(bay_x(bay)) + hook));
        glb.node(Some(node), at(light_node(name, flame), DVec3::Y * lantern::LIGHT));
    }

    let spot = glb.light(json!({ "name": "spot on the well", "type": "spot", "color": [0.80, 0.90, 1.0],
        "intensity": 150.0, "range": 18.0, "spot": { "innerConeAngle": 0.28, "outerConeAngle": 0.48 } }));
    let housing = glb.mesh("spot housing", &[(palette.iron, lantern::spot_housing().weld(CREASE_DEG))]);
    let aim = WELL + DVec3::Y * (GARTH + 1.3) - SPOT;
    let node = glb.node(None, at(aimed(mesh_node("spot housing", housing), aim), SPOT));
    glb.node(Some(node), at(light_node("spot on the well", spot), DVec3::NEG_Z * 0.08));
}
