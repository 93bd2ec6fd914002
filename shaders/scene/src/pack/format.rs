//! The packed form's layout.
//!
//! Little-endian throughout: `GNOMSCNE`, the format's version (u32), the number of bytes before compression (u64), then
//! one Zstandard frame. It holds the length of the head (u32), the head (postcard), what vertices have and triangles in
//! [planes](super::planes), and the pictures' files. A scene in which something moves has another version and goes on:
//! the length of the animation (u32), the animation (postcard), and what moving vertices have in planes: also their
//! joints, and what morph targets change of them.

use glam::{DVec3, Vec2, Vec3, Vec4};
use serde::{Deserialize, Serialize};

use super::{
    error::{MOVING, PackError, VERSION, broken},
    planes::{Cursor, write_distinct, write_planes},
    zstandard,
};
use crate::{
    Aabb, Animation, Delta, Draw, Influence, Light, Material, NamedCamera, Scene, Shape,
    limits::{
        MAX_DELTAS, MAX_IMAGES, MAX_IMAGES_BYTES, MAX_IMAGES_PIXELS, MAX_JOINT_SETS, MAX_PACKED_BYTES, MAX_TRIANGLES,
        MAX_UNPACKED_BYTES, MAX_VERTICES,
    },
    picture::decode,
};

/// First bytes of a packed scene.
pub(crate) const MAGIC: [u8; 8] = *b"GNOMSCNE";

/// Magic, version, length.
const HEADER_BYTES: usize = 8 + 4 + 8;

/// Everything except the large arrays.
#[derive(Serialize, Deserialize)]
struct Head {
    origin_m: DVec3,
    bounds: Aabb,
    vertices: u32,
    /// Whether there are second texture coordinates, tangents and colours.
    optional: [bool; 3],
    triangles: u32,
    instances: u32,
    draws: Vec<Draw>,
    materials: Vec<Material>,
    lights: Vec<Light>,
    cameras: Vec<NamedCamera>,
    image_bytes: Vec<u32>,
}

impl Scene {
    /// Returns the packed form. Equal scenes give equal bytes.
    ///
    /// # Errors
    /// Errors if the scene breaks its guarantees, or is too large to travel.
    pub fn pack(&self) -> Result<Vec<u8>, PackError> {
        self.check()?;
        let short = |count: usize| u32::try_from(count).map_err(|_| broken(format!("{count} elements")));
        let image_bytes = self.images.iter().map(|image| short(image.encoded.len())).collect::<Result<_, _>>()?;
        let head = Head {
            origin_m: self.origin_m,
            bounds: self.bounds,
            vertices: short(self.positions.len())?,
            optional: [!self.uvs_1.is_empty(), !self.tangents.is_empty(), !self.colors.is_empty()],
            triangles: short(self.triangles.len())?,
            instances: self.instances,
            draws: self.draws.clone(),
            materials: self.materials.clone(),
            lights: self.lights.clone(),
            cameras: self.cameras.clone(),
            image_bytes,
        };
        let head = postcard::to_stdvec(&head).map_err(|error| broken(error.to_string()))?;

        let mut raw = short(head.len())?.to_le_bytes().to_vec();
        raw.extend(head);
        write_distinct(&mut raw, &self.positions, |p| p.to_array().map(f32::to_bits));
        write_distinct(&mut raw, &self.normals, |n| n.to_array().map(f32::to_bits));
        write_distinct(&mut raw, &self.uvs, |uv| uv.to_array().map(f32::to_bits));
        write_distinct(&mut raw, &self.uvs_1, |uv| uv.to_array().map(f32::to_bits));
        write_distinct(&mut raw, &self.tangents, |t| t.to_array().map(f32::to_bits));
        write_distinct(&mut raw, &self.colors, |[r, g, b, a]| [pair(*r, *g), pair(*b, *a)]);
        write_planes(&mut raw, &self.triangles, |corners| *corners);
        for image in &self.images {
            raw.extend_from_slice(&image.encoded);
        }
        if let Some(animation) = &self.animation {
            let head = postcard::to_stdvec(animation).map_err(|error| broken(error.to_string()))?;
            raw.extend(short(head.len())?.to_le_bytes());
            raw.extend(head);
            write_distinct(&mut raw, &animation.positions, |p| p.to_array().map(f32::to_bits));
            write_distinct(&mut raw, &animation.normals, |n| n.to_array().map(f32::to_bits));
            write_distinct(&mut raw, &animation.tangents, |t| t.to_array().map(f32::to_bits));
            write_distinct(&mut raw, &animation.influences, influence_words);
            write_distinct(&mut raw, &animation.deltas, delta_words);
        }
        let size =
            |what, bytes, limit| if bytes <= limit { Ok(()) } else { Err(PackError::Size { what, bytes, limit }) };
        size("before compression", raw.len() as u64, MAX_UNPACKED_BYTES)?;

        let packed = seal(&raw, self.animation.is_some())?;
        size("packed", packed.len() as u64, MAX_PACKED_BYTES)?;
        Ok(packed)
    }

