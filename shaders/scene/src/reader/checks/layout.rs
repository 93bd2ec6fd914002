//! Checks where an accessor's elements lie (glTF 2.0, §3.6.2).
//!
//! Offsets need not be aligned, although the specification asks for it: alignment matters if buffers are mapped, and
//! bytes are copied here. `min` and `max` are not read: bounds are computed.

use gltf::json::{
    Accessor, Index, Root,
    accessor::{ComponentType, Type, sparse::Sparse},
    buffer::View,
    validation::{Checked, USize64},
};

use crate::{
    error::{SceneError, place, within},
    limits::MAX_ACCESSOR_ELEMENTS,
};

/// Returns whether vertex indices may be of this type.
pub(crate) const fn is_unsigned(component: ComponentType) -> bool {
    matches!(component, ComponentType::U8 | ComponentType::U16 | ComponentType::U32)
}

/// Elements in a buffer. The last one ends inside the buffer's declared length.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Span {
    pub(crate) buffer: usize,
    pub(crate) start: usize,
    pub(crate) stride: usize,
    pub(crate) element_bytes: usize,
}

#[derive(Debug)]
pub(crate) struct Layout {
    pub(crate) place: String,
    /// Number of elements, at least 1.
    pub(crate) count: usize,
    pub(crate) component: ComponentType,
    pub(crate) normalized: bool,
    /// A scalar or a vector.
    pub(crate) shape: Type,
    /// `None` if all elements are zeros.
    pub(crate) base: Option<Span>,
    pub(crate) sparse: Option<SparseLayout>,
}

/// Elements that override an accessor's.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SparseLayout {
    pub(crate) count: usize,
    pub(crate) indices: Span,
    pub(crate) values: Span,
}

/// Checks every scalar and vector accessor of the file, used or not, and every buffer view.
/// Errors as [`Layout::new`].
pub(crate) fn check(json: &Root) -> Result<(), SceneError> {
    for (index, accessor) in json.accessors.iter().enumerate() {
        // Matrices and types of later versions are legal if nothing reads them.
        if shape(accessor).is_some() {
            Layout::new(json, index)?;
        }
    }
    for index in 0..json.buffer_views.len() {
        view_range(json, index)?;
    }
    Ok(())
}

/// Returns the type of an accessor's elements. `None` for matrices, which skins have, and for types that do not exist.
fn shape(accessor: &Accessor) -> Option<Type> {
    match accessor.type_ {
        Checked::Valid(shape @ (Type::Scalar | Type::Vec2 | Type::Vec3 | Type::Vec4)) => Some(shape),
        Checked::Valid(_) | Checked::Invalid => None,
    }
}

impl Layout {
    /// Checks accessor `index`.
    /// Errors if there is none, it is malformed, or it reaches beyond its buffer view.
    pub(crate) fn new(json: &Root, index: usize) -> Result<Self, SceneError> {
        let place = place("accessor", index, None);
        let Some(accessor) = json.accessors.get(index) else {
            return Err(SceneError::invalid(place, "there is no such accessor"));
        };
        let Checked::Valid(component) = accessor.component_type else {
            return Err(SceneError::invalid(place, "its component type is none of 5120 to 5123, 5125 and 5126"));
        };
        let component = component.0;
        let Some(shape) = shape(accessor) else {
            return Err(SceneError::invalid(place, "its type is not SCALAR, VEC2, VEC3 or VEC4: it is not read here"));
        };
        let element_bytes = component.size() * shape.multiplicity();
        let count = element_count(&place, accessor)?;
        if accessor.normalized && matches!(component, ComponentType::F32 | ComponentType::U32) {
            return Err(SceneError::invalid(place, "floats and 32-bit integers cannot be normalised"));
        }
        let offset = accessor.byte_offset.unwrap_or_default();
        let base = match accessor.buffer_view {
            Some(view) => Some(span(json, &place, (view, offset), count, element_bytes, true)?),
            None if offset.0 > 0 => {
                return Err(SceneError::invalid(place, "it has an offset, but no buffer view"));
            }
            None => None,
        };
        let sparse = match &accessor.sparse {
            Some(sparse) => Some(sparse_layout(json, &place, sparse, count, element_bytes)?),
            None => None,
        };
        Ok(Self { place, count, component, normalized: accessor.normalized, shape, base, sparse })
    }
}

