//! Compares what materials look like with glTF 2.0's appendix B, computed here in f64 from the formulas.

mod answer;
mod textures;

use std::f64::consts::PI;

use glam::{DVec3, Vec2, Vec3, Vec4};
use gnomon_protocol::mask::Mask;
use gnomon_scene::{Draw, Light, LightKind, Material, Scene, camera::Camera};

use super::{
    FrameRenderer, PICTURE_FORMAT,
    exposure::Exposure,
    material::EMISSIVE,
    readback::texels,
    testing::{draw, gpu},
};
use crate::predictor::Predictor;

const SIDE: u32 = 48;

/// A square of 2 m in z = 0 that faces +z, u to the right and v downwards, and a sun of 3 lx from above it.
fn card(material: Material) -> Scene {
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    Scene {
        positions: corners.map(|(x, y)| Vec3::new(x, y, 0.0)).to_vec(),
        normals: vec![Vec3::Z; 4],
        uvs: corners.map(|(x, y)| Vec2::new(0.5 + 0.5 * x, 0.5 - 0.5 * y)).to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        draws: vec![Draw { first_triangle: 0, triangles: 2, material: 0 }],
        materials: vec![material],
        lights: vec![Light {
            name: String::new(),
            kind: LightKind::Directional,
            position: Vec3::ZERO,
            direction: Vec3::new(-0.3, -0.5, -0.8).normalize(),
            color: Vec3::new(1.0, 0.8, 0.5),
            intensity: 3.0,
            range_m: f32::INFINITY,
        }],
        instances: 1,
        ..Scene::default()
    }
}

/// Looks at the card from the side.
fn camera() -> Camera {
    Camera::looking_at(DVec3::new(0.7, 0.4, 1.6), DVec3::ZERO, 0.9, SIDE, SIDE)
}

/// Exposed light of every pixel.
fn light_of(scene: &Scene) -> Vec<DVec3> {
    light_with(scene, &camera(), None)
}

fn light_with(scene: &Scene, camera: &Camera, mask: Option<&Mask>) -> Vec<DVec3> {
    let gpu = gpu();
    // Nothing but the lights.
    let exposure = Exposure { scale: 1.0, reference_lux: 0.0 };
    let mut renderer =
        FrameRenderer::new(&gpu, scene, (SIDE, SIDE), exposure, PICTURE_FORMAT, Predictor::None).unwrap();
    draw(&gpu, &mut renderer, camera, mask);
    let bytes = texels(&gpu, &renderer.targets.light, wgpu::TextureAspect::All).unwrap();
    let halves: &[u16] = bytemuck::cast_slice(&bytes);
    halves.as_chunks::<4>().0.iter().map(|[r, g, b, _]| DVec3::new(half(*r), half(*g), half(*b))).collect()
}

/// Value of a 16-bit float that is not negative.
fn half(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10), f64::from(bits & 0x3ff) / 1024.0);
    if exponent == 0 { fraction * 2.0_f64.powi(-14) } else { (1.0 + fraction) * 2.0_f64.powi(exponent - 15) }
}

/// Pixels whose centre sees the card, 2 cm off its edges, with the point and the unit vector to the eye.
fn seen() -> Vec<(usize, DVec3, DVec3)> {
    let camera = camera();
    let pixels = (0..SIDE * SIDE).filter_map(|place| {
        let (origin, direction) = camera.ray(place % SIDE, place / SIDE);
        let point = origin - direction * (origin.z / direction.z);
        let inside = point.x.abs() < 0.98 && point.y.abs() < 0.98;
        inside.then(|| (place as usize, point, (origin - point).normalize()))
    });
    let pixels: Vec<_> = pixels.collect();
    assert!(pixels.len() > 500, "{}", pixels.len());
    pixels
}

fn fresnel(normal: DVec3, grazing: f64, cosine: f64) -> DVec3 {
    normal + (DVec3::splat(grazing) - normal) * (1.0 - cosine).powi(5)
}

/// D and V of GGX (appendix B.3.2 and B.3.3).
fn lobe(alpha: f64, cosine: f64, facing: f64, facing_eye: f64) -> f64 {
    let a2 = alpha * alpha;
    let d = a2 / (PI * (cosine * cosine * (a2 - 1.0) + 1.0).powi(2));
    let v = 0.5
        / (facing * (a2 + (1.0 - a2) * facing_eye.powi(2)).sqrt()
            + facing_eye * (a2 + (1.0 - a2) * facing.powi(2)).sqrt());
    d * v
}

