//! The bytes of a scene that travel from server to client, and are named by their digest.
//!
//! Little-endian throughout: `GNOMSCNE`, the format's version (u32), the number of bytes before compression (u64), then
//! one LZ4 block. In it: the length of the head (u32), the head (postcard), positions, normals, UVs and triangles in
//! planes, and the pictures as they were in their files. A *plane* holds one byte of one component of every element,
//! as the difference from the element before: LZ4 finds far more repetition in that than in the floats themselves.

use glam::{DVec3, Vec2, Vec3};
use lz4_flex::block;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{
    Aabb, CheckError, Draw, Light, Material, Scene,
    limits::{
        MAX_IMAGES, MAX_IMAGES_BYTES, MAX_IMAGES_PIXELS, MAX_PACKED_BYTES, MAX_TRIANGLES, MAX_UNPACKED_BYTES,
        MAX_VERTICES,
    },
    picture::decode,
};

/// First bytes of a packed scene.
pub(super) const MAGIC: [u8; 8] = *b"GNOMSCNE";

/// Version of the format. A reader takes its own only: scenes travel between programs of one release.
const VERSION: u32 = 1;

/// Magic, version, length.
const HEADER_BYTES: usize = 8 + 4 + 8;

/// An LZ4 block cannot grow more than this: one byte of a match's length stands for at most 255.
const MAX_LZ4_GROWTH: u64 = 255;

/// Why a scene could not be packed or unpacked.
#[derive(Debug, Error)]
pub enum PackError {
    /// Not a packed scene.
    #[error("{0} bytes that do not start with \"GNOMSCNE\" are no packed scene")]
    Magic(usize),
    /// Packed by another version.
    #[error("the packed scene has version {0}; this program reads version {VERSION}")]
    Version(u32),
    /// Larger than `limits` allows.
    #[error("the scene takes {bytes} bytes {what}; at most {limit} are allowed")]
    Size {
        /// Packed, or before compression.
        what: &'static str,
        /// Its size.
        bytes: u64,
        /// The bound.
        limit: u64,
    },
    /// The bytes contradict themselves.
    #[error("the packed scene is broken: {0}")]
    Broken(String),
    /// The bytes are well formed, but what they say is no legal scene.
    #[error("the packed scene is not legal: {0}")]
    Check(#[from] CheckError),
}

/// Everything but the large arrays.
#[derive(Serialize, Deserialize)]
struct Head {
    origin_m: DVec3,
    bounds: Aabb,
    vertices: u32,
    triangles: u32,
    instances: u32,
    draws: Vec<Draw>,
    materials: Vec<Material>,
    lights: Vec<Light>,
    image_bytes: Vec<u32>,
}

fn broken(fault: impl Into<String>) -> PackError {
    PackError::Broken(fault.into())
}

impl Scene {
    /// The bytes that travel. The same scene packs to the same bytes.
    ///
    /// # Errors
    /// When the scene breaks its guarantees, or is too large to travel.
    pub fn pack(&self) -> Result<Vec<u8>, PackError> {
        self.check()?;
        let short = |count: usize| u32::try_from(count).map_err(|_| broken(format!("{count} elements")));
        let image_bytes = self.images.iter().map(|image| short(image.encoded.len())).collect::<Result<_, _>>()?;
        let head = Head {
            origin_m: self.origin_m,
            bounds: self.bounds,
            vertices: short(self.positions.len())?,
            triangles: short(self.triangles.len())?,
            instances: self.instances,
            draws: self.draws.clone(),
            materials: self.materials.clone(),
            lights: self.lights.clone(),
            image_bytes,
        };
        let head = postcard::to_stdvec(&head).map_err(|error| broken(error.to_string()))?;

        let mut raw = short(head.len())?.to_le_bytes().to_vec();
        raw.extend(head);
        write_planes(&mut raw, &self.positions, |p| p.to_array().map(f32::to_bits));
        write_planes(&mut raw, &self.normals, |n| n.to_array().map(f32::to_bits));
        write_planes(&mut raw, &self.uvs, |uv| uv.to_array().map(f32::to_bits));
        write_planes(&mut raw, &self.triangles, |corners| *corners);
        for image in &self.images {
            raw.extend_from_slice(&image.encoded);
        }
        let size =
            |what, bytes, limit| if bytes <= limit { Ok(()) } else { Err(PackError::Size { what, bytes, limit }) };
        size("before compression", raw.len() as u64, MAX_UNPACKED_BYTES)?;

        let packed = seal(&raw);
        size("packed", packed.len() as u64, MAX_PACKED_BYTES)?;
        Ok(packed)
    }

