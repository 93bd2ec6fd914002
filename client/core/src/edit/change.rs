//! How a node's own transform changes when it is moved, turned or scaled in the world.

use glam::{DMat3, DQuat, DVec3};
use gnomon_scene::{NodeAt, NodeEdit};

/// Returns the node moved by a vector of the world. `None` if nothing in its parent's space can move so.
pub(super) fn moved(node: &NodeAt, by: DVec3) -> Option<NodeAt> {
    let parent_from_world = inverse(node)?;
    Some(NodeAt { translation_m: node.translation_m + parent_from_world * by, ..*node })
}

/// Returns the node turned around `axis`, a unit vector, by an angle in radians. `pivot` stays where it is, all in the
/// world. If the parent stretches, it turns in the parent's space, as far as it can.
pub(super) fn turned(node: &NodeAt, pivot: DVec3, axis: DVec3, angle_rad: f64) -> Option<NodeAt> {
    let parent_from_world = inverse(node)?;
    // A mirror turns the other way round.
    let axis = (parent_from_world * axis * parent_from_world.determinant().signum()).try_normalize()?;
    let turn = DQuat::from_axis_angle(axis, angle_rad);
    let pivot = node.world_from_parent.inverse().transform_point3(pivot);
    Some(NodeAt {
        translation_m: pivot + turn * (node.translation_m - pivot),
        rotation: (turn * node.rotation).normalize(),
        ..*node
    })
}

/// Returns the node scaled evenly. `pivot` stays where it is, in the world.
pub(super) fn scaled(node: &NodeAt, pivot: DVec3, factor: f64) -> Option<NodeAt> {
    inverse(node)?;
    let pivot = node.world_from_parent.inverse().transform_point3(pivot);
    Some(NodeAt { translation_m: pivot + (node.translation_m - pivot) * factor, scale: node.scale * factor, ..*node })
}

/// Returns the edit that takes a node from `before` to `after`, on top of what was edited. What stays the same is left
/// as it was said.
#[must_use]
pub fn with_changes(edited: NodeEdit, before: &NodeAt, after: &NodeAt) -> NodeEdit {
    fn said<T: PartialEq>(edited: Option<T>, before: &T, after: T) -> Option<T> {
        if *before == after { edited } else { Some(after) }
    }
    NodeEdit {
        translation_m: said(edited.translation_m, &before.translation_m, after.translation_m),
        rotation: said(edited.rotation, &before.rotation, after.rotation),
        scale: said(edited.scale, &before.scale, after.scale),
        shown: said(edited.shown, &before.shown, after.shown),
    }
}

/// Takes vectors of the world to the parent's space. `None` if the parent is flat.
fn inverse(node: &NodeAt) -> Option<DMat3> {
    let inverse = DMat3::from_mat4(node.world_from_parent).inverse();
    inverse.is_finite().then_some(inverse)
}

#[cfg(test)]
mod tests {
    use glam::{DMat4, DVec4};

    use super::*;

    fn below(world_from_parent: DMat4) -> NodeAt {
        NodeAt {
            world_from_parent,
            translation_m: DVec3::new(1.0, -2.0, 0.5),
            rotation: DQuat::from_rotation_y(0.7) * DQuat::from_rotation_x(0.2),
            scale: DVec3::new(2.0, 3.0, -0.5),
            shown: true,
            visible: true,
        }
    }

    /// Evenly scaled, turned, and one of them mirrored.
    fn parents() -> [DMat4; 3] {
        let turned = DMat4::from_scale_rotation_translation(
            DVec3::splat(4.0),
            DQuat::from_rotation_z(1.0) * DQuat::from_rotation_x(-0.4),
            DVec3::new(30.0, 1.0, -8.0),
        );
        [DMat4::IDENTITY, turned, turned * DMat4::from_scale(DVec3::new(1.0, -1.0, 1.0))]
    }

    /// The greatest difference between elements. Each is a sum of a few products of at most a hundred, each rounded by
    /// 2⁻⁵³ of itself: below 1e-12.
    fn apart(one: &DMat4, other: &DMat4) -> f64 {
        let columns = [one.x_axis - other.x_axis, one.y_axis - other.y_axis, one.z_axis - other.z_axis];
        columns.into_iter().chain([one.w_axis - other.w_axis]).map(|v: DVec4| v.abs().max_element()).fold(0.0, f64::max)
    }

    #[test]
    fn what_is_done_in_the_world_is_seen_in_the_world() {
        let (pivot, by) = (DVec3::new(5.0, 6.0, -7.0), DVec3::new(0.1, 20.0, -3.0));
        let axis = DVec3::new(2.0, -1.0, 2.0) / 3.0;
        let around = |linear: DMat4| DMat4::from_translation(pivot) * linear * DMat4::from_translation(-pivot);
        for node in parents().map(below) {
            let before = node.world_from_node();
            let moved = moved(&node, by).unwrap().world_from_node();
            assert!(apart(&moved, &(DMat4::from_translation(by) * before)) < 1e-12);
            let turned = turned(&node, pivot, axis, 0.9).unwrap();
            assert!((turned.rotation.length() - 1.0).abs() < 1e-15 && turned.scale == node.scale);
            let expected = around(DMat4::from_axis_angle(axis, 0.9)) * before;
            assert!(apart(&turned.world_from_node(), &expected) < 1e-12, "{node:?}");
            let scaled = scaled(&node, pivot, 0.25).unwrap().world_from_node();
            assert!(apart(&scaled, &(around(DMat4::from_scale(DVec3::splat(0.25))) * before)) < 1e-12);
        }
    }

    #[test]
    fn a_parent_that_stretches_keeps_the_pivot_and_one_that_is_flat_moves_nothing() {
        let node = below(DMat4::from_scale(DVec3::new(1.0, 5.0, 0.5)));
        let own = DVec3::new(0.3, 0.4, 0.5);
        let pivot = node.world_from_node().transform_point3(own);
        let turned = turned(&node, pivot, DVec3::Z, 1.0).unwrap();
        assert!(turned.world_from_node().transform_point3(own).distance(pivot) < 1e-12);
        let flat = below(DMat4::from_scale(DVec3::new(1.0, 0.0, 1.0)));
        assert_eq!(moved(&flat, DVec3::X), None);
        assert_eq!(scaled(&flat, pivot, 2.0), None);
        assert_eq!(super::turned(&flat, pivot, DVec3::X, 1.0), None);
    }

    #[test]
    fn an_edit_says_only_what_has_changed() {
        let before = below(DMat4::IDENTITY);
        let hidden = NodeEdit { shown: Some(false), ..NodeEdit::default() };
        let after = moved(&before, DVec3::X).unwrap();
        let edit = with_changes(hidden, &before, &after);
        assert_eq!(edit, NodeEdit { translation_m: Some(after.translation_m), ..hidden });
        assert_eq!(with_changes(hidden, &before, &before), hidden);
    }
}
