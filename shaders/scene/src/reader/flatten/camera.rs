//! Reads the perspective cameras of the placed nodes.

use std::f64::consts::PI;

use super::nodes::Placed;
use crate::{
    LoadReport, NamedCamera,
    error::place,
    light::short_name,
    limits::{MAX_CAMERAS, in_reach},
    reader::json::Document,
};

/// Reads the cameras, in the order of their nodes. A camera has its node's name, or else its own.
pub(crate) fn read(document: &Document, placed: &[Placed], report: &mut LoadReport) -> Vec<NamedCamera> {
    let mut cameras = Vec::new();
    for at in placed {
        let Some(node) = document.json.nodes.get(at.node) else { continue };
        let Some(camera) = node.camera.and_then(|index| document.cameras.get(index.value())) else { continue };
        let here = || place("node", at.node, node.name.as_deref());
        let Some(perspective) = &camera.perspective else {
            report.not_drawn("orthographic cameras", &here());
            continue;
        };
        let position_m = at.world_from_node.w_axis.truncate();
        match perspective.yfov.filter(|yfov| *yfov > 0.0 && *yfov < PI) {
            Some(yfov_rad) if in_reach(position_m) && cameras.len() < MAX_CAMERAS => cameras.push(NamedCamera {
                name: short_name(node.name.as_deref().or(camera.name.as_deref())),
                position_m,
                orientation: at.orientation(),
                yfov_rad,
            }),
            Some(_) => report.left_out("cameras beyond the first 256, or out of reach", &here()),
            None => report.left_out("cameras without a vertical field of view between 0 and π", &here()),
        }
    }
    cameras
}
