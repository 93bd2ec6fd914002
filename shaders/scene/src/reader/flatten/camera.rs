//! Reads the perspective cameras of the placed nodes.

use std::f64::consts::PI;

use super::{channels::Channels, nodes::Placed};
use crate::{
    AnimatedCamera, LoadReport, NamedCamera,
    error::place,
    light::short_name,
    limits::{MAX_CAMERAS, in_reach},
    reader::json::Document,
};

/// Reads the cameras, in the order of their nodes, and which of them move or zoom. A camera has its node's name, or
/// else its own.
pub(crate) fn read(
    document: &Document,
    channels: &Channels,
    placed: &[Placed],
    report: &mut LoadReport,
) -> (Vec<NamedCamera>, Vec<AnimatedCamera>) {
    let (mut cameras, mut animated) = (Vec::new(), Vec::new());
    for at in placed {
        let Some(node) = document.json.nodes.get(at.node) else { continue };
        let Some(index) = node.camera.map(|camera| camera.value()) else { continue };
        let Some(camera) = document.cameras.get(index) else { continue };
        let here = || place("node", at.node, node.name.as_deref());
        let Some(perspective) = &camera.perspective else {
            report.not_drawn("orthographic cameras", &here());
            continue;
        };
        let position_m = at.world_from_node.w_axis.truncate();
        let zoom = channels.zooms.get(&index);
        let constant = zoom.filter(|track| track.is_constant(1)).map(|track| track.sample::<1>(0.0)[0]);
        match constant.or(perspective.yfov).filter(|yfov| *yfov > 0.0 && *yfov < PI) {
            Some(yfov_rad) if in_reach(position_m) && cameras.len() < MAX_CAMERAS => {
                let number = u32::try_from(cameras.len()).unwrap_or(u32::MAX);
                let yfov_track = zoom.filter(|track| !track.is_constant(1)).cloned();
                if at.place.is_some() || yfov_track.is_some() {
                    animated.push(AnimatedCamera { camera: number, place: at.place, yfov_track });
                }
                cameras.push(NamedCamera {
                    name: short_name(node.name.as_deref().or(camera.name.as_deref())),
                    position_m,
                    orientation: at.orientation(),
                    yfov_rad,
                });
            }
            Some(_) => report.left_out("cameras beyond the first 256, or out of reach", &here()),
            None => report.left_out("cameras without a vertical field of view between 0 and π", &here()),
        }
    }
    (cameras, animated)
}
