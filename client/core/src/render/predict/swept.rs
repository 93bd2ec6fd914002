//! Where a scene's geometry is at any time.

use gnomon_scene::{Aabb, AnimatedNode, Animation, Scene, Track};

/// Times at which the movers are looked at, spread over a round.
const LOOKS: u16 = 64;

/// Most rounds of different lengths: animations that are shown together each have their own.
const MOST_ROUNDS: usize = 16;

/// Returns the bounds of a scene and of all that moves in it, as far as a few looks tell. They stay the same at any
/// time, so that maps that cover them do, too.
pub(super) fn swept_bounds(scene: &Scene) -> Aabb {
    let mut bounds = scene.bounds;
    let Some(animation) = &scene.animation else { return bounds };
    let rounds_s = rounds_s(animation);
    let times_s =
        rounds_s.iter().flat_map(|round_s| (0..LOOKS).map(move |look| f64::from(look) / f64::from(LOOKS) * round_s));
    for time_s in times_s {
        let Some(moment) = scene.moment(time_s) else { break };
        for placement in moment.pieces.iter().flatten() {
            let there = placement.bounds;
            bounds = Aabb { min: bounds.min.min(there.min), max: bounds.max.max(there.max) };
        }
    }
    bounds
}

/// The lengths of the movers' rounds, in seconds, the longest first. At least one.
fn rounds_s(animation: &Animation) -> Vec<f64> {
    let tracks = |node: &AnimatedNode| {
        let AnimatedNode { translation_track, rotation_track, scale_track, .. } = node;
        let length = |track: &Option<Track>| track.as_ref().map(|track| track.period_s);
        [translation_track, rotation_track, scale_track].map(length)
    };
    let weights = animation.shapes.iter().filter_map(|shape| shape.weights_track.as_ref());
    let weights = weights.map(|track| track.period_s);
    let mut rounds_s: Vec<f64> = animation.nodes.iter().flat_map(tracks).flatten().chain(weights).collect();
    rounds_s.sort_by(|one, other| other.total_cmp(one));
    rounds_s.dedup();
    rounds_s.truncate(MOST_ROUNDS);
    if rounds_s.is_empty() { vec![0.0] } else { rounds_s }
}
