//! The referee: a plain f64 tracer that shares no code with the back ends.
//!
//! It follows the rules of `gnomon_server::visibility` exactly, from the scene and the camera's f64 rays alone, with
//! its own BVH, triangle test and alpha sampling. For every pixel it decides whether there is a surface, which lights
//! are relevant, which of them reach it, and which of these decisions are **undecided**: closer to the other outcome
//! than f32 can resolve.
//!
//! The shadow ray starts at the exact f64 point, pushed along the geometric normal by 1e-9 of the scene's magnitude
//! (some 1e-8 m in a building; f64 rounding is a million times smaller), and its own triangle cannot block it.
//!
//! **Undecided** is found by experiment. f32 cannot resolve points closer than 2^-24 of their coordinates; a back end
//! rounds the ray's start, its direction and the point a few times each, so it may be off by `rounding_m` = 2^-21 of
//! the scene's magnitude. If any decision of a pixel passes within that distance of an edge, another surface or a limit
//! (range, cone, facing, alpha cutoff), the pixel is judged eight more times, with the camera and the point moved by
//! `rounding_m` along each diagonal; bits that change are undecided. They stay in every figure and are reported beside
//! it, to explain a difference, never to excuse one.
//!
//! **Ties** are decided: a plane that contains the camera or the light (to a thousandth of the push) follows the rules
//! for certain, and back ends must agree.

mod alpha;
mod animation;
mod bvh;
#[cfg(test)]
mod closed_form;
mod pixel;
mod shape;
mod triangle;

use glam::DVec3;
use gnomon_scene::{Light, LightKind, Scene, camera::Camera};
use rayon::prelude::*;

use alpha::AlphaTest;
use animation::Animated;
use bvh::Bvh;

/// Lights beyond this multiple of the scene's greatest coordinate count as distant.
const AFAR: f64 = 4.0;

/// Verdicts for one picture, row by row; bit k of a word is light k.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Truth {
    pub width: u32,
    pub height: u32,
    pub lights: u32,
    pub pixels: Vec<Verdict>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Verdict {
    pub surface: bool,
    pub relevant: u32,
    pub lit: u32,
    /// Lights whose relevance or visibility rounding may change.
    pub undecided: u32,
}

impl Truth {
    /// Returns the verdict for pixel (x, y). Panics outside the picture.
    pub fn at(&self, x: u32, y: u32) -> Verdict {
        assert!(x < self.width && y < self.height, "({x}, {y}) outside {}×{}", self.width, self.height);
        self.pixels[(y * self.width + x) as usize]
    }
}

/// A point that a pixel shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    pub place: DVec3,
    /// Unit normal of the triangle's plane, towards the camera.
    pub normal: DVec3,
    /// Along the view.
    pub depth_m: f64,
}

#[derive(Debug)]
pub struct Reference {
    origin_m: DVec3,
    corners: Vec<[DVec3; 3]>,
    surfaces: Vec<Surface>,
    bvh: Bvh,
    materials: Vec<Sheet>,
    lights: Vec<Light>,
    /// Resolution of f32 in this scene, in metres: see the module.
    rounding_m: f64,
    /// Offset of shadow rays from their surface, in metres.
    push_m: f64,
    /// Distances below this are 0 up to f64 rounding, in metres.
    exact_m: f64,
}

#[derive(Debug)]
struct Surface {
    normals: [DVec3; 3],
    uvs: [[f64; 2]; 3],
    /// Alpha of the corners.
    alphas: [f64; 3],
    material: u32,
}

#[derive(Debug)]
struct Sheet {
    double_sided: bool,
    alpha: Option<AlphaTest>,
}

impl Reference {
    /// Prepares the OPAQUE and MASK triangles of a scene at time 0. `rounding_m` follows from the scene's size: see the
    /// module.
    pub fn new(scene: &Scene) -> Self {
        Self::at(scene, 0.0)
    }