    /// A scene from bytes that somebody sent: nothing in them is believed. Pictures are decoded.
    ///
    /// # Errors
    /// See [`PackError`].
    pub fn unpack(bytes: &[u8]) -> Result<Self, PackError> {
        let raw = decompress(bytes)?;
        let mut rest = Rest(&raw);
        let head_bytes = rest.take(4)?;
        let head_bytes = u32::from_le_bytes(head_bytes.try_into().map_err(|_| broken("its head has no length"))?);
        let head = rest.take(head_bytes as usize)?;
        let (head, left): (Head, _) = postcard::take_from_bytes(head).map_err(|error| broken(error.to_string()))?;
        if !left.is_empty() {
            return Err(broken(format!("{} bytes follow its head", left.len())));
        }
        if u64::from(head.vertices) > MAX_VERTICES || u64::from(head.triangles) > MAX_TRIANGLES {
            return Err(broken(format!("{} vertices and {} triangles", head.vertices, head.triangles)));
        }
        let vec3 = |words: [u32; 3]| Vec3::from_array(words.map(f32::from_bits));
        let vec2 = |words: [u32; 2]| Vec2::from_array(words.map(f32::from_bits));
        let positions = rest.planes(head.vertices, vec3)?;
        let normals = rest.planes(head.vertices, vec3)?;
        let uvs = rest.planes(head.vertices, vec2)?;
        let triangles = rest.planes(head.triangles, |corners: [u32; 3]| corners)?;

        let total: u64 = head.image_bytes.iter().map(|bytes| u64::from(*bytes)).sum();
        if head.image_bytes.len() > MAX_IMAGES || total > MAX_IMAGES_BYTES {
            return Err(broken(format!("{} pictures of {total} bytes", head.image_bytes.len())));
        }
        let mut images = Vec::with_capacity(head.image_bytes.len());
        let mut pixels_left = MAX_IMAGES_PIXELS;
        for (index, bytes) in head.image_bytes.iter().enumerate() {
            let encoded = rest.take(*bytes as usize)?.to_vec();
            let image = decode(encoded, pixels_left).map_err(|fault| broken(format!("picture {index}: {fault}")))?;
            pixels_left -= u64::from(image.width) * u64::from(image.height);
            images.push(image);
        }
        if !rest.0.is_empty() {
            return Err(broken(format!("{} bytes follow its end", rest.0.len())));
        }
        let scene = Self {
            origin_m: head.origin_m,
            bounds: head.bounds,
            positions,
            normals,
            uvs,
            triangles,
            draws: head.draws,
            materials: head.materials,
            images,
            lights: head.lights,
            instances: head.instances,
        };
        scene.check()?;
        Ok(scene)
    }
}

/// The header, and the compressed bytes behind it.
pub(crate) fn seal(raw: &[u8]) -> Vec<u8> {
    let mut packed = MAGIC.to_vec();
    packed.extend(VERSION.to_le_bytes());
    packed.extend((raw.len() as u64).to_le_bytes());
    packed.extend(block::compress(raw));
    packed
}

fn decompress(bytes: &[u8]) -> Result<Vec<u8>, PackError> {
    let (header, packed) = bytes.split_at_checked(HEADER_BYTES).ok_or(PackError::Magic(bytes.len()))?;
    let mut header = Rest(header);
    if header.take(8)? != MAGIC {
        return Err(PackError::Magic(bytes.len()));
    }
    let version = header.take(4)?.try_into().map_or(0, u32::from_le_bytes);
    if version != VERSION {
        return Err(PackError::Version(version));
    }
    let raw_bytes = header.take(8)?.try_into().map_or(0, u64::from_le_bytes);
    let limit = MAX_UNPACKED_BYTES.min(packed.len() as u64 * MAX_LZ4_GROWTH + 64);
    let too_large = || PackError::Size { what: "before compression", bytes: raw_bytes, limit };
    let size = usize::try_from(raw_bytes).ok().filter(|_| raw_bytes <= limit).ok_or_else(too_large)?;
    let mut raw = vec![0; size];
    let written = block::decompress_into(packed, &mut raw).map_err(|error| broken(error.to_string()))?;
    if written == size { Ok(raw) } else { Err(broken(format!("{written} bytes unpacked, not {size}"))) }
}

/// Appends `elements` of `N` words: for each component and each of its bytes, one plane.
fn write_planes<T, const N: usize>(out: &mut Vec<u8>, elements: &[T], words: impl Fn(&T) -> [u32; N]) {
    for component in 0..N {
        for byte in 0..4 {
            let mut before = 0_u32;
            out.extend(elements.iter().map(|element| {
                let word = words(element)[component];
                let difference = word.wrapping_sub(std::mem::replace(&mut before, word));
                zigzag(difference).to_le_bytes()[byte]
            }));
        }
    }
}

/// Small differences of either sign become small numbers.
fn zigzag(difference: u32) -> u32 {
    (difference << 1) ^ (0_u32.wrapping_sub(difference >> 31))
}

fn unzigzag(word: u32) -> u32 {
    (word >> 1) ^ 0_u32.wrapping_sub(word & 1)
}

/// Bytes not read yet.
struct Rest<'a>(&'a [u8]);

