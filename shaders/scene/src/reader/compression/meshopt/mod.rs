//! Decodes what `EXT_meshopt_compression` and `KHR_meshopt_compression` compress.
//!
//! Written here because the only well-kept decoder is C++: it would have to be trusted with bytes from strangers, and
//! would need a C++ compiler. The codecs are small and specified (the extension's appendices A and B).

mod attributes;
mod filters;
mod indices;
mod input;
#[cfg(test)]
mod tests;

/// Largest ratio of decoded to encoded bytes: 256 vertices' word takes at least one byte.
const MOST_GROWTH: u64 = 1024;

/// How a buffer view is compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Mode {
    Attributes(Filter),
    Triangles,
    Indices,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Filter {
    None,
    Octahedral,
    Quaternion,
    Exponential,
    Color,
}

impl Mode {
    /// Reads the extension's `mode` and `filter`.
    pub(crate) fn new(mode: &str, filter: Option<&str>) -> Result<Self, &'static str> {
        let filter = match filter.unwrap_or("NONE") {
            "NONE" => Filter::None,
            "OCTAHEDRAL" => Filter::Octahedral,
            "QUATERNION" => Filter::Quaternion,
            "EXPONENTIAL" => Filter::Exponential,
            "COLOR" => Filter::Color,
            _ => return Err("its filter is of no known kind"),
        };
        match (mode, filter) {
            ("ATTRIBUTES", filter) => Ok(Self::Attributes(filter)),
            ("TRIANGLES", Filter::None) => Ok(Self::Triangles),
            ("INDICES", Filter::None) => Ok(Self::Indices),
            ("TRIANGLES" | "INDICES", _) => Err("indices have a filter"),
            _ => Err("its mode is of no known kind"),
        }
    }
}

/// Decodes `count` elements of `stride` bytes. The caller bounds their product.
/// Errors with a sentence if the data do not hold exactly those, or count and stride do not fit the mode.
pub(crate) fn decode(mode: Mode, data: &[u8], count: usize, stride: usize) -> Result<Vec<u8>, &'static str> {
    if count as u64 * stride as u64 > data.len() as u64 * MOST_GROWTH {
        return Err("its count is beyond what its bytes can hold");
    }
    let indices = match mode {
        Mode::Attributes(filter) => return vertices(filter, data, count, stride),
        Mode::Triangles if count.is_multiple_of(3) => indices::triangles(data, count)?,
        Mode::Triangles => return Err("its count is no multiple of 3"),
        Mode::Indices => indices::sequence(data, count)?,
    };
    match stride {
        4 => Ok(indices.into_iter().flat_map(u32::to_le_bytes).collect()),
        // The low half: what does not fit is as wrong as any other index beyond the vertices.
        2 => Ok(indices.into_iter().map(u32::to_le_bytes).flat_map(|[a, b, _, _]| [a, b]).collect()),
        _ => Err("indices do not have 2 or 4 bytes"),
    }
}

fn vertices(filter: Filter, data: &[u8], count: usize, stride: usize) -> Result<Vec<u8>, &'static str> {
    let legal = match filter {
        Filter::None | Filter::Exponential => stride.is_multiple_of(4) && (4..=256).contains(&stride),
        Filter::Octahedral | Filter::Color => matches!(stride, 4 | 8),
        Filter::Quaternion => stride == 8,
    };
    if !legal {
        return Err("its stride does not fit its filter");
    }
    let mut out = attributes::decode(data, count, stride)?;
    match filter {
        Filter::None => {}
        Filter::Octahedral if stride == 4 => filters::octahedral::<1>(&mut out),
        Filter::Octahedral => filters::octahedral::<2>(&mut out),
        Filter::Quaternion => filters::quaternion(&mut out),
        Filter::Exponential => filters::exponential(&mut out),
        Filter::Color if stride == 4 => filters::color::<1>(&mut out),
        Filter::Color => filters::color::<2>(&mut out),
    }
    Ok(out)
}
