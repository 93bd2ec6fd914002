//! What alpha and transmission mean to tracers and rasteriser, decided from a scene's data (`docs/blend.md`).
//!
//! Many files mark a material BLEND because its picture has an alpha channel, whatever is in it. A BLEND surface casts
//! no shadow, so one that is solid, or solid with holes, is given back its own.

use std::{collections::HashMap, fmt, ops::Range};

use super::{
    material::{AlphaMode, Material, Texture, Wrap},
    types::{Draw, Image, Scene},
};

/// Alpha from here on counts as 1: what lies behind gives less than a fiftieth. Lossy pictures rarely reach 1.
const ONE: f32 = 0.98;

/// Alpha from here on counts as solid.
const SOLID: f32 = 0.9;

/// Alpha up to here counts as a hole.
const HOLE: f32 = 0.1;

/// A material with holes has at most this share of texels between holes and solid: the smooth edges of leaves.
const MOST_BETWEEN: f64 = 0.1;

/// And at most this many for each solid one: a soft spot in an empty picture has more.
const MOST_BETWEEN_FOR_SOLID: f64 = 1.0 / 3.0;

/// Where a BLEND material with holes becomes solid.
const CUTOFF: f32 = 0.5;

/// A surface that lets this share of light through stops no rays.
const LETS_THROUGH: f32 = 0.5;

/// Larger pictures count as used everywhere: finding out takes four bytes a texel.
const MOST_TEXELS: u64 = 1 << 24;

/// Materials whose alpha mode has changed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct AlphaChanges {
    /// BLEND without anything to see through: OPAQUE.
    pub solid: u64,
    /// BLEND with holes: MASK.
    pub with_holes: u64,
    /// OPAQUE or MASK that lets light through: BLEND.
    pub transmissive: u64,
}

impl fmt::Display for AlphaChanges {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { solid, with_holes, transmissive } = self;
        write!(
            f,
            "BLEND materials made OPAQUE {solid}, made MASK {with_holes}, transmissive ones made BLEND {transmissive}"
        )
    }
}

/// Changes alpha modes by the rules of `docs/blend.md`, and restores the order of draws. Pictures must be decoded.
pub(crate) fn apply(scene: &mut Scene) -> AlphaChanges {
    let mut draws: HashMap<u32, Vec<Draw>> = HashMap::new();
    for draw in &scene.draws {
        draws.entry(draw.material).or_default().push(*draw);
    }
    let mut changes = AlphaChanges::default();
    for index in 0..scene.materials.len() {
        let Some(draws) = u32::try_from(index).ok().and_then(|index| draws.get(&index)) else { continue };
        let Some(material) = scene.materials.get(index) else { continue };
        let (before, through) = (material.alpha, light_through(scene, material) >= LETS_THROUGH);
        let after = match before {
            AlphaMode::Opaque | AlphaMode::Mask { .. } if through => AlphaMode::Blend,
            AlphaMode::Blend if !through => Alpha::of(scene, material, draws).mode(),
            unchanged => unchanged,
        };
        match (before, after) {
            (AlphaMode::Blend, AlphaMode::Opaque) => changes.solid += 1,
            (AlphaMode::Blend, AlphaMode::Mask { .. }) => changes.with_holes += 1,
            (AlphaMode::Opaque | AlphaMode::Mask { .. }, AlphaMode::Blend) => changes.transmissive += 1,
            _ => {}
        }
        if let Some(material) = scene.materials.get_mut(index) {
            if before == AlphaMode::Opaque && after == AlphaMode::Blend {
                // OPAQUE ignores alpha, BLEND does not.
                material.base_color.w = 1.0;
            }
            material.alpha = after;
        }
    }
    if changes != AlphaChanges::default() {
        sort_draws(scene);
    }
    changes
}