/// Directional albedo of white GGX, at the normal and at the grazing end of the Fresnel term: a sum over half vectors,
/// distributed as D distributes them.
fn albedo(roughness: f64, cosine: f64) -> [f64; 2] {
    const STEPS: u32 = 96;
    let a2 = roughness.powi(4);
    let eye = DVec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
    let mut sums = [0.0; 2];
    for (one, two) in (0..STEPS).flat_map(|i| (0..STEPS).map(move |j| (i, j))) {
        let [u, v] = [one, two].map(|step| (f64::from(step) + 0.5) / f64::from(STEPS));
        let up = ((1.0 - u) / (1.0 + (a2 - 1.0) * u)).sqrt();
        let around = 2.0 * PI * v;
        let half_way = DVec3::new((1.0 - up * up).sqrt() * around.cos(), (1.0 - up * up).sqrt() * around.sin(), up);
        let between = eye.dot(half_way);
        let toward = 2.0 * between * half_way - eye;
        if toward.z <= 0.0 || between <= 0.0 {
            continue;
        }
        let d = a2 / (PI * (up * up * (a2 - 1.0) + 1.0).powi(2));
        let weight = 4.0 * lobe(a2.sqrt(), up, toward.z, cosine) / d * toward.z * between / up;
        let grazing = (1.0 - between).powi(5);
        sums = [sums[0] + weight * (1.0 - grazing), sums[1] + weight * grazing];
    }
    sums.map(|sum| sum / f64::from(STEPS * STEPS))
}

/// What a material without textures sends to the eye: appendix B, with the energy of multiple reflections that Turquin
/// (2019) adds.
struct Expected {
    base: DVec3,
    metallic: f64,
    roughness: f64,
    dielectric: DVec3,
    grazing: f64,
}

impl Expected {
    fn of(material: &Material) -> Self {
        let metallic = f64::from(material.metallic);
        let normal = ((f64::from(material.ior) - 1.0) / (f64::from(material.ior) + 1.0)).powi(2);
        let strength = f64::from(material.specular.strength);
        Self {
            base: material.base_color.truncate().as_dvec3(),
            metallic,
            roughness: f64::from(material.roughness),
            dielectric: (material.specular.color.as_dvec3() * normal).min(DVec3::ONE) * strength,
            grazing: strength + (1.0 - strength) * metallic,
        }
    }

    /// For light of unit irradiance; a white Lambert surface that faces it sends 1.
    fn answer(&self, normal: DVec3, toward: DVec3, eye: DVec3) -> DVec3 {
        // The smooth normals of a coarse mesh may face away from the eye.
        let (facing, facing_eye) = (normal.dot(toward), normal.dot(eye).max(0.0));
        if facing <= 0.0 {
            return DVec3::ZERO;
        }
        let half_way = (toward + eye).normalize();
        let between = eye.dot(half_way);
        let mirrored = self.dielectric.lerp(self.base, self.metallic);
        let [one, other] = albedo(self.roughness, facing_eye.max(0.02));
        let more = DVec3::ONE + mirrored * (1.0 / (one + other) - 1.0);
        let below = self.base * (1.0 - self.metallic) * (DVec3::ONE - fresnel(self.dielectric, self.grazing, between));
        let lobe = lobe(self.roughness.powi(2), normal.dot(half_way).max(0.0), facing, facing_eye);
        facing * (below + PI * lobe * more * fresnel(mirrored, self.grazing, between))
    }
}

fn toward(scene: &Scene) -> DVec3 {
    -scene.lights[0].direction.as_dvec3()
}

fn irradiance(scene: &Scene) -> DVec3 {
    (scene.lights[0].color * scene.lights[0].intensity).as_dvec3()
}

/// A colour that 8 bits of sRGB represent exactly.
fn paint(bytes: [u8; 3]) -> Vec4 {
    let [r, g, b] = bytes.map(|byte| {
        let value = f64::from(byte) / 255.0;
        #[expect(clippy::cast_possible_truncation, reason = "rounding is what is wanted")]
        let linear = (if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }) as f32;
        linear
    });
    Vec4::new(r, g, b, 1.0)
}

/// The G-buffer keeps roughness and metallic in 8 bits, and normals in 16: a highlight that is not sharp changes by
/// less than a fortieth of itself. The fit of the albedo (`finish.wgsl`) is off by no more than another.
const TOLERANCE: f64 = 0.05;

fn assert_near(found: DVec3, expected: DVec3, what: &str) {
    let error = (found - expected).abs() / (expected + DVec3::splat(0.02));
    assert!(error.max_element() < TOLERANCE, "{what}: {found}, expected {expected}");
}
