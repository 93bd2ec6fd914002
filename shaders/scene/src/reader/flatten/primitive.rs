//! Reads one primitive in its mesh's own space. Lists, strips and fans, indexed or not, become lists of triangles.
//!
//! Positions and indices must be readable; everything else is left out or mended where it is not.

use glam::{Vec2, Vec3, Vec4};
use gltf::json::{
    Accessor, Index,
    mesh::{self, Primitive, Semantic},
    validation::Checked,
};

use super::{accessor, coordinates::Plan};
use crate::{
    LoadReport,
    error::{SceneError, within},
    limits::{MAX_TRIANGLES, MAX_UV, MAX_VERTICES, is_legal_uv},
    reader::{
        checks::layout::Layout,
        file::buffers::Buffers,
        json::{Document, attribute},
        report::WarningKind,
    },
};

/// How a primitive's vertices make triangles (§3.7.2.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Mode {
    List,
    Strip,
    Fan,
}

/// A primitive's size, known from the JSON alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Size {
    pub(crate) triangles: u64,
    pub(crate) vertices: u64,
}

/// A primitive's vertices and triangles. Optional attributes have an element for each position.
#[derive(Clone)]
pub(crate) struct Geometry {
    pub(crate) positions: Vec<Vec3>,
    /// Not normalised; zero or NaN if broken. `None` asks for flat normals.
    pub(crate) normals: Option<Vec<Vec3>>,
    /// Not normalised.
    pub(crate) tangents: Option<Vec<Vec4>>,
    /// Texture transform applied.
    pub(crate) uvs: Vec<Vec2>,
    pub(crate) uvs_1: Option<Vec<Vec2>>,
    pub(crate) colors: Option<Vec<Vec4>>,
    /// Corners below the number of positions.
    pub(crate) triangles: Vec<[u32; 3]>,
}

impl Mode {
    /// Returns the mode of a primitive. `None` for points and lines.
    /// Errors if there is no such mode.
    pub(crate) fn of(primitive: &Primitive, place: &str) -> Result<Option<Self>, SceneError> {
        Ok(match primitive.mode {
            Checked::Valid(mesh::Mode::Triangles) => Some(Self::List),
            Checked::Valid(mesh::Mode::TriangleStrip) => Some(Self::Strip),
            Checked::Valid(mesh::Mode::TriangleFan) => Some(Self::Fan),
            Checked::Valid(_) => None,
            Checked::Invalid => return Err(SceneError::invalid(place, "its mode is not one of 0 to 6")),
        })
    }

    /// Returns how many triangles `corners` vertices or indices make.
    fn triangles(self, corners: usize) -> usize {
        match self {
            Self::List => corners / 3,
            Self::Strip | Self::Fan => corners.saturating_sub(2),
        }
    }

    /// Returns where triangle `number`'s corners lie in the list of indices, counter-clockwise. Every second triangle
    /// of a strip is flipped.
    fn corners(self, number: usize) -> [usize; 3] {
        match self {
            Self::List => [number * 3, number * 3 + 1, number * 3 + 2],
            Self::Strip => [number, number + 1 + number % 2, number + 2 - number % 2],
            Self::Fan => [number + 1, number + 2, 0],
        }
    }
}

/// Returns a primitive's size. `None` if it has no positions, or no triangles.
/// Errors if it goes beyond [`limits`](crate::limits).
pub(crate) fn size(
    document: &Document,
    primitive: &Primitive,
    mode: Mode,
    place: &str,
    report: &mut LoadReport,
) -> Result<Option<Size>, SceneError> {
    let json = &document.json;
    // Legal (§3.7.2.1): an extension may bring the positions. None that is known does.
    let Some(positions) = attribute(primitive, Semantic::Positions) else { return Ok(None) };
    let vertices = Layout::new(json, positions.value())?.count;
    within(format!("vertices of {place}"), vertices as u64, MAX_VERTICES)?;
    let corners = match primitive.indices {
        Some(indices) => Layout::new(json, indices.value())?.count,
        None => vertices,
    };
    let triangles = mode.triangles(corners) as u64;
    if mode == Mode::List && corners % 3 != 0 {
        report.mended("corners that make no whole number of triangles: the last ones are left out", place);
    }
    if vertices == 0 || triangles == 0 {
        report.left_out("a primitive without vertices or triangles", place);
        return Ok(None);
    }
    within(format!("triangles of {place}"), triangles, MAX_TRIANGLES)?;
    // All vertices are read, even if few are used. Flat normals take three for each triangle.
    let normals = attribute(primitive, Semantic::Normals);
    let vertices = if normals.is_some() { vertices as u64 } else { (vertices as u64).max(triangles * 3) };
    within(format!("vertices of {place}"), vertices, MAX_VERTICES)?;
    Ok(Some(Size { triangles, vertices }))
}

