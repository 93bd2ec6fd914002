//! Compares the back end with a brute-force f64 tracer, and with shapes whose masks are known.

use std::num::NonZeroUsize;

use glam::{DVec3, Vec2, Vec3, Vec4};
use gnomon_protocol::mask::{Mask, MaskShape};
use gnomon_scene::{Aabb, AlphaMode, Draw, Image, Light, LightKind, Material, Scene, Texture, Wrap, camera::Camera};

use self::brute::Brute;
use super::{backend::CpuBackend, simd::Level};
use crate::visibility::{TraceCost, backend::BackendError};

mod brute;
mod real;

struct Builder(Scene);

impl Builder {
    fn new() -> Self {
        Self(Scene {
            origin_m: DVec3::new(1000.0, -20.0, 3.0),
            bounds: Aabb { min: Vec3::ZERO, max: Vec3::ZERO },
            instances: 1,
            ..Scene::default()
        })
    }

    fn material(&mut self, alpha: AlphaMode, double_sided: bool, texture: Option<Texture>) -> u32 {
        self.0.materials.push(Material {
            base_color: Vec4::new(1.0, 1.0, 1.0, 0.9),
            base_color_texture: texture,
            alpha,
            double_sided,
            ..Material::default()
        });
        u32::try_from(self.0.materials.len() - 1).unwrap()
    }

    /// Adds flat triangles, each with corners of its own.
    fn draw(&mut self, material: u32, triangles: &[[Vec3; 3]]) {
        let scene = &mut self.0;
        let first_triangle = u32::try_from(scene.triangles.len()).unwrap();
        for corners in triangles {
            let first = u32::try_from(scene.positions.len()).unwrap();
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
            for (corner, uv) in corners.iter().zip([Vec2::ZERO, Vec2::new(3.0, 0.0), Vec2::new(0.0, 2.0)]) {
                scene.positions.push(*corner);
                scene.normals.push(normal);
                scene.uvs.push(uv);
            }
            scene.triangles.push([first, first + 1, first + 2]);
        }
        scene.draws.push(Draw { first_triangle, triangles: u32::try_from(triangles.len()).unwrap(), material });
    }

    fn light(&mut self, kind: LightKind, position: Vec3, direction: Vec3, range_m: f32) {
        let direction = direction.normalize();
        self.0.lights.push(Light {
            name: String::new(),
            kind,
            position,
            direction,
            color: Vec3::ONE,
            intensity: 1.0,
            range_m,
        });
    }

    fn finish(mut self) -> Scene {
        let scene = &mut self.0;
        let (min, max) =
            scene.positions.iter().fold((Vec3::INFINITY, -Vec3::INFINITY), |(min, max), p| (min.min(*p), max.max(*p)));
        scene.bounds = Aabb { min, max };
        self.0
    }
}

fn quad(a: Vec3, b: Vec3, c: Vec3, d: Vec3) -> Vec<[Vec3; 3]> {
    vec![[a, b, c], [a, c, d]]
}

/// A closed sphere of `rings`×2·`rings` quads that faces outwards, or inwards if `inside`.
fn sphere(centre: Vec3, radius: f32, rings: u16, inside: bool) -> Vec<[Vec3; 3]> {
    let at = |ring: u16, sector: u16| {
        // Both ends of a ring are the same corner, and so is a pole in every sector.
        let sector = if ring == 0 || ring == rings { 0 } else { sector % (2 * rings) };
        let (polar, azimuth) = [ring, sector].map(|i| std::f32::consts::PI * f32::from(i) / f32::from(rings)).into();
        let polar: f32 = polar;
        let azimuth: f32 = azimuth;
        centre + radius * Vec3::new(polar.sin() * azimuth.cos(), polar.cos(), polar.sin() * azimuth.sin())
    };
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for sector in 0..2 * rings {
            let [a, b, c, d] = [at(ring, sector), at(ring + 1, sector), at(ring + 1, sector + 1), at(ring, sector + 1)];
            triangles.extend([[a, c, b], [a, d, c]].into_iter().filter(|[a, b, c]| a != b && b != c && c != a));
        }
    }
    if inside {
        for corners in &mut triangles {
            corners.swap(1, 2);
        }
    }
    triangles
}

