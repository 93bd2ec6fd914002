//! Where an accessor's elements lie, checked from the JSON alone before any buffer is read (glTF 2.0, §3.6.2).
//!
//! Offsets need not be aligned, although the specification asks for it: alignment matters to who maps buffers, and bytes
//! are copied here. `min` and `max` are not read: bounds are computed.

use crate::reader::json::document::{Accessor, Document, Sparse};
use crate::{
    error::{SceneError, place, within},
    limits::MAX_ACCESSOR_ELEMENTS,
};

/// A component's type (§3.6.2.2).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn new(place: &str, code: u32) -> Result<Self, SceneError> {
        Ok(match code {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return Err(SceneError::invalid(place, format!("its component type {code} does not exist"))),
        })
    }

    /// Bytes of one component.
    pub(crate) const fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// Whether it can count: the types that indices have.
    pub(crate) const fn is_unsigned(self) -> bool {
        matches!(self, Self::U8 | Self::U16 | Self::U32)
    }
}

/// Types of elements and their components. Matrices belong to skins, which are not read.
const SHAPES: [(&str, usize); 4] = [("SCALAR", 1), ("VEC2", 2), ("VEC3", 3), ("VEC4", 4)];

/// A run of elements in a buffer. The last one ends inside the buffer's declared length.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Span {
    pub(crate) buffer: usize,
    pub(crate) start: usize,
    pub(crate) stride: usize,
    pub(crate) element_bytes: usize,
}

/// An accessor.
#[derive(Debug)]
pub(crate) struct Layout {
    /// For messages.
    pub(crate) place: String,
    /// Number of elements, at least 1.
    pub(crate) count: usize,
    pub(crate) component: Component,
    pub(crate) normalized: bool,
    /// SCALAR, VEC2, ….
    pub(crate) shape: &'static str,
    /// None: all zeros.
    pub(crate) base: Option<Span>,
    pub(crate) sparse: Option<SparseLayout>,
}

/// An accessor's overrides.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SparseLayout {
    /// Number of overridden elements.
    pub(crate) count: usize,
    pub(crate) indices: Span,
    pub(crate) values: Span,
}

/// Checks the layout of every scalar and vector accessor of the file, whatever it is for.
///
/// # Errors
/// As [`Layout::new`].
pub(crate) fn check(document: &Document<'_>) -> Result<(), SceneError> {
    for (index, accessor) in document.accessors.iter().enumerate() {
        // Matrices, and types of a later version, are legal where nothing reads them.
        if SHAPES.iter().any(|(name, _)| *name == accessor.shape) {
            Layout::new(document, index)?;
        }
    }
    for index in 0..document.buffer_views.len() {
        view_range(document, index)?;
    }
    Ok(())
}

impl Layout {
    /// Checks accessor `index`.
    ///
    /// # Errors
    /// When there is none, it is malformed, or it reaches beyond its buffer view.
    pub(crate) fn new(document: &Document<'_>, index: usize) -> Result<Self, SceneError> {
        let place = place("accessor", index, None);
        let Some(accessor) = document.accessors.get(index) else {
            return Err(SceneError::invalid(place, "there is no such accessor"));
        };
        let component = Component::new(&place, accessor.component_type)?;
        let Some((shape, lanes)) = SHAPES.iter().find(|(name, _)| *name == accessor.shape) else {
            return Err(SceneError::invalid(place, format!("its type {:.16?} is not read here", accessor.shape)));
        };
        let element_bytes = component.bytes() * lanes;
        let count = element_count(&place, accessor)?;
        if accessor.normalized && matches!(component, Component::F32 | Component::U32) {
            return Err(SceneError::invalid(place, "floats and 32-bit integers cannot be normalised"));
        }
        let base = match accessor.buffer_view {
            Some(view) => Some(span(document, &place, (view, accessor.byte_offset), count, element_bytes, true)?),
            None if accessor.byte_offset > 0 => {
                return Err(SceneError::invalid(place, "it has an offset, but no buffer view"));
            }
            None => None,
        };
        let sparse = match &accessor.sparse {
            Some(sparse) => Some(sparse_layout(document, &place, sparse, count, element_bytes)?),
            None => None,
        };
        Ok(Self { place, count, component, normalized: accessor.normalized, shape, base, sparse })
    }
}