    /// Returns the scene that a peer packed, and decodes its pictures. Nothing in the bytes is trusted.
    ///
    /// # Errors
    /// See [`PackError`].
    pub fn unpack(bytes: &[u8]) -> Result<Self, PackError> {
        let (raw, moves) = decompress(bytes)?;
        let mut cursor = Cursor(&raw);
        let head: Head = head(&mut cursor)?;
        if u64::from(head.vertices) > MAX_VERTICES || u64::from(head.triangles) > MAX_TRIANGLES {
            return Err(broken(format!("{} vertices and {} triangles", head.vertices, head.triangles)));
        }
        let vec3 = |words: [u32; 3]| Vec3::from_array(words.map(f32::from_bits));
        let vec2 = |words: [u32; 2]| Vec2::from_array(words.map(f32::from_bits));
        let positions = cursor.distinct(head.vertices, vec3)?;
        let normals = cursor.distinct(head.vertices, vec3)?;
        let uvs = cursor.distinct(head.vertices, vec2)?;
        let [uvs_1, tangents, colors] = head.optional.map(|there| if there { head.vertices } else { 0 });
        let uvs_1 = cursor.distinct(uvs_1, vec2)?;
        let tangents = cursor.distinct(tangents, |words: [u32; 4]| Vec4::from_array(words.map(f32::from_bits)))?;
        let colors = cursor.distinct(colors, |[rg, ba]: [u32; 2]| {
            let ([r, g], [b, a]) = (halves(rg), halves(ba));
            [r, g, b, a]
        })?;
        let triangles = cursor.planes(head.triangles, |corners: [u32; 3]| corners)?;

        let total: u64 = head.image_bytes.iter().map(|bytes| u64::from(*bytes)).sum();
        if head.image_bytes.len() > MAX_IMAGES || total > MAX_IMAGES_BYTES {
            return Err(broken(format!("{} pictures of {total} bytes", head.image_bytes.len())));
        }
        let mut images = Vec::with_capacity(head.image_bytes.len());
        let mut pixels_left = MAX_IMAGES_PIXELS;
        for (index, bytes) in head.image_bytes.iter().enumerate() {
            let encoded = cursor.take(*bytes as usize)?.to_vec();
            let image = decode(encoded, pixels_left).map_err(|fault| broken(format!("picture {index}: {fault}")))?;
            pixels_left -= u64::from(image.width) * u64::from(image.height);
            images.push(image);
        }
        let animation = if moves { Some(Box::new(animation(&mut cursor, &head)?)) } else { None };
        if !cursor.0.is_empty() {
            return Err(broken(format!("{} bytes follow its end", cursor.0.len())));
        }
        let scene = Self {
            origin_m: head.origin_m,
            bounds: head.bounds,
            positions,
            normals,
            uvs,
            uvs_1,
            tangents,
            colors,
            triangles,
            draws: head.draws,
            materials: head.materials,
            images,
            lights: head.lights,
            cameras: head.cameras,
            instances: head.instances,
            animation,
        };
        scene.check()?;
        Ok(scene)
    }
}