/// Returns the share of light that passes a material: transmission, of what is not metal.
fn light_through(scene: &Scene, material: &Material) -> f32 {
    let factor = material.transmission.factor;
    // Textures only take away, and most materials transmit nothing.
    if factor < LETS_THROUGH {
        return factor;
    }
    let mean = |texture: Option<Texture>, channel| {
        texture.and_then(|texture| scene.images.get(texture.image as usize)).map_or(1.0, |image| mean(image, channel))
    };
    let metal = material.metallic * mean(material.metallic_roughness_texture, 2);
    factor * mean(material.transmission.texture, 0) * (1.0 - metal)
}

/// Returns the mean of a picture's channel, 0 to 1; 1 without texels.
fn mean(image: &Image, channel: usize) -> f32 {
    let texels = image.rgba.len() / 4;
    let sum: u64 = image.rgba.iter().skip(channel).step_by(4).map(|value| u64::from(*value)).sum();
    #[expect(clippy::cast_possible_truncation, reason = "a mean of bytes")]
    let mean = (sum as f64 / (texels.max(1) as f64 * 255.0)) as f32;
    if texels == 0 { 1.0 } else { mean }
}

/// Texels and triangles of a material by their alpha.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Alpha {
    /// Nothing can be seen through it.
    one: bool,
    solid: u64,
    between: u64,
    holes: u64,
}

impl Alpha {
    const SEEN_THROUGH: Self = Self { one: false, solid: 0, between: 1, holes: 0 };

    /// Collects alpha where `draws`, which are the material's, show it.
    fn of(scene: &Scene, material: &Material, draws: &[Draw]) -> Self {
        if material.base_color.w < ONE {
            return Self::SEEN_THROUGH;
        }
        let mut alpha = Self { one: true, solid: 0, between: 0, holes: 0 };
        let mut shown = Vec::new();
        for triangle in triangles(scene, draws) {
            let alphas = triangle.map(|corner| scene.vertex_alpha(corner));
            let (low, high) = (alphas.into_iter().fold(1.0, f32::min), alphas.into_iter().fold(0.0, f32::max));
            alpha.one &= low >= ONE;
            if high <= HOLE {
                alpha.holes += 1;
            } else if low < SOLID {
                // It fades from one corner to another.
                return Self::SEEN_THROUGH;
            } else {
                alpha.solid += 1;
                shown.push(triangle);
            }
        }
        let texture = material.base_color_texture;
        let image = texture.and_then(|texture| Some((texture, scene.images.get(texture.image as usize)?)));
        image.map_or(alpha, |(texture, image)| {
            let (mut of_texels, holes) = (Self { solid: 0, holes: 0, ..alpha }, alpha.holes);
            let used = Used::of(scene, &texture, image, &shown);
            for (at, texel) in image.rgba.iter().skip(3).step_by(4).enumerate() {
                if used.contains(at) {
                    of_texels.add(f32::from(*texel) / 255.0);
                }
            }
            of_texels.holes += holes;
            of_texels
        })
    }

    fn add(&mut self, alpha: f32) {
        self.one &= alpha >= ONE;
        let count = match alpha {
            alpha if alpha >= SOLID => &mut self.solid,
            alpha if alpha <= HOLE => &mut self.holes,
            _ => &mut self.between,
        };
        *count += 1;
    }

    fn mode(self) -> AlphaMode {
        let [solid, between, holes] = [self.solid, self.between, self.holes].map(|count| count as f64);
        let sharp = between <= MOST_BETWEEN * (solid + between + holes) && between <= MOST_BETWEEN_FOR_SOLID * solid;
        match self {
            Self { one: true, .. } => AlphaMode::Opaque,
            Self { solid: 1.., holes: 1.., .. } if sharp => AlphaMode::Mask { cutoff: CUTOFF },
            _ => AlphaMode::Blend,
        }
    }
}

fn triangles(scene: &Scene, draws: &[Draw]) -> impl Iterator<Item = [u32; 3]> {
    let of_draw = |draw: &Draw| {
        let first = draw.first_triangle as usize;
        scene.triangles.get(first..first + draw.triangles as usize).unwrap_or_default()
    };
    draws.iter().flat_map(of_draw).copied()
}

