//! The alpha test of MASK triangles.

use gnomon_scene::{AlphaMode, AlphaPicture, Material, Scene, Wrap};

use crate::visibility::backend::BackendError;

/// Texture coordinates of the MASK triangles, and their materials' alpha.
#[derive(Debug)]
pub(super) struct Alpha {
    /// Index of the first MASK triangle. OPAQUE ones come first.
    first: u32,
    triangles: Vec<MaskTriangle>,
    /// Alpha of each triangle's corners. Empty if it is 1 everywhere.
    vertices: Vec<[f32; 3]>,
    materials: Vec<MaskMaterial>,
    /// One per image, however many materials use it.
    pictures: Vec<AlphaPicture>,
}

#[derive(Debug)]
struct MaskTriangle {
    uvs: [[f32; 2]; 3],
    material: u32,
}

#[derive(Debug)]
struct MaskMaterial {
    cutoff: f32,
    factor: f32,
    /// Index of the picture, and how it wraps.
    picture: Option<(usize, [Wrap; 2])>,
}

impl Alpha {
    /// Takes the triangles that stop rays and that `takes` takes. They are counted without the others.
    /// Errors if a MASK material's picture is not decoded.
    pub(super) fn new(scene: &Scene, takes: &dyn Fn(&[u32; 3]) -> bool) -> Result<Self, BackendError> {
        let (triangles, vertices, materials, pictures) = Default::default();
        let mut alpha = Self { first: 0, triangles, vertices, materials, pictures };
        let is_mask = |material: &Material| matches!(material.alpha, AlphaMode::Mask { .. });
        let vertex_alpha = scene.vertex_alpha_materials();
        let vertices_count =
            vertex_alpha.iter().zip(&scene.materials).any(|(counts, material)| *counts && is_mask(material));
        let mut places = vec![None; scene.materials.len()];
        let mut picture_places = vec![None; scene.images.len()];
        for draw in &scene.draws {
            let first = draw.first_triangle as usize;
            let of_draw =
                scene.triangles[first..first + draw.triangles as usize].iter().filter(|corners| takes(corners));
            let material = &scene.materials[draw.material as usize];
            let AlphaMode::Mask { cutoff } = material.alpha else {
                if material.alpha == AlphaMode::Opaque {
                    // OPAQUE draws come before MASK ones. The count is at most the scene's, which fits.
                    alpha.first += u32::try_from(of_draw.count()).unwrap_or(u32::MAX);
                }
                continue;
            };
            let place = match places[draw.material as usize] {
                Some(place) => place,
                None => {
                    let picture = match material.base_color_texture {
                        Some(texture) => {
                            let missing = || BackendError::Alpha { material: draw.material };
                            let place = picture_places.get_mut(texture.image as usize).ok_or_else(missing)?;
                            if place.is_none() {
                                let picture = scene.alpha_picture(draw.material).filter(is_decoded);
                                alpha.pictures.push(picture.ok_or_else(missing)?);
                            }
                            let place = *place.get_or_insert(alpha.pictures.len() - 1);
                            Some((place, [texture.wrap_u, texture.wrap_v]))
                        }
                        None => None,
                    };
                    alpha.materials.push(MaskMaterial { cutoff, factor: material.base_color.w, picture });
                    *places[draw.material as usize].insert(alpha.materials.len() - 1)
                }
            };
            let place = u32::try_from(place).map_err(|_| BackendError::Alpha { material: draw.material })?;
            for triangle in of_draw {
                let uvs = triangle.map(|i| scene.uvs[i as usize].to_array());
                alpha.triangles.push(MaskTriangle { uvs, material: place });
                if vertices_count {
                    alpha.vertices.push(triangle.map(|i| scene.vertex_alpha(i)));
                }
            }
        }
        Ok(alpha)
    }

    /// Returns whether a point of MASK triangle `triangle` passes the alpha test. `weights` need not sum to 1.
    pub(super) fn passes(&self, triangle: u32, weights: [f32; 3]) -> bool {
        let place = (triangle - self.first) as usize;
        let triangle = &self.triangles[place];
        let material = &self.materials[triangle.material as usize];
        let sum = weights[0] + weights[1] + weights[2];
        let mixed = |[a, b, c]: [f32; 3]| (a * weights[0] + b * weights[1] + c * weights[2]) / sum;
        let factor = match self.vertices.get(place) {
            // Rounding must not take from what is solid.
            Some([1.0, 1.0, 1.0]) | None => material.factor,
            Some(alphas) => material.factor * mixed(*alphas),
        };
        let Some((picture, wraps)) = material.picture else { return factor >= material.cutoff };
        let [u, v] = [0, 1].map(|i| mixed(triangle.uvs.map(|uv| uv[i])));
        sample(&self.pictures[picture], wraps, u, v) / 255.0 * factor >= material.cutoff
    }

    /// Memory of pictures and coordinates.
    pub(super) fn memory_bytes(&self) -> usize {
        self.pictures.iter().map(|picture| picture.alpha.len()).sum::<usize>()
            + size_of_val(&*self.triangles)
            + size_of_val(&*self.vertices)
    }
}

