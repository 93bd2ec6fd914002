//! Keeps of an animation what has a part in the picture, and tells what is not drawn of it.

use super::channels::Channels;
use crate::{AnimatedNode, Animation, LoadReport, Scene, error::place, light::short_name, reader::json::Document};

/// Gives the scene its animation, if anything moves.
pub(crate) fn finish(
    scene: &mut Scene,
    mut animation: Animation,
    nodes: Vec<AnimatedNode>,
    channels: &Channels,
    report: &mut LoadReport,
) {
    if animation.is_empty() {
        return;
    }
    animation.name = short_name(Some(&channels.name));
    animation.nodes = nodes;
    keep_used(&mut animation);
    scene.animation = Some(Box::new(animation));
    // Only numbers that place things out of all reach break a guarantee.
    if let Err(fault) = scene.check_animation() {
        report.left_out(format!("the animation, which goes beyond what is drawn: {fault}"), "");
        *scene = scene.at_rest();
    }
}

/// Tells of skins whose joints move: they stand as the file has them.
pub(crate) fn tell_skins(document: &Document, channels: &Channels, report: &mut LoadReport) {
    let moves = |joint: &u32| channels.nodes.get(&(*joint as usize)).is_some_and(|tracks| !tracks.never_change());
    for (index, skin) in document.skins.iter().enumerate() {
        if skin.joints.iter().any(moves) {
            report.not_drawn("animated skins: they stand as the file has them", &place("skin", index, None));
        }
    }
}

/// Drops the nodes that nothing hangs on, such as the joints of skins.
fn keep_used(animation: &mut Animation) {
    let mut used = vec![false; animation.nodes.len()];
    let lights = animation.lights.iter().filter_map(|light| light.place.as_ref());
    let cameras = animation.cameras.iter().filter_map(|camera| camera.place.as_ref());
    let hung = lights.chain(cameras).map(|place| place.node);
    for node in animation.pieces.iter().map(|piece| piece.node).chain(hung) {
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
    animation.nodes.iter_mut().filter_map(|node| node.parent.as_mut()).for_each(moved);
    let mut used = used.into_iter();
    animation.nodes.retain(|_| used.next() == Some(true));
}