fn trace(backend: &CpuBackend, scene: &Scene, camera: &Camera) -> (Mask, TraceCost) {
    let mut mask =
        Mask::new(MaskShape::new(camera.width, camera.height, u32::try_from(scene.lights.len()).unwrap()).unwrap());
    for word in mask.words_mut() {
        *word = 0x5555_5555_5555_5555;
    }
    let cost = backend.trace(camera, &mut mask);
    (mask, cost)
}

fn backend(scene: &Scene) -> CpuBackend {
    CpuBackend::new(scene, NonZeroUsize::new(2)).unwrap()
}

fn camera(scene: &Scene, from: Vec3, to: Vec3, width: u32, height: u32) -> Camera {
    Camera::looking_at(scene.origin_m + from.as_dvec3(), scene.origin_m + to.as_dvec3(), 1.2, width, height)
}

/// A room with every kind of light, MASK with and without a picture, single-sided backs, and BLEND.
fn medley() -> Scene {
    let mut b = Builder::new();
    let alpha: Vec<u8> = (0..16_u8).flat_map(|i| [9, 9, 9, if i % 3 == 0 { 255 } else { i * 11 }]).collect();
    b.0.images.push(Image { encoded: Vec::new(), width: 4, height: 4, rgba: alpha });
    let texture = Texture::new(0, Wrap::Repeat, Wrap::MirroredRepeat);
    let floor = b.material(AlphaMode::Opaque, false, None);
    let both = b.material(AlphaMode::Opaque, true, None);
    let leaves = b.material(AlphaMode::Mask { cutoff: 0.4 }, true, Some(texture));
    let gone = b.material(AlphaMode::Mask { cutoff: 0.95 }, true, None);
    let kept = b.material(AlphaMode::Mask { cutoff: 0.9 }, false, None);
    let glass = b.material(AlphaMode::Blend, true, None);
    let v = Vec3::new;
    b.draw(floor, &quad(v(-9.0, 0.0, 9.0), v(9.0, 0.0, 9.0), v(9.0, 0.0, -9.0), v(-9.0, 0.0, -9.0)));
    b.draw(floor, &sphere(v(1.0, 1.2, 0.3), 1.0, 12, false));
    // The camera sees its back, so it only casts a shadow.
    b.draw(floor, &quad(v(-2.0, 2.0, 1.0), v(-2.0, 3.0, 1.0), v(-1.0, 3.0, 1.2), v(-1.0, 2.0, 1.2)));
    b.draw(both, &quad(v(-4.0, 0.3, -1.0), v(-3.0, 0.3, -1.5), v(-3.0, 2.0, -1.0), v(-4.0, 2.0, -0.5)));
    b.draw(leaves, &quad(v(2.0, 0.5, 2.0), v(4.0, 0.5, 1.0), v(4.0, 2.5, 1.0), v(2.0, 2.5, 2.0)));
    b.draw(gone, &quad(v(-2.0, 1.0, 0.0), v(0.0, 1.0, 0.0), v(0.0, 1.0, -2.0), v(-2.0, 1.0, -2.0)));
    b.draw(kept, &quad(v(-5.0, 1.5, 0.0), v(-4.0, 1.5, 0.0), v(-4.0, 1.5, -2.0), v(-5.0, 1.5, -2.0)));
    b.draw(glass, &quad(v(-9.0, 5.0, 9.0), v(9.0, 5.0, 9.0), v(9.0, 5.0, -9.0), v(-9.0, 5.0, -9.0)));
    b.light(LightKind::Directional, Vec3::ZERO, v(0.3, -1.0, 0.2), f32::INFINITY);
    b.light(LightKind::Point, v(-1.0, 3.5, 3.0), v(0.0, 0.0, -1.0), f32::INFINITY);
    // Amid the objects, with its range ending on the floor, so that its rays leave through all faces.
    b.light(LightKind::Point, v(0.0, 0.4, 2.0), v(0.0, 0.0, -1.0), 2.5);
    let cone = LightKind::Spot { inner_cone_rad: 0.2, outer_cone_rad: 0.5 };
    b.light(cone, v(3.0, 5.0, 4.0), v(-0.3, -1.0, -0.6), 12.0);
    b.finish()
}

