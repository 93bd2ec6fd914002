//! Reads accessors: interleaved, normalised, quantised, sparse, or all zeros (glTF 2.0, §3.6.2).

use gltf::json::{
    Accessor, Index, Root,
    accessor::{ComponentType, Type},
};

use crate::{
    error::SceneError,
    reader::{
        checks::layout::{Layout, Span, is_unsigned},
        file::buffers::Buffers,
    },
};

/// Reads the first `N` components of an accessor's elements as f32. Integers become their value, or a fraction if they
/// are normalised (§3.6.2.2). Components may be NaN or infinite.
/// Errors if the accessor is malformed, or has fewer components.
pub(crate) fn vectors<const N: usize>(
    json: &Root,
    buffers: &Buffers<'_>,
    index: Index<Accessor>,
) -> Result<Vec<[f32; N]>, SceneError> {
    let layout = Layout::new(json, index.value())?;
    if layout.shape.multiplicity() < N {
        let found = format!("{:?}", layout.shape).to_uppercase();
        return Err(SceneError::invalid(
            layout.place,
            format!("its type is {found}: it has fewer than {N} components"),
        ));
    }
    let size = layout.component.size();
    elements(&layout, buffers, [0.0; N], |element| {
        let mut vector = [0.0; N];
        for (value, bytes) in vector.iter_mut().zip(element.chunks_exact(size)) {
            *value = float(layout.component, layout.normalized, bytes);
        }
        vector
    })
}

/// Reads an accessor of vertex indices.
/// Errors if the accessor is malformed, or not of unsigned scalars.
pub(crate) fn indices(json: &Root, buffers: &Buffers<'_>, index: Index<Accessor>) -> Result<Vec<u32>, SceneError> {
    let layout = Layout::new(json, index.value())?;
    if layout.shape != Type::Scalar || !is_unsigned(layout.component) {
        return Err(SceneError::invalid(layout.place, "indices must be unsigned integers"));
    }
    elements(&layout, buffers, 0, unsigned)
}

fn elements<T: Copy>(
    layout: &Layout,
    buffers: &Buffers<'_>,
    zero: T,
    decode: impl Fn(&[u8]) -> T,
) -> Result<Vec<T>, SceneError> {
    let out_of_bounds = || SceneError::invalid(layout.place.as_str(), "it reaches beyond its buffer");
    let mut out = match layout.base {
        None => vec![zero; layout.count],
        Some(span) => {
            let data = buffers.get(span.buffer)?;
            // `collect` into an Option would not reserve. The count is bounded: all elements lie inside the buffer.
            let mut out = Vec::with_capacity(layout.count);
            for index in 0..layout.count {
                out.push(decode(element(data, span, index).ok_or_else(out_of_bounds)?));
            }
            out
        }
    };
    let Some(sparse) = layout.sparse else { return Ok(out) };
    let (indices, values) = (buffers.get(sparse.indices.buffer)?, buffers.get(sparse.values.buffer)?);
    let mut next = 0;
    for number in 0..sparse.count {
        let index = unsigned(element(indices, sparse.indices, number).ok_or_else(out_of_bounds)?) as usize;
        let value = decode(element(values, sparse.values, number).ok_or_else(out_of_bounds)?);
        let Some(slot) = out.get_mut(index).filter(|_| index >= next) else {
            let fault = format!("sparse index {index} is out of order, or not below its count {}", layout.count);
            return Err(SceneError::invalid(layout.place.as_str(), fault));
        };
        *slot = value;
        next = index + 1;
    }
    Ok(out)
}

fn element(data: &[u8], span: Span, index: usize) -> Option<&[u8]> {
    let start = span.stride.checked_mul(index)?.checked_add(span.start)?;
    data.get(start..start.checked_add(span.element_bytes)?)
}

/// An unsigned integer of 1, 2 or 4 bytes.
fn unsigned(bytes: &[u8]) -> u32 {
    match *bytes {
        [a] => a.into(),
        [a, b] => u16::from_le_bytes([a, b]).into(),
        [a, b, c, d] => u32::from_le_bytes([a, b, c, d]),
        _ => 0,
    }
}

