//! Camera paths through the cloister, in the format of a `lights_camera.json`'s `camera_paths`.

use serde_json::{Map, Value, json};

/// A keyframe: time in seconds, position and target in metres.
type Key = (f64, [f64; 3], [f64; 3]);

/// From the south walk through its lanterns' light, out into the garth, past well and fountain to the sundial.
const WALK: [Key; 10] = [
    (0.0, [-9.3, 1.65, 9.7], [-2.0, 1.7, 9.4]),
    (3.0, [-4.6, 1.65, 9.7], [1.5, 1.6, 8.6]),
    (5.0, [-1.2, 1.65, 9.2], [1.6, 1.4, 3.0]),
    (6.5, [0.0, 1.62, 7.6], [1.6, 1.4, 0.0]),
    (8.0, [0.2, 1.55, 5.4], [3.4, 1.3, 3.4]),
    (10.0, [1.9, 1.55, 3.2], [2.2, 1.5, -2.0]),
    (12.0, [3.3, 1.62, 0.4], [3.7, 1.1, -3.6]),
    (14.0, [5.1, 1.72, -2.2], [3.9, 0.9, -3.8]),
    (16.5, [3.4, 1.7, -1.7], [-1.0, 1.5, -7.5]),
    (19.0, [0.3, 1.7, -4.6], [-3.2, 1.7, -7.6]),
];

/// Once around the fountain, above head height.
fn orbit() -> Vec<Key> {
    (0..=16u8)
        .map(|k| f64::from(k) / 16.0)
        .map(|t| {
            let angle = t * std::f64::consts::TAU + 0.6;
            let round = |v: f64| (v * 1000.0).round() / 1000.0;
            let position = [round(3.6 * angle.sin()), 2.6, round(3.6 * angle.cos())];
            (t * 20.0, position, [0.0, 1.7, 0.0])
        })
        .collect()
}

/// Along the north walk, through the sun that falls in between its columns.
const NORTH_WALK: [Key; 3] = [
    (0.0, [-8.6, 1.6, -9.8], [-2.0, 1.5, -9.2]),
    (5.0, [0.0, 1.6, -9.75], [6.5, 1.3, -9.0]),
    (10.0, [8.2, 1.6, -9.8], [9.6, 1.6, -4.0]),
];

pub(crate) fn all() -> Vec<(&'static str, Vec<Key>)> {
    vec![("walk", WALK.to_vec()), ("orbit", orbit()), ("north_walk", NORTH_WALK.to_vec())]
}

pub(crate) fn document() -> Value {
    let mut paths = Map::new();
    for (name, keys) in all() {
        let frames: Vec<Value> =
            keys.iter().map(|(t, position, target)| json!({ "t": t, "pos": position, "target": target })).collect();
        let duration = keys.last().map_or(0.0, |key| key.0);
        paths.insert(name.to_owned(), json!({ "yfov_deg": 60.0, "duration_s": duration, "keyframes": frames }));
    }
    json!({ "units": "metres", "up": "+Y", "camera_paths": paths })
}
