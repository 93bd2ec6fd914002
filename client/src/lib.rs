//! Gnomon's thin client: rasterises its own frames and shades them with visibility that is traced at the edge.

pub mod occluders;
pub mod render;