#[expect(clippy::cast_precision_loss, reason = "32-bit integers are no vertex attributes; the others fit f32")]
fn float(component: ComponentType, normalized: bool, bytes: &[u8]) -> f32 {
    let (value, full) = match (component, bytes) {
        (ComponentType::I8, &[a]) => (f32::from(i8::from_le_bytes([a])), 127.0),
        (ComponentType::U8, &[a]) => (f32::from(a), 255.0),
        (ComponentType::I16, &[a, b]) => (f32::from(i16::from_le_bytes([a, b])), 32767.0),
        (ComponentType::U16, &[a, b]) => (f32::from(u16::from_le_bytes([a, b])), 65535.0),
        (ComponentType::F32, &[a, b, c, d]) => return f32::from_le_bytes([a, b, c, d]),
        _ => (unsigned(bytes) as f32, 1.0),
    };
    if normalized { (value / full).max(-1.0) } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reads one accessor over a buffer of the bytes 0 to 255.
    fn read<T>(accessor: &str, views: &str, read: impl Fn(&Root, &Buffers<'_>) -> T) -> T {
        let bin: Vec<u8> = (0..=255).collect();
        let json = format!(
            r#"{{"asset":{{"version":"2.0"}},"buffers":[{{"byteLength":256}}],
            "bufferViews":[{views}],"accessors":[{accessor}]}}"#
        );
        let document = crate::reader::json::parse(json.as_bytes()).unwrap();
        let buffers = Buffers::load(&document.json, Some(&bin), ".".as_ref()).unwrap();
        read(&document.json, &buffers)
    }

    fn read_indices(accessor: &str, views: &str) -> Result<Vec<u32>, String> {
        read(accessor, views, |json, buffers| indices(json, buffers, Index::new(0)).map_err(|error| error.to_string()))
    }

    const VIEW: &str = r#"{"buffer":0,"byteOffset":4,"byteLength":16}"#;

    #[test]
    fn indices_of_every_width() {
        let at = |code: u32, count: u32| {
            read_indices(&format!(r#"{{"bufferView":0,"componentType":{code},"count":{count},"type":"SCALAR"}}"#), VIEW)
        };
        assert_eq!(at(5121, 3).unwrap(), [4, 5, 6]);
        assert_eq!(at(5123, 2).unwrap(), [0x0504, 0x0706]);
        assert_eq!(at(5125, 4).unwrap(), [0x0706_0504, 0x0b0a_0908, 0x0f0e_0d0c, 0x1312_1110]);
        assert!(at(5125, 5).unwrap_err().contains("16 bytes"));
        assert!(at(5126, 1).is_err());
        assert!(at(5124, 1).unwrap_err().contains("component type"));
        assert!(at(5121, 0).unwrap().is_empty());
    }

    #[test]
    fn strides_skip_and_normalised_integers_are_fractions() {
        let accessor =
            r#"{"bufferView":0,"byteOffset":1,"componentType":5121,"normalized":true,"count":2,"type":"VEC3"}"#;
        let views = r#"{"buffer":0,"byteOffset":4,"byteLength":16,"byteStride":8}"#;
        let got = read(accessor, views, |json, buffers| vectors::<3>(json, buffers, Index::new(0))).unwrap();
        assert_eq!(got, [[5.0, 6.0, 7.0].map(|v: f32| v / 255.0), [13.0, 14.0, 15.0].map(|v: f32| v / 255.0)]);
        assert!(float(ComponentType::I8, true, &[0x80]) == -1.0 && float(ComponentType::I16, true, &[1, 0x80]) == -1.0);
    }

    #[test]
    fn sparse_elements_override_zeros_and_are_checked() {
        let sparse = |offset: u32, count: u32| {
            format!(
                r#"{{"componentType":5121,"count":16,"type":"SCALAR","sparse":{{"count":2,"indices":{{"bufferView":0,
                "byteOffset":{offset},"componentType":5121}},"values":{{"bufferView":0,"byteOffset":8}}}}}}"#
            )
            .replace(r#""sparse":{"count":2"#, &format!(r#""sparse":{{"count":{count}"#))
        };
        let got = read_indices(&sparse(0, 2), VIEW).unwrap();
        assert_eq!(got, [0, 0, 0, 0, 12, 13, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        assert!(read_indices(&sparse(12, 2), VIEW).unwrap_err().contains("sparse index 16"));
        assert!(read_indices(&sparse(0, 17), VIEW).unwrap_err().contains("17 elements of 16"));
        assert!(read_indices(&sparse(15, 2), VIEW).unwrap_err().contains("beyond buffer view"));
    }

    #[test]
    fn offsets_cannot_overflow() {
        let max = u64::MAX;
        let accessor =
            format!(r#"{{"bufferView":0,"byteOffset":{max},"componentType":5121,"count":3,"type":"SCALAR"}}"#);
        assert!(read_indices(&accessor, VIEW).is_err());
        let accessor = r#"{"bufferView":0,"componentType":5121,"count":3,"type":"SCALAR"}"#;
        let view = format!(r#"{{"buffer":0,"byteOffset":{max},"byteLength":{max}}}"#);
        assert!(read_indices(accessor, &view).is_err());
    }
}