    /// As [`Self::new`], with what moves where it is at a time of the scene, in seconds.
    pub fn at(scene: &Scene, time_s: f64) -> Self {
        let animated = Animated::new(scene, time_s);
        let all_lights = animated.as_ref().map_or_else(|| scene.lights.clone(), Animated::lights);
        let (mut corners, mut surfaces) = (Vec::new(), Vec::new());
        let traced = scene.tracing_triangles().len();
        for draw in &scene.draws {
            let first = draw.first_triangle as usize;
            let end = (first + draw.triangles as usize).min(traced);
            for triangle in scene.triangles.get(first..end).unwrap_or_default() {
                let moving = animated.as_ref().and_then(|animated| Some((animated, animated.piece(*triangle)?)));
                if moving.as_ref().is_some_and(|(animated, piece)| !animated.is_shown(*piece)) {
                    continue;
                }
                let [a, b, c] = *triangle;
                let turned = moving.as_ref().is_some_and(|(animated, piece)| animated.is_turned(*piece));
                let triangle = if turned { [a, c, b] } else { [a, b, c] };
                let vertices = triangle.map(|vertex| vertex as usize);
                let (positions, normals) = match moving {
                    Some((animated, piece)) => {
                        let moved = triangle.map(|vertex| animated.vertex(piece, vertex));
                        (moved.each_ref().map(|vertex| vertex.position), moved.map(|vertex| vertex.normal.normalize()))
                    }
                    None => (
                        vertices.map(|vertex| scene.positions[vertex].as_dvec3()),
                        vertices.map(|vertex| scene.normals[vertex].as_dvec3()),
                    ),
                };
                if !has_area(&positions) {
                    continue;
                }
                corners.push(positions);
                surfaces.push(Surface {
                    normals,
                    uvs: vertices.map(|vertex| scene.uvs[vertex].as_dvec2().to_array()),
                    alphas: vertices.map(|vertex| {
                        scene.colors.get(vertex).map_or(1.0, |color| f64::from(color[3]) / f64::from(u16::MAX))
                    }),
                    material: draw.material,
                });
            }
        }
        let lights = all_lights.iter().filter(|light| light.kind != LightKind::Directional);
        let scene_m =
            corners.iter().flatten().map(|corner| corner.abs().max_element()).fold(f64::MIN_POSITIVE, f64::max);
        // For more distant lights only the direction counts, which is as precise as at this distance.
        let magnitude_m = lights
            .map(|light| light.position.as_dvec3().abs().max_element().min(AFAR * scene_m))
            .fold(scene_m, f64::max);
        let rounding_m = magnitude_m * 2.0_f64.powi(-21);
        Self {
            origin_m: scene.origin_m,
            bvh: Bvh::new(&corners, rounding_m * 4.0),
            corners,
            surfaces,
            materials: scene
                .materials
                .iter()
                .map(|material| Sheet { double_sided: material.double_sided, alpha: AlphaTest::new(scene, material) })
                .collect(),
            lights: all_lights,
            rounding_m,
            push_m: magnitude_m * 1e-9,
            exact_m: magnitude_m * 1e-12,
        }
    }

    /// Returns the point that each pixel of the camera's picture shows, row by row.
    pub fn points(&self, camera: &Camera) -> Vec<Option<Point>> {
        let pixels = 0..camera.width * camera.height;
        pixels.into_par_iter().map(|pixel| self.point(camera, pixel % camera.width, pixel / camera.width)).collect()
    }

    /// Judges every pixel of the camera's picture, on the current rayon pool.
    pub fn trace(&self, camera: &Camera) -> Truth {
        let mut pixels = vec![Verdict::default(); camera.width as usize * camera.height as usize];
        pixels.par_chunks_mut(camera.width as usize).zip(0..camera.height).for_each(|(row, y)| {
            for (verdict, x) in row.iter_mut().zip(0..camera.width) {
                *verdict = self.judge(camera, x, y);
            }
        });
        let lights = u32::try_from(self.lights.len()).unwrap_or(u32::MAX);
        Truth { width: camera.width, height: camera.height, lights, pixels }
    }
}

/// What moves may shrink to nothing. What rests has an area.
fn has_area([a, b, c]: &[DVec3; 3]) -> bool {
    let (ab, ac) = (*b - *a, *c - *a);
    ab.cross(ac).length() > 1e-7 * ab.length_squared().max(ac.length_squared()).max((*c - *b).length_squared())
}
