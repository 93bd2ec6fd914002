//! Decodes Draco's triangle meshes.
//!
//! The crate `draco-core` is a port to safe Rust that reads what the C++ library writes and is fuzzed by its authors.
//! Its counts are bounded here, and a panic in it becomes an error.

use std::panic::{AssertUnwindSafe, catch_unwind};

use draco_core::{
    DataType, DecodeLimits, DecoderBuffer, Mesh, MeshDecoder, geometry_attribute::PointAttribute,
    geometry_indices::PointIndex,
};
use gltf::json::accessor::ComponentType;

use crate::limits::{MAX_TRIANGLES, MAX_VERTICES};

pub(super) struct Geometry {
    mesh: Mesh,
    pub(super) points: usize,
    pub(super) triangles: Vec<[u32; 3]>,
}

/// Decodes a mesh whose attributes take at most `most_bytes`.
/// Errors with a sentence if the data are broken, too large, or of points without triangles.
pub(super) fn decode(data: &[u8], most_bytes: u64) -> Result<Geometry, String> {
    let mut limits = DecodeLimits::default();
    limits.max_points = MAX_VERTICES;
    limits.max_faces = MAX_TRIANGLES;
    limits.max_decoded_bytes = most_bytes;
    let mesh = catch_unwind(AssertUnwindSafe(|| {
        let mut mesh = Mesh::new();
        let decoded = MeshDecoder::new().decode(&mut DecoderBuffer::new(data).with_limits(limits), &mut mesh);
        decoded.map(|()| mesh).map_err(|error| error.to_string())
    }));
    let mesh = mesh.unwrap_or_else(|_| Err("the decoder failed".to_owned()))?;
    let points = mesh.num_points();
    if points as u64 > MAX_VERTICES || mesh.num_faces() == 0 {
        return Err(format!("{points} points and {} triangles", mesh.num_faces()));
    }
    let triangles = mesh.faces().iter().map(|face| face.map(|PointIndex(corner)| corner)).collect();
    Ok(Geometry { mesh, points, triangles })
}

impl Geometry {
    /// Returns an attribute's values for each point, as vectors of so many components of a type. Integers that stand
    /// for fractions become them where floats are asked for.
    /// `None` if there is no such attribute, or it has fewer components.
    pub(super) fn attribute(&self, id: u32, components: usize, to: ComponentType) -> Option<Vec<u8>> {
        let attribute = self.mesh.attribute_by_unique_id(id)?;
        if usize::from(attribute.num_components()) < components {
            return None;
        }
        let read = || attribute.read_f32s(self.points, components);
        let values = catch_unwind(AssertUnwindSafe(read)).ok()?;
        let scale = if to == ComponentType::F32 { fraction(attribute) } else { 1.0 };
        let mut bytes = Vec::with_capacity(values.len() * to.size());
        for value in values {
            append(&mut bytes, value * scale, to);
        }
        Some(bytes)
    }
}

/// What an attribute's integers are multiplied with.
fn fraction(attribute: &PointAttribute) -> f32 {
    match attribute.data_type() {
        _ if !attribute.normalized() => 1.0,
        DataType::Int8 => 1.0 / 127.0,
        DataType::Uint8 => 1.0 / 255.0,
        DataType::Int16 => 1.0 / 32767.0,
        DataType::Uint16 => 1.0 / 65535.0,
        _ => 1.0,
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "it saturates, as the accessor's type says"
)]
fn append(bytes: &mut Vec<u8>, value: f32, to: ComponentType) {
    match to {
        ComponentType::I8 => bytes.extend((value as i8).to_le_bytes()),
        ComponentType::U8 => bytes.push(value as u8),
        ComponentType::I16 => bytes.extend((value as i16).to_le_bytes()),
        ComponentType::U16 => bytes.extend((value as u16).to_le_bytes()),
        ComponentType::U32 => bytes.extend((value as u32).to_le_bytes()),
        ComponentType::F32 => bytes.extend(value.to_le_bytes()),
    }
}