/// Where a primitive's bytes are, and who is told what they lack.
pub(crate) struct Source<'a> {
    pub(crate) document: &'a Document,
    pub(crate) buffers: &'a Buffers<'a>,
    pub(crate) primitive: &'a Primitive,
    pub(crate) place: &'a str,
}

impl Source<'_> {
    /// Reads the primitive, with the texture coordinates and tangents that its material needs.
    /// Errors if its positions or indices cannot be read.
    pub(crate) fn read(&self, mode: Mode, plan: &Plan, report: &mut LoadReport) -> Result<Geometry, SceneError> {
        let Some(positions) = attribute(self.primitive, Semantic::Positions) else {
            return Err(SceneError::invalid(self.place, "it has no positions"));
        };
        let positions = accessor::vectors(&self.document.json, self.buffers, positions)?;
        let mut positions: Vec<Vec3> = positions.into_iter().map(Vec3::from).collect();
        let count = positions.len();
        let triangles = self.triangles(mode, &mut positions, report)?;
        let normals = self.optional(Semantic::Normals, count, report)?;
        let normals = normals.map(|normals| normals.into_iter().map(Vec3::from_array).collect());
        // Without normals, tangents mean nothing (§3.7.2.1).
        let tangents = if plan.tangents && Option::<&Vec<Vec3>>::is_some(&normals.as_ref()) {
            self.optional(Semantic::Tangents, count, report)?
        } else {
            None
        };
        let uvs = match plan.base {
            Some((set, transform)) => {
                let mut uvs = self.uvs(set, count, report)?.unwrap_or_else(|| vec![Vec2::ZERO; count]);
                if let Some(transform) = transform {
                    let matrix = transform.matrix();
                    uvs.iter_mut().for_each(|uv| *uv = matrix.transform_point2(uv.as_dvec2()).as_vec2());
                }
                self.legal(uvs, report)
            }
            None => vec![Vec2::ZERO; count],
        };
        let uvs_1 = match plan.second {
            Some(set) => self.uvs(set, count, report)?.map(|uvs| self.legal(uvs, report)),
            None => None,
        };
        Ok(Geometry {
            positions,
            normals,
            tangents: tangents.map(|tangents| tangents.into_iter().map(Vec4::from_array).collect()),
            uvs,
            uvs_1,
            colors: self.colors(count, report)?,
            triangles,
        })
    }

    /// Returns the triangles whose corners are there. Positions that are not finite become finite ones.
    fn triangles(
        &self,
        mode: Mode,
        positions: &mut [Vec3],
        report: &mut LoadReport,
    ) -> Result<Vec<[u32; 3]>, SceneError> {
        let corners = match self.primitive.indices {
            Some(indices) => accessor::indices(&self.document.json, self.buffers, indices)?,
            None => (0..).take(positions.len()).collect(),
        };
        let triangle = |number| mode.corners(number).map(|corner| corners.get(corner).copied().unwrap_or_default());
        let mut triangles: Vec<[u32; 3]> = (0..mode.triangles(corners.len())).map(triangle).collect();
        let mut keep = |what: &'static str, holds: &dyn Fn(u32) -> bool| {
            let before = triangles.len();
            triangles.retain(|corners| corners.iter().all(|corner| holds(*corner)));
            report.add(WarningKind::LeftOut, what, self.place, (before - triangles.len()) as u64);
        };
        keep("triangles with an index beyond the vertices", &|corner| (corner as usize) < positions.len());
        if positions.iter().any(|position| !position.is_finite()) {
            let finite = |corner: u32| positions.get(corner as usize).is_some_and(|position| position.is_finite());
            keep("triangles with a position that is not finite", &finite);
            let stand_in = positions.iter().copied().find(|position| position.is_finite()).unwrap_or_default();
            positions.iter_mut().filter(|position| !position.is_finite()).for_each(|position| *position = stand_in);
        }
        Ok(triangles)
    }

    /// Reads an optional attribute. `None` if there is none of this kind, or it has too few components.
    /// Errors if its bytes are not there.
    pub(crate) fn optional<const N: usize>(
        &self,
        semantic: Semantic,
        vertices: usize,
        report: &mut LoadReport,
    ) -> Result<Option<Vec<[f32; N]>>, SceneError> {
        match attribute(self.primitive, semantic) {
            Some(index) => self.elements(index, vertices, report),
            None => Ok(None),
        }
    }

    /// Reads one element of `N` components for each vertex, as [`Self::optional`].
    pub(crate) fn elements<const N: usize>(
        &self,
        index: Index<Accessor>,
        vertices: usize,
        report: &mut LoadReport,
    ) -> Result<Option<Vec<[f32; N]>>, SceneError> {
        let layout = Layout::new(&self.document.json, index.value())?;
        if layout.shape.multiplicity() < N {
            report.left_out("an attribute with too few components", &layout.place);
            return Ok(None);
        }
        if layout.count != vertices {
            report.mended("attributes with another count than the positions: cut, or filled up with zeros", self.place);
        }
        let mut elements = accessor::vectors(&self.document.json, self.buffers, index)?;
        elements.resize(vertices, [0.0; N]);
        Ok(Some(elements))
    }

    fn uvs(&self, set: u32, vertices: usize, report: &mut LoadReport) -> Result<Option<Vec<Vec2>>, SceneError> {
        let uvs = self.optional(Semantic::TexCoords(set), vertices, report)?;
        Ok(uvs.map(|uvs| uvs.into_iter().map(Vec2::from_array).collect()))
    }

    /// Brings texture coordinates into their range.
    fn legal(&self, mut uvs: Vec<Vec2>, report: &mut LoadReport) -> Vec<Vec2> {
        let mut mended = 0;
        for uv in uvs.iter_mut().filter(|uv| !is_legal_uv(**uv)) {
            let legal = |v: f32| if v.is_nan() { 0.0 } else { v.clamp(-MAX_UV, MAX_UV) };
            *uv = Vec2::new(legal(uv.x), legal(uv.y));
            mended += 1;
        }
        report.add(WarningKind::Mended, "texture coordinates that are NaN or beyond ±65536", self.place, mended);
        uvs
    }

    /// Reads vertex colours as RGBA.
    fn colors(&self, vertices: usize, report: &mut LoadReport) -> Result<Option<Vec<Vec4>>, SceneError> {
        let Some(index) = attribute(self.primitive, Semantic::Colors(0)) else { return Ok(None) };
        let layout = Layout::new(&self.document.json, index.value())?;
        if layout.shape.multiplicity() == 3 {
            let colors = self.elements::<3>(index, vertices, report)?;
            return Ok(colors.map(|colors| colors.into_iter().map(|c| Vec3::from_array(c).extend(1.0)).collect()));
        }
        let colors = self.elements::<4>(index, vertices, report)?;
        Ok(colors.map(|colors| colors.into_iter().map(Vec4::from_array).collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangles(mode: Mode, corners: usize) -> Vec<[usize; 3]> {
        (0..mode.triangles(corners)).map(|number| mode.corners(number)).collect()
    }

    #[test]
    fn modes_follow_the_specifications_formulas() {
        assert_eq!(triangles(Mode::List, 7), [[0, 1, 2], [3, 4, 5]]);
        assert_eq!(triangles(Mode::Strip, 5), [[0, 1, 2], [1, 3, 2], [2, 3, 4]]);
        assert_eq!(triangles(Mode::Fan, 5), [[1, 2, 0], [2, 3, 0], [3, 4, 0]]);
        for mode in [Mode::List, Mode::Strip, Mode::Fan] {
            assert!((0..3).all(|corners| triangles(mode, corners).is_empty()));
        }
    }
}
