//! Properties of the decoders. Each panics if its property does not hold.

use gltf::json::accessor::ComponentType;

use super::{
    draco,
    meshopt::{self, Filter, Mode},
};

pub(crate) fn draco(bytes: &[u8]) {
    let Ok(geometry) = draco::decode(bytes, 1 << 26) else { return };
    for (id, component) in [ComponentType::U8, ComponentType::U16, ComponentType::F32].into_iter().enumerate() {
        let id = u32::try_from(id).unwrap_or_default();
        if let Some(values) = geometry.attribute(id, 2, component) {
            assert!(values.len() == geometry.points * 2 * component.size(), "an attribute has missing values");
        }
    }
}

pub(crate) fn meshopt(bytes: &[u8]) {
    let [mode, stride, low, high, data @ ..] = bytes else { return };
    let mode = match mode % 7 {
        0 => Mode::Attributes(Filter::None),
        1 => Mode::Attributes(Filter::Octahedral),
        2 => Mode::Attributes(Filter::Quaternion),
        3 => Mode::Attributes(Filter::Exponential),
        4 => Mode::Attributes(Filter::Color),
        5 => Mode::Triangles,
        _ => Mode::Indices,
    };
    let (stride, count) = (usize::from(*stride) * 2, usize::from(u16::from_le_bytes([*low, *high])));
    if let Ok(decoded) = meshopt::decode(mode, data, count, stride) {
        assert!(decoded.len() == count * stride, "a buffer view has missing bytes");
    }
}
