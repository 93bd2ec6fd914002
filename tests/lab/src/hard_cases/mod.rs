//! Generated scenes that break single precision, careless tests or lazy hierarchies, with their bounds.
//!
//! A case is a scene and a camera. Every back end traces it, and the referee or a closed form judges the mask. *Leaks*
//! are bits that are set where the referee is certain of darkness, *acne* is bits that are missing where it is certain
//! of light; both must be 0. The share of undecided bits is bounded too, so that doubt cannot excuse a back end.

mod case;
mod light;
mod mesh;
mod place;
mod surface;

use anyhow::Result;
use gnomon_protocol::mask::Mask;

pub use self::case::{Case, Known, Measure};
use crate::{backends::BackendName, reference::Truth, report::table::Table};

/// Rows, like those of [`run`], for files whose broken triangles the loader must leave out. Errors if it refuses one.
pub fn left_out() -> Result<Vec<Vec<String>>> {
    let kept = mesh::kept()?.into_iter();
    Ok(kept.map(|(case, value)| row(case, "loader", Measure { name: "kept", value, bound: 0.0 })).collect())
}

/// Columns: case, backend, measure, value, bound, holds.
fn row(case: &str, backend: &str, measure: Measure) -> Vec<String> {
    let Measure { name, value, bound } = measure;
    let numbers = [value.to_string(), bound.to_string(), measure.holds().to_string()];
    [case.to_owned(), backend.to_owned(), name.to_owned()].into_iter().chain(numbers).collect()
}

/// Returns all cases for pictures of this size; `large` gives meshes their full number of triangles.
pub fn all((width, height): (u32, u32), large: bool) -> Result<Vec<Case>> {
    let size = (width, height);
    let mut cases = place::cases(size);
    cases.extend(light::cases(size, large));
    cases.extend(mesh::cases(size, large)?);
    cases.extend(surface::cases(size));
    Ok(cases)
}

/// Traces every case with every back end. `see` gets each mask, and the truth if the referee judges it.
pub fn run(
    cases: &[Case],
    backends: &[BackendName],
    mut see: impl FnMut(&Case, BackendName, &Mask, Option<&Truth>) -> Result<()>,
) -> Result<Table> {
    let mut table = Table::new("case | backend | measure | value | bound | holds");
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