/// Which texels of a picture triangles show: all of those in a box around each.
struct Used {
    /// How many boxes hold each texel, or `None` if all texels are used.
    boxes: Option<Vec<i32>>,
}

impl Used {
    fn of(scene: &Scene, texture: &Texture, image: &Image, triangles: &[[u32; 3]]) -> Self {
        let (width, height) = (image.width as usize, image.height as usize);
        if u64::from(image.width) * u64::from(image.height) > MOST_TEXELS {
            return Self { boxes: None };
        }
        // Differences: 1 where boxes begin and −1 behind their ends. Their sums are counts.
        let mut boxes = vec![0; width * height];
        let mut add = |x: usize, y: usize, count: i32| {
            if x < width && y < height {
                boxes[y * width + x] += count;
            }
        };
        for corners in triangles {
            let uvs = corners.map(|corner| scene.uvs.get(corner as usize).copied().unwrap_or_default());
            let columns = texels(uvs.map(|uv| uv.x), width, texture.wrap_u);
            let rows = texels(uvs.map(|uv| uv.y), height, texture.wrap_v);
            for (x, y) in columns.iter().flat_map(|x| rows.iter().map(move |y| (x, y))) {
                add(x.start, y.start, 1);
                add(x.end, y.start, -1);
                add(x.start, y.end, -1);
                add(x.end, y.end, 1);
            }
        }
        for row in boxes.chunks_exact_mut(width.max(1)) {
            for x in 1..width {
                row[x] += row[x - 1];
            }
        }
        for at in width..boxes.len() {
            boxes[at] += boxes[at - width];
        }
        Self { boxes: Some(boxes) }
    }

    fn contains(&self, texel: usize) -> bool {
        self.boxes.as_ref().is_none_or(|boxes| boxes.get(texel).is_some_and(|count| *count > 0))
    }
}

/// Returns the texels of a side of `size` texels that bilinear filtering may read for coordinates between these three:
/// one range, or two where they wrap around. A range may be empty.
fn texels(coordinates: [f32; 3], size: usize, wrap: Wrap) -> [Range<usize>; 2] {
    let low = coordinates.into_iter().fold(f32::INFINITY, f32::min);
    let high = coordinates.into_iter().fold(f32::NEG_INFINITY, f32::max);
    #[expect(clippy::cast_possible_truncation, reason = "the cast saturates, and a range that long takes all texels")]
    let texel = |coordinate: f32| (f64::from(coordinate) * size as f64 - 0.5).floor() as i64;
    let (first, last) = (texel(low), texel(high).saturating_add(1));
    let side = i64::try_from(size).unwrap_or(i64::MAX);
    let [whole, none] = [0..size, 0..0];
    let range = |first: i64, last: i64| {
        let at = |texel: i64| usize::try_from(texel).unwrap_or(0).min(size);
        at(first)..at(last.saturating_add(1))
    };
    match wrap {
        Wrap::ClampToEdge => [range(first.clamp(0, side - 1), last.clamp(0, side - 1)), none],
        _ if last.saturating_sub(first) >= side - 1 => [whole, none],
        Wrap::Repeat => {
            let (first, last) = (first.rem_euclid(side), last.rem_euclid(side));
            if first <= last { [range(first, last), none] } else { [range(first, side - 1), range(0, last)] }
        }
        Wrap::MirroredRepeat => {
            let folded = |texel: i64| {
                let texel = texel.rem_euclid(2 * side);
                texel.min(2 * side - 1 - texel)
            };
            if first.div_euclid(side) == last.div_euclid(side) {
                let (one, other) = (folded(first), folded(last));
                [range(one.min(other), one.max(other)), none]
            } else {
                [whole, none]
            }
        }
    }
}

