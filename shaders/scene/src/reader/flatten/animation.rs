//! Keeps of an animation what has a part in the picture, and tells what is not drawn of it.

use super::channels::Channels;
use crate::{Animation, LoadReport, Scene, light::short_name};

/// Gives the scene its animation, if anything moves.
pub(crate) fn finish(scene: &mut Scene, mut animation: Animation, channels: &Channels, report: &mut LoadReport) {
    if animation.is_empty() {
        return;
    }
    animation.name = short_name(Some(&channels.name));
    keep_used(&mut animation);
    scene.animation = Some(Box::new(animation));
    // Only numbers that place things out of all reach break a guarantee.
    if let Err(fault) = scene.check_animation() {
        report.left_out(format!("the animation, which goes beyond what is drawn: {fault}"), "");
        *scene = scene.at_rest();
    }
}

/// Drops the nodes that nothing hangs on, such as joints that no vertex follows.
fn keep_used(animation: &mut Animation) {
    let mut used = vec![false; animation.nodes.len()];
    let lights = animation.lights.iter().filter_map(|light| light.place.as_ref());
    let cameras = animation.cameras.iter().filter_map(|camera| camera.place.as_ref());
    let hung = lights.chain(cameras).map(|place| place.node);
    let joints = animation.shapes.iter().flat_map(|shape| &shape.joints).filter_map(|joint| joint.node);
    for node in animation.pieces.iter().map(|piece| piece.node).chain(hung).chain(joints) {
        used.get_mut(node as usize).into_iter().for_each(|used| *used = true);
    }
    for (index, node) in animation.nodes.iter().enumerate().rev() {
        if used.get(index) == Some(&true) {
            node.parent.and_then(|parent| used.get_mut(parent as usize)).into_iter().for_each(|used| *used = true);
        }
    }
    let mut before = 0;
    let mut places = Vec::with_capacity(used.len());
    for used in &used {
        places.push(before);
        before += u32::from(*used);
    }
    let moved = |node: &mut u32| *node = places.get(*node as usize).copied().unwrap_or_default();
    animation.pieces.iter_mut().for_each(|piece| moved(&mut piece.node));
    animation.lights.iter_mut().filter_map(|light| light.place.as_mut()).for_each(|place| moved(&mut place.node));
    animation.cameras.iter_mut().filter_map(|camera| camera.place.as_mut()).for_each(|place| moved(&mut place.node));
    let joints = animation.shapes.iter_mut().flat_map(|shape| &mut shape.joints);
    joints.filter_map(|joint| joint.node.as_mut()).for_each(moved);
    animation.nodes.iter_mut().filter_map(|node| node.parent.as_mut()).for_each(moved);
    let mut used = used.into_iter();
    animation.nodes.retain(|_| used.next() == Some(true));
}
