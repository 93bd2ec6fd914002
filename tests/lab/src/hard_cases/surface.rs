//! Surfaces: smooth normals on coarse meshes, alpha at its cutoff, coplanar faces.

use glam::{DVec3, Vec3};
use gnomon_scene::{AlphaMode, Wrap, camera::Camera};

use super::case::{Case, Known, look};
use crate::scenes::builder::SceneBuilder;

fn floor() -> SceneBuilder {
    SceneBuilder::new().quad(Vec3::new(-6.0, 0.0, -6.0), Vec3::Z * 12.0, Vec3::X * 12.0)
}

pub(super) fn cases(size: (u32, u32)) -> Vec<Case> {
    let mut cases = Vec::new();
    let view = look([0.7, 2.1, 4.3], [0.0, 0.5, 0.0], size);
    // Between the shading normal's terminator and the facets': Hanika, "Hacking the Shadow Terminator", Ray Tracing
    // Gems II, ch. 4. By our rules the facet decides.
    for rings in [3, 5, 9] {
        let ball = floor().material(AlphaMode::Opaque, false).sphere(Vec3::Y * 1.2, 1.1, rings);
        let scene = ball.sun(Vec3::new(-1.0, -0.2, 0.1)).point_light(Vec3::new(2.5, 1.0, 1.5), f32::INFINITY).build();
        cases.push(Case::judged(format!("terminator-{rings}"), scene, view));
    }
    // Alpha equal to the cutoff is opaque; one step less is not.
    for (name, alpha, cutoff) in [("at", 128, 128.0 / 255.0), ("below", 127, 128.0 / 255.0)] {
        let scene = floor()
            .material(AlphaMode::Mask { cutoff }, true)
            .alpha_picture(2, &[alpha; 4], Wrap::Repeat)
            .quad(Vec3::new(-6.0, 3.0, -6.0), Vec3::Z * 12.0, Vec3::X * 12.0)
            .sun(Vec3::NEG_Y)
            .build();
        let known = if name == "at" { Known::Dark } else { Known::Lit };
        cases.push(Case::all(
            format!("alpha-{name}-cutoff"),
            scene,
            look([0.5, 2.0, 1.0], [0.0, 0.0, 0.0], size),
            known,
        ));
    }
    // A checkerboard of texels far smaller than a pixel's footprint.
    let chequer: Vec<u8> = (0..64_u8).map(|i| if (i / 8 + i) % 2 == 0 { 255 } else { 0 }).collect();
    let mut minified = floor()
        .material(AlphaMode::Mask { cutoff: 0.5 }, true)
        .alpha_picture(8, &chequer, Wrap::Repeat)
        .quad(Vec3::new(-2.0, 1.5, -2.0), Vec3::Z * 4.0, Vec3::X * 4.0)
        .sun(Vec3::new(0.3, -1.0, -0.2))
        .build();
    minified.uvs.iter_mut().for_each(|uv| *uv *= 100.0);
    cases.push(Case::judged("alpha-minified", minified, view).doubtful(0.01));
    // Alpha of vertices: a sheet that fades from one side to the other, alone and times its picture.
    for (name, has_picture) in [("alone", false), ("and-picture", true)] {
        let sheet = floor().material(AlphaMode::Mask { cutoff: 0.5 }, true);
        let sheet = if has_picture { sheet.alpha_picture(8, &chequer, Wrap::Repeat) } else { sheet };
        let mut faded = sheet
            .quad(Vec3::new(-2.0, 1.5, -2.0), Vec3::Z * 4.0, Vec3::X * 4.0)
            .sun(Vec3::new(0.3, -1.0, -0.2))
            .build();
        let alpha = |at: &Vec3| if at.x > 0.0 && at.y > 0.0 { 60_000 } else { 0 };
        faded.colors = faded.positions.iter().map(|at| [u16::MAX, u16::MAX, u16::MAX, alpha(at)]).collect();
        cases.push(Case::judged(format!("vertex-alpha-{name}"), faded, view));
    }

    // Two boxes with overlapping coplanar sides, a sheet on the floor, and a doubled one.
    let coplanar = floor()
        .quad(Vec3::new(-2.0, 0.0, -1.0), Vec3::Z * 3.0, Vec3::X * 3.0)
        .quad(Vec3::new(-2.0, 0.0, -1.0), Vec3::Z * 3.0, Vec3::X * 3.0)
        .cuboid(Vec3::new(-1.0, 0.0, -1.0), Vec3::new(0.5, 1.0, 0.7))
        .cuboid(Vec3::new(-0.3, 0.2, -0.6), Vec3::new(1.2, 1.5, 0.7))
        .sun(Vec3::new(0.5, -1.0, -0.6))
        .point_light(Vec3::new(1.0, 2.5, 2.0), f32::INFINITY)
        .build();
    cases.push(Case::judged("coplanar", coplanar, view));
    // Faces in one tilted plane with independently rounded corners: none may shadow another.
    let (u, v) = (Vec3::new(0.7, 0.2, 0.1), Vec3::new(-0.1, 0.15, 0.8));
    let mut tilted = SceneBuilder::new();
    for i in 0..24_i8 {
        let corner = (u * f32::from(i % 6 - 3) + v * f32::from(i / 6 - 2)) * 1.7;
        tilted = tilted.quad(corner, u * 2.9, v * 2.9);
    }
    let up = v.cross(u).normalize();
    let scene = tilted.point_light(up * 3.0, f32::INFINITY).sun(-(up + u * 3.0)).build();
    let eye = up.as_dvec3() * 2.0 + DVec3::new(0.1, 0.0, 0.2);
    let camera = Camera::looking_at(eye, DVec3::new(0.3, 0.2, 0.4), 0.9, size.0, size.1);
    cases.push(Case::all("coplanar-tilted", scene, camera, Known::Lit));
    cases
}