/// Sorts draws and their triangles: OPAQUE, MASK, BLEND, otherwise as they are.
fn sort_draws(scene: &mut Scene) {
    let order = |draw: &Draw| scene.materials.get(draw.material as usize).map_or(0, |material| material.alpha.order());
    let mut draws = scene.draws.clone();
    draws.sort_by_key(order);
    let mut sorted = Vec::with_capacity(scene.triangles.len());
    let mut next = 0;
    for draw in &mut draws {
        sorted.extend(triangles(scene, std::slice::from_ref(draw)));
        draw.first_triangle = next;
        next += draw.triangles;
    }
    (scene.draws, scene.triangles) = (draws, sorted);
}

#[cfg(test)]
mod tests {
    use glam::{Vec2, Vec4};

    use super::*;
    use crate::scene::check::tests::scene;

    /// An OPAQUE triangle, and one of a material with this picture of `alphas` in one row.
    fn with_picture(alpha: AlphaMode, alphas: &[u8]) -> Scene {
        let mut scene = scene();
        let used = scene.draws.iter().position(|draw| draw.material == 1).unwrap();
        assert!(scene.draws[used].triangles > 0);
        scene.materials[1].alpha = alpha;
        scene.materials[1].base_color = Vec4::ONE;
        let texture = scene.materials[1].base_color_texture.as_mut().unwrap();
        (texture.wrap_u, texture.wrap_v) = (Wrap::Repeat, Wrap::Repeat);
        let image = &mut scene.images[texture.image as usize];
        (image.width, image.height) = (u32::try_from(alphas.len()).unwrap(), 1);
        image.rgba = alphas.iter().flat_map(|alpha| [9, 9, 9, *alpha]).collect();
        for (index, uv) in scene.uvs.iter_mut().enumerate() {
            *uv = Vec2::new(if index % 2 == 0 { 0.0 } else { 1.0 }, 0.0);
        }
        scene
    }

    fn mode_after(scene: &mut Scene) -> AlphaMode {
        apply(scene);
        let mut last = 0;
        for draw in &scene.draws {
            let order = scene.materials[draw.material as usize].alpha.order();
            assert!(order >= last, "draws are out of order");
            last = order;
        }
        scene.materials[1].alpha
    }

    #[test]
    fn blend_that_hides_all_behind_it_is_opaque() {
        let mut solid = with_picture(AlphaMode::Blend, &[255; 16]);
        assert_eq!(mode_after(&mut solid), AlphaMode::Opaque);
        for change in [
            (|scene: &mut Scene| scene.materials[1].base_color.w = 0.9) as fn(&mut Scene),
            |scene| scene.images[0].rgba[3] = 128,
            |scene| scene.colors = vec![[65535, 65535, 65535, 40000]; scene.positions.len()],
        ] {
            let mut scene = with_picture(AlphaMode::Blend, &[255; 16]);
            change(&mut scene);
            assert_eq!(mode_after(&mut scene), AlphaMode::Blend);
        }
    }

    #[test]
    fn texels_that_no_triangle_shows_do_not_count() {
        let mut alphas = [255; 64];
        alphas[40] = 100;
        let mut scene = with_picture(AlphaMode::Blend, &alphas);
        scene.uvs.iter_mut().for_each(|uv| uv.x *= 0.5);
        assert_eq!(mode_after(&mut scene), AlphaMode::Opaque);
        let mut scene = with_picture(AlphaMode::Blend, &alphas);
        assert_eq!(mode_after(&mut scene), AlphaMode::Blend);
    }

    #[test]
    fn blend_with_holes_is_a_mask_and_soft_edges_stay_blended() {
        let leaf = |between: usize, solid: usize| {
            let mut alphas = vec![0; 100];
            alphas[..solid].fill(255);
            alphas[solid..solid + between].fill(128);
            alphas
        };
        for (between, solid, expected) in [
            (0, 50, AlphaMode::Mask { cutoff: 0.5 }),
            (10, 50, AlphaMode::Mask { cutoff: 0.5 }),
            (11, 50, AlphaMode::Blend),
            (9, 20, AlphaMode::Blend),
            (0, 0, AlphaMode::Blend),
        ] {
            let mut scene = with_picture(AlphaMode::Blend, &leaf(between, solid));
            assert_eq!(mode_after(&mut scene), expected, "{between} between, {solid} solid");
        }
    }

