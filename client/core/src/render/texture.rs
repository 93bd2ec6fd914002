//! Textures with mips made on the CPU, so that every adapter shows the same ones.

use wgpu::util::DeviceExt as _;

/// Used by materials without a texture.
pub(crate) const WHITE: [u8; 4] = [255; 4];

/// What a texture's texels are, which decides how they are averaged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Content {
    /// sRGB colours and linear alpha. Light is averaged.
    Color,
    /// As `Color`, weighed by alpha, so that cut-away texels do not bleed into visible ones.
    ColorByAlpha,
    /// Linear values.
    Numbers,
    /// Unit vectors. Mips have unit vectors, too.
    Normals,
}

impl Content {
    fn is_srgb(self) -> bool {
        matches!(self, Self::Color | Self::ColorByAlpha)
    }
}

/// Lookup tables between sRGB and linear 16-bit light.
pub(crate) struct Srgb {
    linear: [u16; 256],
    encoded: Vec<u8>,
}

impl Srgb {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "values lie within the types' ranges")]
    pub(crate) fn new() -> Self {
        let decode = |byte: u8| {
            let value = f64::from(byte) / 255.0;
            if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
        };
        let encode = |light: f64| {
            if light <= 0.003_130_8 { light * 12.92 } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 }
        };
        Self {
            linear: std::array::from_fn(|byte| (decode(byte as u8) * 65535.0).round() as u16),
            encoded: (0..=u16::MAX).map(|light| (encode(f64::from(light) / 65535.0) * 255.0).round() as u8).collect(),
        }
    }

    /// Returns all mips after the first level, concatenated, down to one texel.
    pub(crate) fn mips(&self, rgba: &[u8], width: u32, height: u32, content: Content) -> Vec<u8> {
        let (mut width, mut height) = (width as usize, height as usize);
        let mut level: Vec<[u16; 4]> = rgba
            .chunks_exact(4)
            .map(|t| {
                let linear = |channel: u8| {
                    if content.is_srgb() { self.linear[usize::from(channel)] } else { u16::from(channel) * 257 }
                };
                [linear(t[0]), linear(t[1]), linear(t[2]), u16::from(t[3]) * 257]
            })
            .collect();
        let mut bytes = Vec::with_capacity(rgba.len() / 3 + 64);
        while width > 1 || height > 1 {
            let (next_width, next_height) = ((width / 2).max(1), (height / 2).max(1));
            let mut next = Vec::with_capacity(next_width * next_height);
            for y in 0..next_height {
                let rows = [2 * y * width, (2 * y + 1).min(height - 1) * width];
                for x in 0..next_width {
                    let columns = [2 * x, (2 * x + 1).min(width - 1)];
                    let four = [
                        level[rows[0] + columns[0]],
                        level[rows[0] + columns[1]],
                        level[rows[1] + columns[0]],
                        level[rows[1] + columns[1]],
                    ];
                    let mean = average(&four, content == Content::ColorByAlpha);
                    next.push(if content == Content::Normals { unit(mean) } else { mean });
                }
            }
            bytes.extend(next.iter().flat_map(|texel| {
                #[expect(clippy::cast_possible_truncation, reason = "16 bits to 8")]
                let byte = |value: u16| ((u32::from(value) + 128) / 257) as u8;
                let encoded = |value: u16| {
                    if content.is_srgb() { self.encoded[usize::from(value)] } else { byte(value) }
                };
                [encoded(texel[0]), encoded(texel[1]), encoded(texel[2]), byte(texel[3])]
            }));
            (level, width, height) = (next, next_width, next_height);
        }
        bytes
    }
}