fn element_count(place: &str, accessor: &Accessor) -> Result<usize, SceneError> {
    within(format!("elements of {place}"), accessor.count.0, MAX_ACCESSOR_ELEMENTS)?;
    match usize::try_from(accessor.count.0) {
        Ok(count) if count > 0 => Ok(count),
        _ => Err(SceneError::invalid(place, "its count is 0")),
    }
}

fn sparse_layout(
    json: &Root,
    place: &str,
    sparse: &Sparse,
    base_count: usize,
    element_bytes: usize,
) -> Result<SparseLayout, SceneError> {
    let Some(count) = usize::try_from(sparse.count.0).ok().filter(|count| (1..=base_count).contains(count)) else {
        let fault = format!("its sparse part overrides {} elements of {base_count}", sparse.count.0);
        return Err(SceneError::invalid(place, fault));
    };
    let Checked::Valid(component) = sparse.indices.component_type else {
        return Err(SceneError::invalid(place, "its sparse indices are not unsigned integers"));
    };
    let indices = (sparse.indices.buffer_view, sparse.indices.byte_offset);
    let values = (sparse.values.buffer_view, sparse.values.byte_offset);
    Ok(SparseLayout {
        count,
        indices: span(json, place, indices, count, component.0.size(), false)?,
        values: span(json, place, values, count, element_bytes, false)?,
    })
}

/// Returns the span of `count` elements at an offset in a buffer view.
fn span(
    json: &Root,
    place: &str,
    (view, offset): (Index<View>, USize64),
    count: usize,
    element_bytes: usize,
    may_stride: bool,
) -> Result<Span, SceneError> {
    let (index, offset) = (view.value(), offset.0);
    let (buffer, view_start, view_bytes) = view_range(json, index)?;
    let stride = json.buffer_views.get(index).and_then(|view| view.byte_stride);
    let stride = match stride.map(|stride| stride.0 as u64) {
        Some(stride) if may_stride && stride >= element_bytes as u64 => stride,
        Some(stride) => {
            let fault =
                format!("buffer view {view} has a stride of {stride} bytes; not for elements of {element_bytes}");
            return Err(SceneError::invalid(place, fault));
        }
        None => element_bytes as u64,
    };
    let end = (count as u64 - 1)
        .checked_mul(stride)
        .and_then(|last| last.checked_add(offset)?.checked_add(element_bytes as u64))
        .filter(|end| *end <= view_bytes);
    if end.is_none() {
        let fault = format!(
            "{count} elements of {element_bytes} bytes, {stride} apart, from byte {offset} on, reach beyond buffer \
             view {view} of {view_bytes} bytes"
        );
        return Err(SceneError::invalid(place, fault));
    }
    // Both fit: they lie inside a view whose range fits.
    let (Ok(start), Ok(stride)) = (usize::try_from(view_start + offset), usize::try_from(stride)) else {
        return Err(SceneError::invalid(place, "its offset does not fit this machine's addresses"));
    };
    Ok(Span { buffer, start, stride, element_bytes })
}

/// Returns a buffer view's buffer, first byte and length, which lie inside the buffer's declared length.
/// Errors if it reaches beyond its buffer, or its stride is not legal.
pub(crate) fn view_range(json: &Root, index: usize) -> Result<(usize, u64, u64), SceneError> {
    let place = || place("buffer view", index, None);
    let Some(view) = json.buffer_views.get(index) else {
        return Err(SceneError::invalid(place(), "there is no such buffer view"));
    };
    let buffer_bytes = json.get(view.buffer).map_or(0, |buffer| buffer.byte_length.0);
    let (start, bytes) = (view.byte_offset.unwrap_or_default().0, view.byte_length.0);
    let end = start.checked_add(bytes).filter(|end| *end <= buffer_bytes);
    if end.is_none() || bytes == 0 {
        let fault =
            format!("{bytes} bytes from byte {start} on do not lie in buffer {} of {buffer_bytes} bytes", view.buffer);
        return Err(SceneError::invalid(place(), fault));
    }
    if let Some(stride) = view.byte_stride.map(|stride| stride.0 as u64)
        && !((4..=252).contains(&stride) && stride.is_multiple_of(4) && stride <= bytes)
    {
        let fault =
            format!("its stride is {stride}, not a multiple of 4 from 4 to 252 and to its length of {bytes} bytes");
        return Err(SceneError::invalid(place(), fault));
    }
    Ok((view.buffer.value(), start, bytes))
}