/// Reads what postcard wrote, after its length.
fn head<T: serde::de::DeserializeOwned>(cursor: &mut Cursor<'_>) -> Result<T, PackError> {
    let bytes = cursor.take(4)?;
    let bytes = u32::from_le_bytes(bytes.try_into().map_err(|_| broken("a head has no length"))?);
    let head = cursor.take(bytes as usize)?;
    let (head, left) = postcard::take_from_bytes(head).map_err(|error| broken(error.to_string()))?;
    if left.is_empty() { Ok(head) } else { Err(broken(format!("{} bytes follow a head", left.len()))) }
}

fn animation(cursor: &mut Cursor<'_>, scene: &Head) -> Result<Animation, PackError> {
    let animation: Animation = head(cursor)?;
    let vertices: u64 = animation.pieces.iter().map(|piece| u64::from(piece.vertices)).sum();
    let vertices = u32::try_from(vertices).ok().filter(|vertices| *vertices <= scene.vertices);
    let vertices = vertices.ok_or_else(|| broken("more vertices move than there are"))?;
    let vec3 = |words: [u32; 3]| Vec3::from_array(words.map(f32::from_bits));
    let positions = cursor.distinct(vertices, vec3)?;
    let normals = cursor.distinct(vertices, vec3)?;
    let tangents = if scene.optional[1] { vertices } else { 0 };
    let tangents = cursor.distinct(tangents, |words: [u32; 4]| Vec4::from_array(words.map(f32::from_bits)))?;
    let of_shapes = |count: fn(&Shape, u32) -> u64, limit: u64| {
        let sizes = animation.shapes.iter().map(|shape| {
            let piece = animation.pieces.get(shape.piece as usize);
            count(shape, piece.map_or(0, |piece| piece.vertices))
        });
        let sum = sizes.fold(0, u64::saturating_add);
        let sum = u32::try_from(sum).ok().filter(|sum| u64::from(*sum) <= limit);
        sum.ok_or_else(|| broken("shapes of more than there is"))
    };
    let influences = of_shapes(Shape::influences, u64::from(MAX_JOINT_SETS) * MAX_VERTICES)?;
    let influences = cursor.distinct(influences, influence)?;
    let deltas = cursor.distinct(of_shapes(Shape::deltas, MAX_DELTAS)?, delta)?;
    Ok(Animation { positions, normals, tangents, influences, deltas, ..animation })
}

fn influence_words(Influence { joints: [a, b, c, d], weights }: &Influence) -> [u32; 6] {
    let [e, f, g, h] = weights.map(f32::to_bits);
    [pair(*a, *b), pair(*c, *d), e, f, g, h]
}

fn influence([ab, cd, e, f, g, h]: [u32; 6]) -> Influence {
    let ([a, b], [c, d]) = (halves(ab), halves(cd));
    Influence { joints: [a, b, c, d], weights: [e, f, g, h].map(f32::from_bits) }
}

fn delta_words(Delta { position, normal, tangent }: &Delta) -> [u32; 9] {
    let ([a, b, c], [d, e, f], [g, h, i]) = (position.to_array(), normal.to_array(), tangent.to_array());
    [a, b, c, d, e, f, g, h, i].map(f32::to_bits)
}

fn delta(words: [u32; 9]) -> Delta {
    let [a, b, c, d, e, f, g, h, i] = words.map(f32::from_bits);
    Delta { position: Vec3::new(a, b, c), normal: Vec3::new(d, e, f), tangent: Vec3::new(g, h, i) }
}

fn pair(low: u16, high: u16) -> u32 {
    u32::from(low) | u32::from(high) << 16
}

#[expect(clippy::cast_possible_truncation, reason = "each half has 16 bits")]
fn halves(word: u32) -> [u16; 2] {
    [word as u16, (word >> 16) as u16]
}

/// Compresses the content and prepends the header.
/// Errors if there is no memory for it.
pub(crate) fn seal(raw: &[u8], moves: bool) -> Result<Vec<u8>, PackError> {
    let mut packed = MAGIC.to_vec();
    packed.extend(if moves { MOVING } else { VERSION }.to_le_bytes());
    packed.extend((raw.len() as u64).to_le_bytes());
    packed.extend(zstandard::compress(raw).map_err(broken)?);
    Ok(packed)
}