    #[test]
    fn vertices_cut_holes_too_but_not_where_they_fade() {
        let mut scene = with_picture(AlphaMode::Blend, &[255; 4]);
        let draw = *scene.draws.iter().find(|draw| draw.material == 1).unwrap();
        let corners = scene.triangles[draw.first_triangle as usize];
        // A second triangle with the same material and vertices of its own.
        let own: Vec<u32> = corners.iter().map(|corner| copy_vertex(&mut scene, *corner)).collect();
        scene.triangles.push([own[0], own[1], own[2]]);
        let first = u32::try_from(scene.triangles.len() - 1).unwrap();
        scene.draws.push(Draw { first_triangle: first, triangles: 1, material: 1 });
        scene.colors = vec![[65535; 4]; scene.positions.len()];
        own.iter().for_each(|vertex| scene.colors[*vertex as usize][3] = 0);
        let mut faded = scene.clone();
        assert_eq!(mode_after(&mut scene), AlphaMode::Mask { cutoff: 0.5 });
        faded.colors[own[0] as usize][3] = 65535;
        assert_eq!(mode_after(&mut faded), AlphaMode::Blend);
    }

    fn copy_vertex(scene: &mut Scene, vertex: u32) -> u32 {
        scene.positions.push(scene.positions[vertex as usize]);
        scene.normals.push(scene.normals[vertex as usize]);
        scene.uvs.push(scene.uvs[vertex as usize]);
        u32::try_from(scene.positions.len() - 1).unwrap()
    }

    #[test]
    fn glass_lets_rays_through_by_its_share_of_light() {
        let mut glass = with_picture(AlphaMode::Opaque, &[255]);
        glass.materials[1].transmission.factor = 0.9;
        glass.materials[1].base_color.w = 0.0;
        let triangles = glass.triangles.len();
        assert_eq!(mode_after(&mut glass), AlphaMode::Blend);
        assert_eq!((glass.triangles.len(), glass.materials[1].base_color.w), (triangles, 1.0));
        // The picture's red is 9 of 255.
        for change in [
            (|material: &mut Material| material.transmission.factor = 0.4) as fn(&mut Material),
            |material| material.transmission.texture = material.base_color_texture,
            |material| material.metallic = 1.0,
        ] {
            let mut scene = with_picture(AlphaMode::Opaque, &[255]);
            scene.materials[1].transmission.factor = 0.9;
            change(&mut scene.materials[1]);
            assert_eq!(mode_after(&mut scene), AlphaMode::Opaque);
        }
    }

    #[test]
    fn ranges_of_texels_wrap_by_each_mode() {
        let of = |low: f32, high: f32, wrap| texels([low, high, low], 8, wrap);
        assert_eq!(of(0.25, 0.5, Wrap::Repeat), [1..5, 0..0]);
        assert_eq!(of(1.25, 1.5, Wrap::Repeat), [1..5, 0..0]);
        assert_eq!(of(-0.25, 0.25, Wrap::Repeat), [5..8, 0..3]);
        assert_eq!(of(-3.0, 3.0, Wrap::Repeat), [0..8, 0..0]);
        assert_eq!(of(-3.0, 0.25, Wrap::ClampToEdge), [0..3, 0..0]);
        assert_eq!(of(1.25, 1.5, Wrap::MirroredRepeat), [3..7, 0..0]);
        assert_eq!(of(0.75, 1.25, Wrap::MirroredRepeat), [0..8, 0..0]);
        for wrap in [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge] {
            let [whole, _] = of(f32::MIN, f32::MAX, wrap);
            assert_eq!(whole, 0..8);
        }
    }
}
