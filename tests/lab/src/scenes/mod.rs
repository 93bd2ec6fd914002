//! Scenes to test with: some built in code, with known answers, and the real ones that `GNOMON_SCENES` names.

pub mod builder;
pub mod living;
pub mod movers;
pub mod real;
mod shapes;