fn disagreement(scene: &Scene, backend: &CpuBackend, camera: &Camera) -> (u64, u64) {
    let (mask, cost) = trace(backend, scene, camera);
    let brute = Brute::new(scene);
    let (mut wrong, mut relevant, mut rays) = (0, 0, 0);
    for y in 0..camera.height {
        for x in 0..camera.width {
            let point = brute.surface(camera, x, y);
            for (k, light) in (0..).zip(&scene.lights) {
                let expected = point.as_ref().and_then(|point| brute.visible(point, light));
                relevant += u64::from(expected.is_some());
                rays += u64::from(expected.is_some_and(|(_, traced)| traced));
                wrong += u64::from(mask.get(k, x, y) != expected.is_some_and(|(lit, _)| lit));
            }
        }
    }
    assert_eq!(cost.primary_rays, u64::from(camera.width * camera.height));
    assert!(cost.shadow_rays.abs_diff(rays) * 1000 <= rays, "{} shadow rays, not {rays}", cost.shadow_rays);
    (wrong, relevant)
}

#[test]
fn the_medley_agrees_with_brute_force_on_every_level() {
    let scene = medley();
    // 203 and 117 are not multiples of a tile's side.
    let camera = camera(&scene, Vec3::new(-0.5, 2.2, 7.0), Vec3::new(0.0, 1.0, 0.0), 203, 117);
    for level in [Level::detect(), Level::Portable] {
        let backend = CpuBackend::with_level(&scene, NonZeroUsize::new(2), level).unwrap();
        let (wrong, relevant) = disagreement(&scene, &backend, &camera);
        assert!(relevant > 20_000, "{relevant}");
        // The tolerance is one in a thousand. The next assertion proves that the test can detect missing triangles.
        assert!(wrong * 1000 <= relevant, "{}: {wrong} of {relevant} bits differ", level.name());
    }
    let mut poorer = scene.clone();
    for corner in poorer.triangles.clone()[poorer.draws[2].first_triangle as usize] {
        poorer.positions[corner as usize] += Vec3::Y * 50.0;
    }
    let (wrong, relevant) = disagreement(&scene, &backend(&poorer), &camera);
    assert!(wrong * 1000 > relevant, "removing half a quad changes {wrong} of {relevant} bits");
}

#[test]
fn every_direction_agrees_with_brute_force() {
    let scene = medley();
    let backend = backend(&scene);
    for to in [Vec3::X, -Vec3::X, Vec3::Z, -Vec3::Z, Vec3::Y, -Vec3::Y, Vec3::ONE, -Vec3::ONE] {
        let eye = Vec3::new(0.2, 1.7, 1.9);
        let camera = Camera { yfov_rad: 2.6, ..camera(&scene, eye, eye + to, 96, 64) };
        let (wrong, relevant) = disagreement(&scene, &backend, &camera);
        assert!(wrong * 1000 <= relevant.max(2000), "towards {to}: {wrong} of {relevant} bits differ");
    }
}

#[test]
fn from_inside_a_closed_sphere_no_ray_escapes_and_none_is_stopped() {
    for (rings, radius) in [(5, 2.0), (40, 3.0), (150, 40.0)] {
        let mut b = Builder::new();
        let wall = b.material(AlphaMode::Opaque, false, None);
        let centre = Vec3::new(7.0, -3.0, 11.0);
        b.draw(wall, &sphere(centre, radius, rings, true));
        b.light(LightKind::Point, centre + Vec3::new(0.31, 0.2, -0.17) * radius, Vec3::Y, f32::INFINITY);
        b.light(LightKind::Point, centre - Vec3::new(0.0, 0.7, 0.05) * radius, Vec3::Y, f32::INFINITY);
        let scene = b.finish();
        let backend = backend(&scene);
        for way in [Vec3::new(1.0, 0.1, 0.2), Vec3::new(-0.3, 1.0, -0.4), Vec3::new(0.0, -1.0, 0.0), Vec3::ONE] {
            let camera = camera(&scene, centre, centre + way, 512, 512);
            let (mask, cost) = trace(&backend, &scene, &camera);
            // Convex, seen from inside: every pixel sees the wall, and both lights reach every point of it.
            assert_eq!(cost.shadow_rays, 2 * 512 * 512);
            let dark = mask.words().iter().map(|word| word.count_zeros()).sum::<u32>();
            assert_eq!(dark, 0, "{rings} rings, towards {way}");
        }
    }
}

