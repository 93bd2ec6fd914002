//! Generated scenes on which single precision, careless tests or lazy hierarchies fail, each with its bounds.
//!
//! A case is a scene and a camera. Every back end traces it, and the referee or a closed form says what is wrong:
//! bits that are set though the referee is sure that nothing shines there are *leaks*, bits that are missing though it
//! is sure of the light are *acne*; both must be 0. The share of bits that the referee leaves undecided is bounded too, so
//! that doubt cannot excuse a back end.

mod light;
mod mesh;
mod place;
mod surface;

use anyhow::Result;
use gnomon_protocol::mask::Mask;
use gnomon_scene::{Scene, camera::Camera};

use crate::{
    backends::BackendName,
    metrics::RelevantError,
    reference::{Reference, Truth, Verdict},
    report::table::Table,
};

/// What is known about a case's mask.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Known {
    /// What the referee says.
    Referee {
        /// The most that it may leave undecided, of the bits that are relevant or undecided.
        undecided_share: f64,
    },
    /// Not a bit is set.
    Dark,
    /// Every bit of every pixel is set.
    Lit,
}

/// A scene that is hard to trace, and where it is seen from.
#[derive(Debug)]
pub struct Case {
    /// Name in tables and of its picture.
    pub name: String,
    /// The scene.
    pub scene: Scene,
    /// The camera.
    pub camera: Camera,
    /// By what it is judged.
    pub known: Known,
}

impl Case {
    fn judged(name: impl Into<String>, scene: Scene, camera: Camera) -> Self {
        Self { name: name.into(), scene, camera, known: Known::Referee { undecided_share: 0.005 } }
    }

    fn doubtful(self, undecided_share: f64) -> Self {
        Self { known: Known::Referee { undecided_share }, ..self }
    }

    fn all(name: impl Into<String>, scene: Scene, camera: Camera, known: Known) -> Self {
        Self { name: name.into(), scene, camera, known }
    }

    /// The referee's verdict, where it is asked.
    #[must_use]
    pub fn truth(&self) -> Option<Truth> {
        matches!(self.known, Known::Referee { .. }).then(|| Reference::new(&self.scene).trace(&self.camera))
    }

    /// What a mask of this case measures, each with its bound.
    #[must_use]
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

/// Pixels' bits that are `set`, or that are not.
fn count(mask: &Mask, set: bool) -> u64 {
    let shape = mask.shape();
    let pixels = (0..shape.height()).flat_map(|y| (0..shape.width()).map(move |x| (x, y)));
    let bits = pixels.flat_map(|(x, y)| (0..shape.lights()).map(move |light| (light, x, y)));
    bits.filter(|&(light, x, y)| mask.get(light, x, y) == set).count() as u64
}

/// What the loader must refuse, so that no back end meets it: rows like those of [`run`].
#[must_use]
pub fn refusals() -> Vec<Vec<String>> {
    let accepted = mesh::accepted().into_iter();
    accepted
        .map(|(case, taken)| {
            row(case, "loader", Measure { name: "accepted", value: f64::from(u8::from(taken)), bound: 0.0 })
        })
        .collect()
}

/// A line of the table: case, backend, measure, value, bound, holds.
fn row(case: &str, backend: &str, measure: Measure) -> Vec<String> {
    let Measure { name, value, bound } = measure;
    let numbers = [value.to_string(), bound.to_string(), measure.holds().to_string()];
    [case.to_owned(), backend.to_owned(), name.to_owned()].into_iter().chain(numbers).collect()
}

/// A number and the most that it may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measure {
    /// `leaks`, `acne`, `undecided_share`, or `accepted` of files that must be refused.
    pub name: &'static str,
    /// What was measured.
    pub value: f64,
    /// The most that is right.
    pub bound: f64,
}

impl Measure {
    /// Whether the number is within its bound.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.value <= self.bound
    }
}

/// All cases, in pictures of this size; `large` makes those with many triangles as large as they can be asked for.
///
/// # Errors
/// When a case that is loaded from a file cannot be made.
pub fn all((width, height): (u32, u32), large: bool) -> Result<Vec<Case>> {
    let size = (width, height);
    let mut cases = place::cases(size);
    cases.extend(light::cases(size, large));
    cases.extend(mesh::cases(size, large)?);
    cases.extend(surface::cases(size));
    Ok(cases)
}

/// Has every back end trace every case. `see` is shown each mask, with the referee's verdict where it was asked.
///
/// # Errors
/// When a back end refuses a case, or fails, or `see` does.
pub fn run(
    cases: &[Case],
    backends: &[BackendName],
    mut see: impl FnMut(&Case, BackendName, &Mask, Option<&Truth>) -> Result<()>,
) -> Result<Table> {
    let mut table = Table::new(&["case", "backend", "measure", "value", "bound", "holds"]);
    for case in cases {
        let truth = case.truth();
        for &backend in backends {
            let mask = backend.mask(&case.scene, &case.camera)?;
            see(case, backend, &mask, truth.as_ref())?;
            let measures = case.measure(&mask, truth.as_ref());
            table.rows.extend(measures.into_iter().map(|measure| row(&case.name, backend.name(), measure)));
        }
    }
    Ok(table)
}