#[expect(clippy::cast_possible_truncation, reason = "a mean of 16-bit values has 16 bits")]
fn average(four: &[[u16; 4]; 4], weigh: bool) -> [u16; 4] {
    let alpha: u64 = four.iter().map(|texel| u64::from(texel[3])).sum();
    let mut mean = [0, 0, 0, ((alpha + 2) / 4) as u16];
    for (channel, value) in mean.iter_mut().enumerate().take(3) {
        *value = if weigh && alpha > 0 {
            let sum: u64 = four.iter().map(|texel| u64::from(texel[channel]) * u64::from(texel[3])).sum();
            ((sum + alpha / 2) / alpha) as u16
        } else {
            let sum: u64 = four.iter().map(|texel| u64::from(texel[channel])).sum();
            ((sum + 2) / 4) as u16
        };
    }
    mean
}

/// The texel with the direction of `texel`, of length 1. Opposite normals have no mean, and stay as they are.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "components of a unit vector")]
fn unit([x, y, z, alpha]: [u16; 4]) -> [u16; 4] {
    let [x, y, z] = [x, y, z].map(|value| f32::from(value) / 32767.5 - 1.0);
    let length = (x * x + y * y + z * z).sqrt().max(1e-3);
    let [x, y, z] = [x, y, z].map(|value| ((value / length).clamp(-1.0, 1.0) * 32767.5 + 32767.5).round() as u16);
    [x, y, z, alpha]
}

/// Uploads the first level and the mips from [`Srgb::mips`].
pub(crate) fn upload(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    (width, height): (u32, u32),
    content: Content,
    mut texels: Vec<u8>,
    mips: &[u8],
) -> wgpu::TextureView {
    texels.extend_from_slice(mips);
    let texture = device.create_texture_with_data(
        queue,
        &wgpu::TextureDescriptor {
            label: Some("texture"),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: width.max(height).ilog2() + 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: if content.is_srgb() {
                wgpu::TextureFormat::Rgba8UnormSrgb
            } else {
                wgpu::TextureFormat::Rgba8Unorm
            },
            usage: wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        },
        wgpu::util::TextureDataOrder::LayerMajor,
        &texels,
    );
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mip_averages_light_not_bytes() {
        let srgb = Srgb::new();
        let (black, white) = ([0, 0, 0, 255], [255, 255, 255, 255]);
        let mips = srgb.mips(&[black, white, white, black].concat(), 2, 2, Content::Color);
        // Half the light of white is 188 in sRGB (IEC 61966-2-1).
        assert_eq!(mips, [188, 188, 188, 255]);
    }

    #[test]
    fn cut_away_texels_do_not_bleed() {
        let srgb = Srgb::new();
        let (leaf, hole) = ([40, 120, 30, 255], [255, 0, 255, 0]);
        let picture = [leaf, hole, hole, hole].concat();
        assert_eq!(srgb.mips(&picture, 2, 2, Content::ColorByAlpha), [40, 120, 30, 64]);
        assert_ne!(srgb.mips(&picture, 2, 2, Content::Color)[..3], [40, 120, 30]);
    }

    #[test]
    fn mips_of_any_shape_end_with_one_texel() {
        let srgb = Srgb::new();
        for (width, height, texels) in [(1, 1, 0), (5, 3, 2 + 1), (8, 1, 4 + 2 + 1), (3, 7, 3 + 1)] {
            let picture = vec![9; width as usize * height as usize * 4];
            let mips = srgb.mips(&picture, width, height, Content::ColorByAlpha);
            assert_eq!(mips, vec![9; texels * 4], "{width}×{height}");
        }
    }

    #[test]
    fn normals_stay_unit_vectors_and_numbers_are_averaged_as_they_are() {
        let srgb = Srgb::new();
        // Two ripples of 45° that lean to either side, along x. Their mean is straight up.
        let (left, right) = ([37, 128, 218, 255], [218, 128, 37 + 181, 255]);
        let texels = [left, right, left, right].concat();
        let up = srgb.mips(&texels, 2, 2, Content::Normals);
        assert!(up[0].abs_diff(128) <= 1 && up[1].abs_diff(128) <= 1 && up[2] == 255, "{up:?}");
        assert_eq!(srgb.mips(&texels, 2, 2, Content::Numbers), [128, 128, 218, 255]);
    }
}