#[test]
fn no_light_leaks_through_a_closed_sphere() {
    for rings in [5, 64] {
        let mut b = Builder::new();
        let material = b.material(AlphaMode::Opaque, false, None);
        let centre = Vec3::new(-4.0, 3.0, 2.5);
        let v = |x: f32, y: f32, z: f32| centre + Vec3::new(x, y, z);
        b.draw(material, &sphere(centre, 2.0, rings, false));
        // The camera looks down on a table; both are inside the sphere.
        b.draw(material, &quad(v(-1.2, 0.0, 1.2), v(1.2, 0.0, 1.2), v(1.2, 0.0, -1.2), v(-1.2, 0.0, -1.2)));
        for light in [v(0.0, 9.0, 0.0), v(3.0, 4.0, -2.0), v(-2.0, 2.1, 0.01), v(0.5, 80.0, 90.0)] {
            b.light(LightKind::Point, light, Vec3::Y, f32::INFINITY);
        }
        b.light(LightKind::Directional, Vec3::ZERO, Vec3::new(0.1, -1.0, 0.3), f32::INFINITY);
        b.light(LightKind::Directional, Vec3::ZERO, Vec3::NEG_Y, f32::INFINITY);
        let scene = b.finish();
        let camera = camera(&scene, v(0.0, 1.0, 0.0), centre, 512, 512);
        let (mask, cost) = trace(&backend(&scene), &scene, &camera);
        assert!(cost.shadow_rays > 5 * 512 * 512);
        let lit = |mask: &Mask| mask.words().iter().map(|word| word.count_ones()).sum::<u32>();
        assert_eq!(lit(&mask), 0, "{rings} rings");

        // Even the smallest hole shows: one triangle is missing at the pole, below the light straight overhead.
        let mut holed = scene.clone();
        let hole = holed.triangles[0];
        for corner in hole {
            holed.positions[corner as usize] = scene.positions[hole[0] as usize] * 0.999 + centre * 0.001;
        }
        holed.positions[hole[1] as usize].x += 1e-4;
        holed.positions[hole[2] as usize].z += 1e-4;
        let (mask, _) = trace(&backend(&holed), &holed, &camera);
        assert!(lit(&mask) > 0, "{rings} rings and a hole");
    }
}

#[test]
fn a_scene_with_nothing_that_stops_rays_has_no_bit() {
    let mut b = Builder::new();
    let glass = b.material(AlphaMode::Blend, true, None);
    b.draw(glass, &quad(Vec3::ZERO, Vec3::X, Vec3::ONE, Vec3::Y));
    b.light(LightKind::Point, Vec3::Y, Vec3::Y, 5.0);
    let scene = b.finish();
    let camera = camera(&scene, Vec3::Z * 3.0, Vec3::ZERO, 33, 17);
    let (mask, cost) = trace(&backend(&scene), &scene, &camera);
    assert_eq!(mask.words().iter().map(|word| word.count_ones()).sum::<u32>(), 0);
    assert_eq!((cost.primary_rays, cost.shadow_rays), (33 * 17, 0));
}

#[test]
fn masks_do_not_depend_on_the_number_of_threads_nor_on_the_run() {
    let scene = medley();
    let camera = camera(&scene, Vec3::new(3.0, 2.2, 6.0), Vec3::new(0.0, 1.0, 0.0), 301, 170);
    let (first, _) = trace(&backend(&scene), &scene, &camera);
    for threads in [1, 3, 8] {
        let backend = CpuBackend::new(&scene, NonZeroUsize::new(threads)).unwrap();
        for _ in 0..2 {
            assert_eq!(trace(&backend, &scene, &camera).0, first, "{threads} threads");
        }
    }
}

#[test]
fn a_mask_material_without_its_picture_is_refused() {
    let mut scene = medley();
    scene.images[0].rgba.clear();
    assert!(matches!(CpuBackend::new(&scene, None), Err(BackendError::Alpha { material: 2 })));
}