/// Returns the content, and whether something moves.
fn decompress(bytes: &[u8]) -> Result<(Vec<u8>, bool), PackError> {
    let (header, packed) = bytes.split_at_checked(HEADER_BYTES).ok_or(PackError::Magic(bytes.len()))?;
    let mut header = Cursor(header);
    if header.take(8)? != MAGIC {
        return Err(PackError::Magic(bytes.len()));
    }
    let version = header.take(4)?.try_into().map_or(0, u32::from_le_bytes);
    if version != VERSION && version != MOVING {
        return Err(PackError::Version(version));
    }
    let raw_bytes = header.take(8)?.try_into().map_or(0, u64::from_le_bytes);
    let too_large = || PackError::Size { what: "before compression", bytes: raw_bytes, limit: MAX_UNPACKED_BYTES };
    let size = usize::try_from(raw_bytes).ok().filter(|_| raw_bytes <= MAX_UNPACKED_BYTES).ok_or_else(too_large)?;
    Ok((zstandard::decompress(packed, size).map_err(broken)?, version == MOVING))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::scene::check::tests::{moving, reshaped, scene};

    #[test]
    fn scenes_survive_and_pack_to_the_same_bytes() {
        for scene in [scene(), moving(), reshaped()] {
            let packed = scene.pack().unwrap();
            assert_eq!(Scene::unpack(&packed).unwrap(), scene);
            assert_eq!(scene.clone().pack().unwrap(), packed);
        }
    }

    #[test]
    fn illegal_scenes_are_not_packed() {
        let mut scene = scene();
        scene.lights.clear();
        assert!(matches!(scene.pack(), Err(PackError::Check(_))));
    }

    #[test]
    fn foreign_bytes_have_their_own_errors() {
        let packed = scene().pack().unwrap();
        assert!(matches!(Scene::unpack(b""), Err(PackError::Magic(0))));
        assert!(matches!(Scene::unpack(&[0; 64]), Err(PackError::Magic(64))));
        let mut newer = packed.clone();
        newer[8] = 6;
        assert!(matches!(Scene::unpack(&newer), Err(PackError::Version(6))));
        // A length beyond the bound is refused before memory is taken.
        let mut large = packed.clone();
        large[12..20].copy_from_slice(&u64::MAX.to_le_bytes());
        assert!(matches!(Scene::unpack(&large), Err(PackError::Size { bytes: u64::MAX, .. })));
        let mut longer = packed;
        longer[12] = longer[12].wrapping_add(1);
        assert!(matches!(Scene::unpack(&longer), Err(PackError::Broken(_))));
    }

    #[test]
    fn cut_and_extended_bytes_are_errors() {
        for scene in [scene(), moving(), reshaped()] {
            let (raw, moves) = decompress(&scene.pack().unwrap()).unwrap();
            assert_eq!(moves, scene.animation.is_some());
            assert!(Scene::unpack(&seal(&raw, moves).unwrap()).is_ok());
            for end in 0..raw.len() {
                assert!(Scene::unpack(&seal(&raw[..end], moves).unwrap()).is_err(), "cut at {end} of {}", raw.len());
            }
            assert!(Scene::unpack(&seal(&[&raw[..], &[0]].concat(), moves).unwrap()).is_err());
            assert!(Scene::unpack(&seal(&raw, !moves).unwrap()).is_err());
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 4000, failure_persistence: None, ..ProptestConfig::default() })]

        /// Changed before compression, where each byte means something.
        #[test]
        fn changed_bytes_give_an_error_or_a_legal_scene(
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        ) {
            for scene in [scene(), moving(), reshaped()] {
                let (mut raw, moves) = decompress(&scene.pack().unwrap()).unwrap();
                for (at, value) in &changes {
                    let at = at.index(raw.len());
                    raw[at] = *value;
                }
                if let Ok(scene) = Scene::unpack(&seal(&raw, moves).unwrap()) {
                    prop_assert_eq!(scene.check(), Ok(()));
                    drop(scene.still_at(0.5));
                }
            }
        }
    }
}
