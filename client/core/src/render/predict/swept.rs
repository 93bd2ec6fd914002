//! Where a scene's geometry is at any time.

use glam::Vec3;
use gnomon_scene::{Aabb, AnimatedNode, Animation, Scene, Track};

/// Times at which the movers are looked at, spread over the longest round.
const LOOKS: u16 = 64;

/// Returns the bounds of a scene and of all that moves in it, as far as a few looks tell. They stay the same at any
/// time, so that maps that cover them do, too.
pub(super) fn swept_bounds(scene: &Scene) -> Aabb {
    let mut bounds = scene.bounds;
    let Some(animation) = &scene.animation else { return bounds };
    let round_s = round_s(animation);
    for look in 0..LOOKS {
        let Some(moment) = scene.moment(round_s * f64::from(look) / f64::from(LOOKS)) else { break };
        for (piece, placement) in animation.pieces.iter().zip(&moment.pieces) {
            let Some(placement) = placement else { continue };
            let Aabb { min, max } = piece.bounds;
            for corner in 0..8 {
                let pick = |bit: u8, low: f32, high: f32| if corner >> bit & 1 == 0 { low } else { high };
                let corner = Vec3::new(pick(0, min.x, max.x), pick(1, min.y, max.y), pick(2, min.z, max.z));
                let there = placement.position(corner);
                bounds = Aabb { min: bounds.min.min(there), max: bounds.max.max(there) };
            }
        }
    }
    bounds
}

/// The longest round of a node, in seconds.
fn round_s(animation: &Animation) -> f64 {
    let tracks = |node: &AnimatedNode| {
        let AnimatedNode { translation_track, rotation_track, scale_track, .. } = node;
        let tracks = [translation_track, rotation_track, scale_track].into_iter().flatten();
        tracks.map(|track: &Track| track.period_s).fold(0.0, f64::max)
    };
    animation.nodes.iter().map(tracks).fold(0.0, f64::max)
}