fn element_count(place: &str, accessor: &Accessor) -> Result<usize, SceneError> {
    within(format!("elements of {place}"), accessor.count, MAX_ACCESSOR_ELEMENTS)?;
    match usize::try_from(accessor.count) {
        Ok(count) if count > 0 => Ok(count),
        _ => Err(SceneError::invalid(place, "its count is 0")),
    }
}

fn sparse_layout(
    document: &Document<'_>,
    place: &str,
    sparse: &Sparse,
    base_count: usize,
    element_bytes: usize,
) -> Result<SparseLayout, SceneError> {
    let Some(count) = usize::try_from(sparse.count).ok().filter(|count| (1..=base_count).contains(count)) else {
        let fault = format!("its sparse part overrides {} elements of {base_count}", sparse.count);
        return Err(SceneError::invalid(place, fault));
    };
    let component = Component::new(place, sparse.indices.component_type)?;
    if !component.is_unsigned() {
        return Err(SceneError::invalid(place, "its sparse indices are not unsigned integers"));
    }
    let indices = (sparse.indices.buffer_view, sparse.indices.byte_offset);
    let values = (sparse.values.buffer_view, sparse.values.byte_offset);
    Ok(SparseLayout {
        count,
        indices: span(document, place, indices, count, component.bytes(), false)?,
        values: span(document, place, values, count, element_bytes, false)?,
    })
}

/// The span of `count` elements at an offset of a buffer view.
fn span(
    document: &Document<'_>,
    place: &str,
    (view, offset): (u32, u64),
    count: usize,
    element_bytes: usize,
    may_stride: bool,
) -> Result<Span, SceneError> {
    let index = view as usize;
    let (buffer, view_start, view_bytes) = view_range(document, index)?;
    let stride = document.buffer_views.get(index).and_then(|view| view.byte_stride);
    let stride = match stride {
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
            "{count} elements of {element_bytes} bytes, {stride} apart, from byte {offset} on, reach beyond buffer view \
             {view} of {view_bytes} bytes"
        );
        return Err(SceneError::invalid(place, fault));
    }
    // Both fit: they lie inside a view whose range fits.
    let (Ok(start), Ok(stride)) = (usize::try_from(view_start + offset), usize::try_from(stride)) else {
        return Err(SceneError::invalid(place, "its offset does not fit this machine's addresses"));
    };
    Ok(Span { buffer, start, stride, element_bytes })
}

/// A buffer view's buffer, first byte and length, inside the buffer's declared length.
///
/// # Errors
/// When it reaches beyond its buffer, or its stride is not one.
pub(crate) fn view_range(document: &Document<'_>, index: usize) -> Result<(usize, u64, u64), SceneError> {
    let place = || place("buffer view", index, None);
    let Some(view) = document.buffer_views.get(index) else {
        return Err(SceneError::invalid(place(), "there is no such buffer view"));
    };
    let buffer_bytes = document.buffers.get(view.buffer as usize).map_or(0, |buffer| buffer.byte_length);
    let end = view.byte_offset.checked_add(view.byte_length).filter(|end| *end <= buffer_bytes);
    if end.is_none() || view.byte_length == 0 {
        let fault = format!(
            "{} bytes from byte {} on do not lie in buffer {} of {buffer_bytes} bytes",
            view.byte_length, view.byte_offset, view.buffer
        );
        return Err(SceneError::invalid(place(), fault));
    }
    if let Some(stride) = view.byte_stride
        && !((4..=252).contains(&stride) && stride.is_multiple_of(4) && stride <= view.byte_length)
    {
        let fault = format!(
            "its stride is {stride}, not a multiple of 4 from 4 to 252 and to its length of {} bytes",
            view.byte_length
        );
        return Err(SceneError::invalid(place(), fault));
    }
    Ok((view.buffer as usize, view.byte_offset, view.byte_length))
}
