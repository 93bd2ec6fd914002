//! Reads one primitive in its mesh's own space. Lists, strips and fans, indexed or not, become lists of triangles.

use glam::{DMat3, DVec2, Vec2, Vec3};
use gltf::json::{
    Root,
    mesh::{self, Primitive, Semantic},
    texture,
    validation::Checked,
};

use super::accessor;
use crate::{
    error::{SceneError, within},
    limits::{MAX_TRIANGLES, MAX_UV, MAX_VERTICES, is_legal_uv},
    reader::{
        checks::layout::Layout,
        file::buffers::Buffers,
        json::{TEXCOORDS, TextureTransform, attribute},
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

/// Which texture coordinates a material's base colour uses.
pub(crate) struct TextureCoordinates<'a> {
    set: u32,
    transform: Option<&'a TextureTransform>,
}

impl<'a> TextureCoordinates<'a> {
    pub(crate) fn new(info: &texture::Info, transform: Option<&'a TextureTransform>) -> Self {
        let extension = info.extensions.as_ref().and_then(|extensions| extensions.texture_transform.as_ref());
        Self { set: extension.and_then(|extension| extension.tex_coord).unwrap_or(info.tex_coord), transform }
    }
}

pub(crate) struct Geometry {
    pub(crate) positions: Vec<Vec3>,
    /// Not normalised. `None` asks for flat normals; then each triangle has its own three vertices.
    pub(crate) normals: Option<Vec<Vec3>>,
    /// Texture transform applied.
    pub(crate) uvs: Vec<Vec2>,
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

/// Checks a primitive's accessors against each other, and returns its size. `None` if it has no positions.
/// Errors if its accessors' counts disagree, or it goes beyond [`limits`](crate::limits).
pub(crate) fn size(json: &Root, primitive: &Primitive, mode: Mode, place: &str) -> Result<Option<Size>, SceneError> {
    // Legal (§3.7.2.1): an extension may bring the positions. None that is known does.
    let Some(positions) = attribute(primitive, Semantic::Positions) else { return Ok(None) };
    let normals = attribute(primitive, Semantic::Normals);
    let vertices = Layout::new(json, positions.value())?.count;
    within(format!("vertices of {place}"), vertices as u64, MAX_VERTICES)?;
    let uvs = TEXCOORDS.map(|set| attribute(primitive, Semantic::TexCoords(set)));
    for other in uvs.chain([normals]).flatten() {
        let count = Layout::new(json, other.value())?.count;
        if count != vertices {
            let fault = format!("it has {vertices} positions, but {count} elements in accessor {other}");
            return Err(SceneError::invalid(place, fault));
        }
    }
    let corners = match primitive.indices {
        Some(indices) => Layout::new(json, indices.value())?.count,
        None => vertices,
    };
    if mode == Mode::List && corners % 3 != 0 {
        return Err(SceneError::invalid(place, format!("{corners} corners make no whole number of triangles")));
    }
    let triangles = mode.triangles(corners) as u64;
    within(format!("triangles of {place}"), triangles, MAX_TRIANGLES)?;
    // All vertices are read, even if few are used. Flat normals take three for each triangle.
    let vertices = if normals.is_some() { vertices as u64 } else { (vertices as u64).max(triangles * 3) };
    within(format!("vertices of {place}"), vertices, MAX_VERTICES)?;
    Ok(Some(Size { triangles, vertices }))
}

/// Reads a primitive, with texture coordinates where its material has a base colour texture.
/// Errors if an accessor is malformed, an index is out of range, or the texture's coordinates are missing.
pub(crate) fn read(
    json: &Root,
    buffers: &Buffers<'_>,
    primitive: &Primitive,
    mode: Mode,
    texture: Option<&TextureCoordinates<'_>>,
    place: &str,
) -> Result<Geometry, SceneError> {
    let Some(positions) = attribute(primitive, Semantic::Positions) else {
        return Err(SceneError::invalid(place, "it has no positions"));
    };
    let positions: Vec<Vec3> = accessor::vectors(json, buffers, positions)?.into_iter().map(Vec3::from).collect();
    let normals = match attribute(primitive, Semantic::Normals) {
        Some(normals) => Some(accessor::vectors(json, buffers, normals)?.into_iter().map(Vec3::from).collect()),
        None => None,
    };
    let uvs = match texture {
        Some(texture) => read_uvs(json, buffers, primitive, texture, place)?,
        None => vec![Vec2::ZERO; positions.len()],
    };
    let corners = match primitive.indices {
        Some(indices) => accessor::indices(json, buffers, indices)?,
        None => (0..).take(positions.len()).collect(),
    };
    if let Some(at) = corners.iter().position(|index| *index as usize >= positions.len()) {
        let index = corners.get(at).copied().unwrap_or_default();
        let fault = format!("index {at} is {index}, but there are {} vertices", positions.len());
        return Err(SceneError::invalid(place, fault));
    }
    let triangle = |number| mode.corners(number).map(|corner| corners.get(corner).copied().unwrap_or_default());
    let triangles: Vec<[u32; 3]> = (0..mode.triangles(corners.len())).map(triangle).collect();
    if normals.is_some() {
        return Ok(Geometry { positions, normals, uvs, triangles });
    }
    // Flat normals need vertices of their own for each triangle.
    let order = || triangles.iter().flatten().map(|index| *index as usize);
    Ok(Geometry {
        positions: order().filter_map(|index| positions.get(index).copied()).collect(),
        normals: None,
        uvs: order().filter_map(|index| uvs.get(index).copied()).collect(),
        triangles: (0..).step_by(3).map(|first| [first, first + 1, first + 2]).take(triangles.len()).collect(),
    })
}

fn read_uvs(
    json: &Root,
    buffers: &Buffers<'_>,
    primitive: &Primitive,
    texture: &TextureCoordinates<'_>,
    place: &str,
) -> Result<Vec<Vec2>, SceneError> {
    let TextureCoordinates { set, transform } = *texture;
    let Some(accessor) = attribute(primitive, Semantic::TexCoords(set)) else {
        let fault =
            format!("its material's base colour needs TEXCOORD_{set}, which it does not have or which is not read");
        return Err(SceneError::invalid(place, fault));
    };
    let mut uvs: Vec<Vec2> = accessor::vectors(json, buffers, accessor)?.into_iter().map(Vec2::from).collect();
    if let Some(transform) = transform {
        // KHR_texture_transform: translation * rotation * scale, rotation counter-clockwise with v pointing down.
        let [offset, scale] = [transform.offset, transform.scale].map(DVec2::from_array);
        let (sin, cos) = transform.rotation.sin_cos();
        let matrix = DMat3::from_cols_array(&[
            cos * scale.x,
            -sin * scale.x,
            0.0,
            sin * scale.y,
            cos * scale.y,
            0.0,
            offset.x,
            offset.y,
            1.0,
        ]);
        for uv in &mut uvs {
            *uv = matrix.transform_point2(uv.as_dvec2()).as_vec2();
        }
    }
    match uvs.iter().position(|uv| !is_legal_uv(*uv)) {
        Some(at) => {
            let uv = uvs.get(at).copied().unwrap_or_default();
            Err(SceneError::invalid(place, format!("texture coordinate {at} is {uv}, beyond ±{MAX_UV}")))
        }
        None => Ok(uvs),
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