/// The bilinear sample of `picture` at (u, v), 0 to 255.
fn sample(picture: &AlphaPicture, [wrap_u, wrap_v]: [Wrap; 2], u: f32, v: f32) -> f32 {
    #[expect(clippy::cast_precision_loss, reason = "pictures are smaller than 2^24 pixels a side")]
    let (x, y) = (u * picture.width as f32 - 0.5, v * picture.height as f32 - 0.5);
    let (x0, y0) = (x.floor(), y.floor());
    let columns = texels(x0, picture.width, wrap_u);
    let rows = texels(y0, picture.height, wrap_v);
    let at = |x: u32, y: u32| f32::from(picture.alpha[y as usize * picture.width as usize + x as usize]);
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let row = |y: u32| mix(at(columns[0], y), at(columns[1], y), x - x0);
    mix(row(rows[0]), row(rows[1]), y - y0)
}

fn is_decoded(picture: &AlphaPicture) -> bool {
    !picture.alpha.is_empty() && picture.alpha.len() == picture.width as usize * picture.height as usize
}

/// The texels `at` and `at + 1` of a side of `size` texels, wrapped.
fn texels(at: f32, size: u32, wrap: Wrap) -> [u32; 2] {
    #[expect(clippy::cast_possible_truncation, reason = "the cast saturates, and any texel will do that far out")]
    let first = i64::from(at as i32);
    let size = i64::from(size);
    [first, first + 1].map(|i| {
        let wrapped = match wrap {
            Wrap::Repeat => i.rem_euclid(size),
            Wrap::MirroredRepeat => {
                let i = i.rem_euclid(2 * size);
                i.min(2 * size - 1 - i)
            }
            Wrap::ClampToEdge => i.clamp(0, size - 1),
        };
        u32::try_from(wrapped).unwrap_or(0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visibility::test_scenes::{LEAF, room};

    fn picture() -> AlphaPicture {
        AlphaPicture { width: 4, height: 2, alpha: vec![0, 40, 80, 120, 200, 200, 200, 200] }
    }

    #[test]
    fn materials_share_the_picture_of_their_image() {
        let mut scene = room();
        let mut other = scene.materials[LEAF as usize].clone();
        other.alpha = AlphaMode::Mask { cutoff: 0.25 };
        scene.materials.push(other);
        let at = scene.draws.iter().position(|draw| draw.material == LEAF && draw.triangles > 1).unwrap();
        let mut rest = scene.draws[at];
        scene.draws[at].triangles = 1;
        (rest.first_triangle, rest.triangles) = (rest.first_triangle + 1, rest.triangles - 1);
        rest.material = u32::try_from(scene.materials.len() - 1).unwrap();
        scene.draws.insert(at + 1, rest);
        let alpha = Alpha::new(&scene, &|_| true).unwrap();
        assert_eq!((alpha.materials.len(), alpha.pictures.len()), (2, 1));
    }

    #[test]
    fn a_missing_picture_is_an_error() {
        let mut scene = room();
        scene.images.iter_mut().for_each(|image| image.rgba.clear());
        assert!(matches!(Alpha::new(&scene, &|_| true), Err(BackendError::Alpha { material: LEAF })));
    }

    #[test]
    fn samples_are_exact_at_texel_centres_and_bilinear_between_them() {
        let wraps = [Wrap::ClampToEdge; 2];
        assert_eq!(sample(&picture(), wraps, 0.375, 0.25), 40.0);
        assert_eq!(sample(&picture(), wraps, 0.5, 0.25), 60.0);
        assert_eq!(sample(&picture(), wraps, 0.375, 0.5), 120.0);
    }

    #[test]
    fn coordinates_wrap_by_each_mode() {
        for (wrap, left, right) in
            [(Wrap::ClampToEdge, 0.0, 120.0), (Wrap::Repeat, 60.0, 60.0), (Wrap::MirroredRepeat, 0.0, 120.0)]
        {
            assert_eq!(sample(&picture(), [wrap, Wrap::ClampToEdge], 0.0, 0.25), left, "{wrap:?}");
            assert_eq!(sample(&picture(), [wrap, Wrap::ClampToEdge], 1.0, 0.25), right, "{wrap:?}");
        }
        assert_eq!(sample(&picture(), [Wrap::Repeat; 2], 5.375, -2.75), 40.0);
        assert_eq!(sample(&picture(), [Wrap::MirroredRepeat; 2], 1.875, 0.25), 0.0);
        assert_eq!(sample(&picture(), [Wrap::MirroredRepeat; 2], 2.375, 0.25), 40.0);
    }

    #[test]
    fn extreme_coordinates_do_not_panic() {
        for u in [f32::MAX, f32::MIN, f32::INFINITY, f32::NAN, 1e20, -1e20] {
            for wrap in [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge] {
                let value = sample(&picture(), [wrap; 2], u, u);
                assert!(value.is_nan() || (0.0..=255.0).contains(&value), "{u} gives {value}");
            }
        }
    }
}
