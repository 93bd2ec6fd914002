//! A case, and the bounds of its mask.

use glam::DVec3;
use gnomon_protocol::mask::Mask;
use gnomon_scene::{Scene, camera::Camera};

use crate::{
    metrics::RelevantError,
    reference::{Reference, Truth, Verdict},
};

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Known {
    Referee {
        /// Most undecided bits, as a share of the relevant or undecided ones.
        undecided_share: f64,
    },
    Dark,
    Lit,
}

#[derive(Debug)]
pub struct Case {
    /// Name in tables and file names.
    pub name: String,
    pub scene: Scene,
    pub camera: Camera,
    pub known: Known,
}

impl Case {
    pub(super) fn judged(name: impl Into<String>, scene: Scene, camera: Camera) -> Self {
        Self { name: name.into(), scene, camera, known: Known::Referee { undecided_share: 0.005 } }
    }

    pub(super) fn doubtful(self, undecided_share: f64) -> Self {
        Self { known: Known::Referee { undecided_share }, ..self }
    }

    pub(super) fn all(name: impl Into<String>, scene: Scene, camera: Camera, known: Known) -> Self {
        Self { name: name.into(), scene, camera, known }
    }

    /// Returns the referee's verdict, if it judges this case.
    pub fn truth(&self) -> Option<Truth> {
        matches!(self.known, Known::Referee { .. }).then(|| Reference::new(&self.scene).trace(&self.camera))
    }

    pub fn measure(&self, mask: &Mask, truth: Option<&Truth>) -> Vec<Measure> {
        let (leaks, acne, undecided) = match (self.known, truth) {
            (Known::Referee { undecided_share }, Some(truth)) => {
                let error = RelevantError::of(mask, truth);
                let leaks = error.sure_leaks + error.irrelevant_set;
                let bits =
                    |of: fn(&Verdict) -> u32| truth.pixels.iter().map(|v| f64::from(of(v).count_ones())).sum::<f64>();
                let share = bits(|v| v.undecided) / bits(|v| v.relevant | v.undecided).max(1.0);
                (Some(leaks), Some(error.surely_wrong() - error.sure_leaks), Some((share, undecided_share)))
            }
            (Known::Dark, _) => (Some(count(mask, true)), None, None),
            (Known::Lit, _) | (Known::Referee { .. }, None) => (None, Some(count(mask, false)), None),
        };
        #[expect(clippy::cast_precision_loss, reason = "counts of a picture's bits")]
        let exact = |name, bits: Option<u64>| bits.map(|bits| Measure { name, value: bits as f64, bound: 0.0 });
        let doubt = undecided.map(|(value, bound)| Measure { name: "undecided_share", value, bound });
        [exact("leaks", leaks), exact("acne", acne), doubt].into_iter().flatten().collect()
    }
}

/// Counts the bits that equal `set`.
fn count(mask: &Mask, set: bool) -> u64 {
    let shape = mask.shape();
    let pixels = (0..shape.height()).flat_map(|y| (0..shape.width()).map(move |x| (x, y)));
    let bits = pixels.flat_map(|(x, y)| (0..shape.lights()).map(move |light| (light, x, y)));
    bits.filter(|&(light, x, y)| mask.get(light, x, y) == set).count() as u64
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measure {
    /// `leaks`, `acne`, `undecided_share`, or `kept` for broken triangles that the loader must leave out.
    pub name: &'static str,
    pub value: f64,
    pub bound: f64,
}

impl Measure {
    pub fn holds(&self) -> bool {
        self.value <= self.bound
    }
}

/// A camera with the field of view of most cases.
pub(super) fn look(from: [f64; 3], to: [f64; 3], (width, height): (u32, u32)) -> Camera {
    Camera::looking_at(DVec3::from(from), DVec3::from(to), 0.9, width, height)
}