impl<'a> Rest<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], PackError> {
        let (taken, rest) = self
            .0
            .split_at_checked(count)
            .ok_or_else(|| broken(format!("{count} bytes expected, {} left", self.0.len())))?;
        self.0 = rest;
        Ok(taken)
    }

    /// What [`write_planes`] wrote.
    fn planes<T, const N: usize>(&mut self, count: u32, element: impl Fn([u32; N]) -> T) -> Result<Vec<T>, PackError> {
        let count = count as usize;
        let all = self.take(count * N * 4)?;
        let plane = |number: usize| all.get(number * count..(number + 1) * count).unwrap_or_default();
        let planes: [[&[u8]; 4]; N] =
            std::array::from_fn(|component| std::array::from_fn(|byte| plane(component * 4 + byte)));
        let mut words = [0_u32; N];
        let mut out = Vec::with_capacity(count);
        for index in 0..count {
            for (word, bytes) in words.iter_mut().zip(&planes) {
                let bytes = bytes.map(|plane| plane.get(index).copied().unwrap_or_default());
                *word = word.wrapping_add(unzigzag(u32::from_le_bytes(bytes)));
            }
            out.push(element(words));
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::check::tests::scene;

    #[test]
    fn scenes_survive_and_pack_to_the_same_bytes() {
        let scene = scene();
        let packed = scene.pack().unwrap();
        assert_eq!(Scene::unpack(&packed).unwrap(), scene);
        assert_eq!(scene.clone().pack().unwrap(), packed);
    }

    #[test]
    fn illegal_scenes_are_not_packed() {
        let mut scene = scene();
        scene.lights.clear();
        assert!(matches!(scene.pack(), Err(PackError::Check(_))));
    }

    #[test]
    fn planes_hold_any_words() {
        let elements: Vec<[u32; 3]> =
            vec![[0, u32::MAX, 1 << 31], [u32::MAX, 0, 1], [7, 7, 0x7fff_ffff], [7, 7, 0x8000_0001]];
        let mut bytes = Vec::new();
        write_planes(&mut bytes, &elements, |words| *words);
        let mut rest = Rest(&bytes);
        assert_eq!(rest.planes(4, |words: [u32; 3]| words).unwrap(), elements);
        assert!(rest.0.is_empty());
        assert!(Rest(&bytes).planes(5, |words: [u32; 3]| words).is_err());
    }

    #[test]
    fn other_bytes_are_told_apart() {
        let packed = scene().pack().unwrap();
        assert!(matches!(Scene::unpack(b""), Err(PackError::Magic(0))));
        assert!(matches!(Scene::unpack(&[0; 64]), Err(PackError::Magic(64))));
        let mut newer = packed.clone();
        newer[8] = 2;
        assert!(matches!(Scene::unpack(&newer), Err(PackError::Version(2))));
        // A length that the bytes cannot grow to is refused before it is allocated.
        let mut large = packed.clone();
        large[12..20].copy_from_slice(&u64::MAX.to_le_bytes());
        assert!(matches!(Scene::unpack(&large), Err(PackError::Size { bytes: u64::MAX, .. })));
        let mut longer = packed;
        longer[12] = longer[12].wrapping_add(1);
        assert!(matches!(Scene::unpack(&longer), Err(PackError::Broken(_))));
    }

    /// Packs bytes as they are, whatever they say.
    fn wrap(raw: &[u8]) -> Vec<u8> {
        let mut packed = MAGIC.to_vec();
        packed.extend(VERSION.to_le_bytes());
        packed.extend((raw.len() as u64).to_le_bytes());
        packed.extend(block::compress(raw));
        packed
    }

    #[test]
    fn every_cut_and_every_rest_is_an_error() {
        let raw = decompress(&scene().pack().unwrap()).unwrap();
        assert!(Scene::unpack(&wrap(&raw)).is_ok());
        for end in 0..raw.len() {
            assert!(Scene::unpack(&wrap(&raw[..end])).is_err(), "cut at {end} of {}", raw.len());
        }
        assert!(Scene::unpack(&wrap(&[&raw[..], &[0]].concat())).is_err());
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 4000, failure_persistence: None, ..ProptestConfig::default() })]

        /// Changed before compression, where each byte means something.
        #[test]
        fn changed_bytes_give_an_error_or_a_legal_scene(
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        ) {
            let mut raw = decompress(&scene().pack().unwrap()).unwrap();
            for (at, value) in changes {
                let at = at.index(raw.len());
                raw[at] = value;
            }
            if let Ok(scene) = Scene::unpack(&wrap(&raw)) {
                prop_assert_eq!(scene.check(), Ok(()));
            }
        }
    }
}
