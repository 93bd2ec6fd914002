//! Which texture coordinates a material reads, and where its textures lie on them.
//!
//! [`Scene::uvs`](crate::Scene::uvs) hold the base colour's set with its transform applied: tracers read them as they
//! are. Without a base colour texture they hold the set of the material's first texture. Other textures of that set get
//! a map relative to it; those of another set read [`Scene::uvs_1`](crate::Scene::uvs_1), which holds it as it is.

use glam::{DMat3, Vec3};

use crate::{
    Coordinates,
    light::f32_of,
    reader::json::{TextureInfo, TextureTransform},
};

/// What a material reads of its primitives' vertices.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Plan {
    /// The set in `uvs`, and the transform that is applied to it.
    pub(crate) base: Option<(u32, Option<TextureTransform>)>,
    /// The set in `uvs_1`.
    pub(crate) second: Option<u32>,
    /// Whether there is a normal map.
    pub(crate) tangents: bool,
}

impl TextureTransform {
    /// Translation · rotation · scale; the rotation is counter-clockwise with v pointing down.
    pub(crate) fn matrix(&self) -> DMat3 {
        let ([x, y], [across, down]) = (self.offset, self.scale);
        let (sin, cos) = self.rotation.sin_cos();
        DMat3::from_cols_array(&[cos * across, -sin * across, 0.0, sin * down, cos * down, 0.0, x, y, 1.0])
    }
}

/// Returns the set that a texture reads.
pub(crate) fn set(info: &TextureInfo) -> u32 {
    info.extensions.transform.and_then(|transform| transform.tex_coord).unwrap_or(info.tex_coord)
}

impl Plan {
    /// Gives the base colour its coordinates. Call it before [`Self::place`].
    pub(crate) fn place_base(&mut self, info: &TextureInfo) {
        self.base = Some((set(info), info.extensions.transform));
    }

    /// Returns where another texture lies.
    /// Errors with a sentence if it would need a third set, or lies nowhere.
    pub(crate) fn place(&mut self, info: &TextureInfo) -> Result<Coordinates, &'static str> {
        let (set, transform) = (set(info), info.extensions.transform);
        let (base, base_transform) = *self.base.get_or_insert((set, None));
        let [own, under] = [transform, base_transform].map(|transform| transform.map(|t| t.matrix()));
        let own = own.unwrap_or(DMat3::IDENTITY);
        let under = under.unwrap_or(DMat3::IDENTITY);
        if set == base && own == under {
            return Ok(Coordinates::default());
        }
        // A base colour of scale 0 leaves nothing to undo: the set is read once more, as it is.
        let relative = own * under.inverse();
        let (second, map) = if set == base && relative.is_finite() { (false, relative) } else { (true, own) };
        if second && *self.second.get_or_insert(set) != set {
            return Err("a texture of a third set of texture coordinates in one material");
        }
        let row = |u: f64, v: f64, one: f64| Vec3::from_array([u, v, one].map(f32_of));
        let map = [row(map.x_axis.x, map.y_axis.x, map.z_axis.x), row(map.x_axis.y, map.y_axis.y, map.z_axis.y)];
        if map.iter().all(|row| row.is_finite()) {
            Ok(Coordinates { second, map })
        } else {
            Err("a texture whose transform overflows")
        }
    }
}
