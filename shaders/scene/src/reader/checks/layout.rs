//! Checks where an accessor's elements lie (glTF 2.0, §3.6.2).
//!
//! Offsets need not be aligned, although the specification asks for it: alignment matters if buffers are mapped, and
//! bytes are copied here. Strides may have any length, and accessors no elements: other viewers bear both. `min` and
//! `max` are not read: bounds are computed.

use gltf::json::{
    Accessor, Index, Root,
    accessor::{ComponentType, Type, sparse::Sparse},
    buffer::View,
    validation::{Checked, USize64},
};

use crate::{
    LoadReport,
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
    /// Number of elements. 0 breaks the specification.
    pub(crate) count: usize,
    pub(crate) component: ComponentType,
    pub(crate) normalized: bool,
    /// A scalar, a vector, or a 4×4 matrix.
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

/// Checks every accessor of the file that may be read, used or not, and every buffer view.
/// Errors as [`Layout::new`].
pub(crate) fn check(json: &Root, report: &mut LoadReport) -> Result<(), SceneError> {
    for (index, accessor) in json.accessors.iter().enumerate() {
        // Other matrices and types of later versions are legal if nothing reads them.
        if shape(accessor).is_none() {
            continue;
        }
        let layout = Layout::new(json, index)?;
        if accessor.normalized && !layout.normalized {
            report.mended("normalised floats or 32-bit integers: taken as they are", &layout.place);
        }
        if accessor.buffer_view.is_none() && accessor.byte_offset.is_some_and(|offset| offset.0 > 0) {
            report.mended("an offset without a buffer view: ignored", &layout.place);
        }
        if accessor.sparse.as_ref().is_some_and(|sparse| sparse.count.0 == 0) {
            report.mended("a sparse part without elements: ignored", &layout.place);
        }
    }
    for (index, view) in json.buffer_views.iter().enumerate() {
        view_range(json, index)?;
        let stride = view.byte_stride.map(|stride| stride.0);
        if stride.is_some_and(|stride| !((4..=252).contains(&stride) && stride.is_multiple_of(4))) {
            let what = "a stride that is not a multiple of 4 from 4 to 252: taken as it is";
            report.mended(what, &place("buffer view", index, None));
        }
    }
    Ok(())
}

/// Returns the type of an accessor's elements. `None` for small matrices, and for types that do not exist.
fn shape(accessor: &Accessor) -> Option<Type> {
    match accessor.type_ {
        Checked::Valid(shape @ (Type::Scalar | Type::Vec2 | Type::Vec3 | Type::Vec4 | Type::Mat4)) => Some(shape),
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
            return Err(SceneError::invalid(
                place,
                "its type is not SCALAR, VEC2, VEC3, VEC4 or MAT4: it is not read here",
            ));
        };
        let element_bytes = component.size() * shape.multiplicity();
        let count = element_count(&place, accessor)?;
        let normalized = accessor.normalized && !matches!(component, ComponentType::F32 | ComponentType::U32);
        let offset = accessor.byte_offset.unwrap_or_default();
        let base = match accessor.buffer_view {
            Some(view) if count > 0 => Some(span(json, &place, (view, offset), count, element_bytes, true)?),
            _ => None,
        };
        let sparse = match &accessor.sparse {
            Some(sparse) if sparse.count.0 > 0 => Some(sparse_layout(json, &place, sparse, count, element_bytes)?),
            _ => None,
        };
        Ok(Self { place, count, component, normalized, shape, base, sparse })
    }
}

fn element_count(place: &str, accessor: &Accessor) -> Result<usize, SceneError> {
    within(format!("elements of {place}"), accessor.count.0, MAX_ACCESSOR_ELEMENTS)?;
    usize::try_from(accessor.count.0).map_err(|_| SceneError::invalid(place, "its count does not fit this machine"))
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
    // Indices and values of sparse parts lie densely (§3.6.2.3). A stride of 0 counts as none, as in other viewers.
    let stride = json.buffer_views.get(index).and_then(|view| view.byte_stride).filter(|_| may_stride);
    let stride = stride.map(|stride| stride.0 as u64).filter(|stride| *stride > 0).unwrap_or(element_bytes as u64);
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
/// Errors if it reaches beyond its buffer.
pub(crate) fn view_range(json: &Root, index: usize) -> Result<(usize, u64, u64), SceneError> {
    let place = || place("buffer view", index, None);
    let Some(view) = json.buffer_views.get(index) else {
        return Err(SceneError::invalid(place(), "there is no such buffer view"));
    };
    let buffer_bytes = json.get(view.buffer).map_or(0, |buffer| buffer.byte_length.0);
    let (start, bytes) = (view.byte_offset.unwrap_or_default().0, view.byte_length.0);
    let end = start.checked_add(bytes).filter(|end| *end <= buffer_bytes);
    if end.is_none() {
        let fault =
            format!("{bytes} bytes from byte {start} on do not lie in buffer {} of {buffer_bytes} bytes", view.buffer);
        return Err(SceneError::invalid(place(), fault));
    }
    Ok((view.buffer.value(), start, bytes))
}
