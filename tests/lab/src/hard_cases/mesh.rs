//! Meshes that break intersection tests and hierarchies: aimed-at edges, thin gaps and sheets, slivers, heaps, and
//! unusual node matrices.

use std::fmt::Write as _;

use anyhow::{Context, Result};
use glam::{Vec2, Vec3};
use gnomon_scene::{AlphaMode, LoadOptions, Scene};

use super::{
    case::{Case, Known, look},
    place::still_life,
};
use crate::scenes::builder::SceneBuilder;

fn flat(builder: SceneBuilder, corners: [Vec3; 3]) -> SceneBuilder {
    let [a, b, c] = corners;
    builder.triangle(corners, [(b - a).cross(c - a).normalize_or(Vec3::Y); 3], [Vec2::ZERO; 3])
}

/// A lamp at the camera behind a single-sided sheet in front of a wall. The camera sees the wall through the sheet's
/// back, every pixel centre aims at a corner or edge of the sheet, and no light may pass.
fn aimed(size: (u32, u32), bumps: f32) -> Case {
    let camera = look([0.0; 3], [0.0, 0.0, -1.0], size);
    // Corners lie on the rays of every other pixel centre in both directions, one beyond the picture on each side.
    let corner = |column: i64, row: i64| {
        #[expect(clippy::cast_precision_loss, reason = "pixels of a small picture")]
        let [x, y] = [(column, size.0), (row, size.1)].map(|(at, side)| (2 * at) as f64 * 2.0 / f64::from(side));
        let (from, first) = camera.ray(0, 0);
        let (_, right) = camera.ray(1, 0);
        let (_, down) = camera.ray(0, 1);
        let [dx, dy] = [(right - first) * f64::from(size.0) / 2.0, (down - first) * f64::from(size.1) / 2.0];
        let way = first + dx * x + dy * y;
        #[expect(clippy::cast_precision_loss, reason = "a small number")]
        let depth = 1.0 + f64::from(bumps) * ((column * 7 + row * 3).rem_euclid(5)) as f64;
        (from + way / -way.z * depth).as_vec3()
    };
    let mut builder = SceneBuilder::new()
        .quad(Vec3::new(-9.0, -9.0, -5.0), Vec3::X * 18.0, Vec3::Y * 18.0)
        .material(AlphaMode::Opaque, false);
    for row in -1..i64::from(size.1 / 2) + 1 {
        for column in -1..i64::from(size.0 / 2) + 1 {
            let [a, b] = [corner(column, row), corner(column + 1, row)];
            let [c, d] = [corner(column, row + 1), corner(column + 1, row + 1)];
            // Wound to face away from the camera.
            builder = flat(flat(builder, [a, b, c]), [b, d, c]);
        }
    }
    let scene = builder.point_light(Vec3::ZERO, f32::INFINITY).build();
    Case::all(format!("aimed-at-edges-{bumps}"), scene, camera, Known::Dark)
}

fn gaps(size: (u32, u32)) -> Vec<Case> {
    let floor = || SceneBuilder::new().quad(Vec3::new(-5.0, 0.0, -5.0), Vec3::Z * 10.0, Vec3::X * 10.0);
    let (view, thin) = (look([0.5, 2.0, 3.5], [0.0, 0.3, 0.0], size), 1e-3);
    // 10⁻³ m in a scene of 10 m: a slit in a roof, a box that hovers, and a sheet with two faces.
    let roof = |left: f32| floor().quad(Vec3::new(left, 2.5, -5.0), Vec3::Z * 10.0, Vec3::X * 5.0);
    let slit = roof(-5.0).quad(Vec3::new(thin, 2.5, -5.0), Vec3::Z * 10.0, Vec3::X * 5.0);
    let hovering = floor().cuboid(Vec3::new(-0.8, thin, -0.8), Vec3::new(0.8, 1.0, 0.8));
    let sheet = floor().cuboid(Vec3::new(-0.8, 0.0, -0.8), Vec3::new(-0.8 + thin, 1.2, 0.8));
    let sun = Vec3::new(0.3, -1.0, -0.4);
    let lamp = Vec3::new(1.5, 1.8, 1.0);
    vec![
        Case::judged(
            "gap-slit",
            slit.sun(Vec3::new(0.0, -1.0, 0.1)).build(),
            look([0.1, 1.0, 0.9], [0.0, 0.0, 0.0], size),
        ),
        Case::judged("gap-under-box", hovering.sun(sun).point_light(lamp, f32::INFINITY).build(), view),
        Case::judged("thin-sheet", sheet.sun(sun).point_light(lamp, f32::INFINITY).build(), view),
    ]
}

fn broken_triangles(size: (u32, u32)) -> Vec<Case> {
    let view = look([0.7, 2.1, 4.3], [0.0, 0.5, 0.0], size);
    // A tent of slivers 10⁻³ to 10⁻⁶ as wide as they are long, each with a neighbour.
    let mut slivers = still_life();
    for i in 0..60_u8 {
        let left = -3.0 + 0.1 * f32::from(i);
        let width = 10.0_f32.powi(-i32::from(i % 4) - 3);
        let [foot, top] = [Vec3::new(left, 0.0, 2.0), Vec3::new(left + 0.05, 1.5, -2.0)];
        slivers = flat(slivers, [foot, foot + Vec3::X * width, top]);
        slivers = flat(slivers, [foot + Vec3::X * width, foot + Vec3::X * 0.02, top]);
    }
    let point = Vec3::new(0.4, 0.9, 1.0);
    let mut heap = still_life();
    for _ in 0..20 {
        heap = flat(heap, [point; 3]);
        heap = flat(heap, [point, point + Vec3::X, point + Vec3::X * 0.5]);
        heap = flat(heap, [point - Vec3::Y * 0.3, point + Vec3::X * 0.3, point + Vec3::Z * 0.3]);
    }
    vec![Case::judged("slivers", slivers.build(), view), Case::judged("zero-area-and-duplicates", heap.build(), view)]
}

/// Meshes whose hierarchies cannot be balanced, or whose boxes do not separate triangles.
fn heaps(size: (u32, u32), large: bool) -> Vec<Case> {
    let view = look([0.7, 2.1, 4.3], [0.0, 0.5, 0.0], size);
    let mut concentric = still_life();
    for i in 1..=400_u16 {
        let r = 0.004 * f32::from(i);
        let centre = Vec3::new(0.0, 2.2, 0.0);
        let corner = |turn: f32| centre + Vec3::new(turn.cos(), 0.2 * turn.sin(), turn.sin()) * r;
        concentric = flat(concentric, [corner(0.0), corner(2.094_395), corner(4.188_79)]);
    }
    let mut row = still_life();
    for i in 0..3000_u16 {
        // Distances double, then start anew: a chain for a spatial splitter.
        let at = Vec3::splat(1.5) + Vec3::new(-1.0, 0.1, -0.6) * 2.0_f32.powi(-i32::from(i % 40));
        row = flat(row, [at, at + Vec3::X * 0.01, at + Vec3::Y * (0.01 + 1e-6 * f32::from(i))]);
    }
    let count = if large { 1 << 20 } else { 1 << 12 };
    let mut point = still_life();
    let at = Vec3::new(0.4, 1.9, 1.0);
    for _ in 0..count {
        point = flat(point, [at, at + Vec3::X * 0.02, at + Vec3::Z * 0.02]);
    }
    vec![
        Case::judged("bvh-equal-centroids", concentric.build(), view).doubtful(0.02),
        Case::judged("bvh-diagonal-row", row.build(), view),
        Case::judged("bvh-one-place", point.build(), view),
    ]
}

/// Loads a floor, and a pyramid with this top under a node with this column-major matrix.
fn loaded(top: [f32; 3], matrix: [f32; 16]) -> Result<Scene> {
    let folder = tempfile::tempdir()?;
    let positions: [[f32; 3]; 9] = [
        [-5.0, 0.0, -5.0],
        [-5.0, 0.0, 5.0],
        [5.0, 0.0, 5.0],
        [5.0, 0.0, -5.0],
        [-0.5, 0.3, -0.5],
        [-0.5, 0.3, 0.5],
        [0.5, 0.3, 0.5],
        [0.5, 0.3, -0.5],
        top,
    ];
    let indices: [u32; 24] = [0, 1, 2, 0, 2, 3, 4, 6, 5, 4, 7, 6, 4, 5, 8, 5, 6, 8, 6, 7, 8, 7, 4, 8];
    let mut bytes: Vec<u8> = bytemuck::cast_slice(&positions).to_vec();
    bytes.extend_from_slice(bytemuck::cast_slice(&indices));
    std::fs::write(folder.path().join("mesh.bin"), &bytes)?;
    let mut matrix_json = String::new();
    for value in matrix {
        let comma = if matrix_json.is_empty() { "" } else { "," };
        write!(matrix_json, "{comma}{value}")?;
    }
    let mesh = |indices: u32| format!(r#"{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":{indices}}}]}}"#);
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"extensionsUsed":["KHR_lights_punctual"],
        "extensions":{{"KHR_lights_punctual":{{"lights":[{{"type":"point"}},{{"type":"directional"}}]}}}},
        "buffers":[{{"uri":"mesh.bin","byteLength":{length}}}],
        "bufferViews":[{{"buffer":0,"byteLength":108}},{{"buffer":0,"byteOffset":108,"byteLength":96}}],
        "accessors":[
          {{"bufferView":0,"componentType":5126,"count":9,"type":"VEC3","min":[-5,0,-5],"max":[5,1.2,5]}},
          {{"bufferView":1,"componentType":5125,"count":6,"type":"SCALAR"}},
          {{"bufferView":1,"byteOffset":24,"componentType":5125,"count":18,"type":"SCALAR"}}],
        "meshes":[{floor},{pyramid}],
        "nodes":[{{"mesh":0}},{{"mesh":1,"matrix":[{matrix_json}]}},
          {{"translation":[1.5,2.5,1],"extensions":{{"KHR_lights_punctual":{{"light":0}}}}}},
          {{"rotation":[-0.6,0.2,0,0.7745967],"extensions":{{"KHR_lights_punctual":{{"light":1}}}}}}],
        "scenes":[{{"nodes":[0,1,2,3]}}],"scene":0}}"#,
        length = bytes.len(),
        floor = mesh(1),
        pyramid = mesh(2),
    );
    let file = folder.path().join("scene.gltf");
    std::fs::write(&file, json)?;
    Ok(Scene::load(&file, &LoadOptions::default())?)
}

const TOP: [f32; 3] = [0.0, 1.2, 0.0];

/// Files with a vertex that is nowhere, and how many of its triangles the loader kept.
pub(super) fn kept() -> Result<Vec<(&'static str, f64)>> {
    let mut still = [0.0; 16];
    (still[0], still[5], still[10], still[15]) = (1.0, 1.0, 1.0, 1.0);
    let whole = loaded(TOP, still)?;
    let at_top = |corners: &&[u32; 3]| corners.iter().any(|corner| whole.positions[*corner as usize].y == TOP[1]);
    let others = whole.triangles.len() - whole.triangles.iter().filter(at_top).count();
    [("vertex-nan", f32::NAN), ("vertex-infinite", f32::INFINITY)]
        .map(|(name, height)| Ok((name, loaded([0.0, height, 0.0], still)?.triangles.len() as f64 - others as f64)))
        .into_iter()
        .collect()
}

pub(super) fn cases(size: (u32, u32), large: bool) -> Result<Vec<Case>> {
    let mut cases = vec![aimed(size, 0.0), aimed(size, 0.04)];
    cases.extend(gaps(size));
    cases.extend(broken_triangles(size));
    cases.extend(heaps(size, large));
    let columns = |x: [f32; 3], y: [f32; 3], z: [f32; 3], at: [f32; 3]| {
        [x[0], x[1], x[2], 0.0, y[0], y[1], y[2], 0.0, z[0], z[1], z[2], 0.0, at[0], at[1], at[2], 1.0]
    };
    let (x, y, z) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
    for (name, matrix) in [
        ("matrix-mirrored", columns([-1.3, 0.0, 0.0], y, z, [0.4, 0.1, 0.2])),
        ("matrix-sheared", columns(x, [0.7, 1.0, -0.4], [0.3, 0.2, 1.0], [0.0, 0.2, 0.0])),
        ("matrix-singular", columns(x, [0.0; 3], z, [0.0, 0.9, 0.0])),
        ("matrix-tiny", columns([1e-4, 0.0, 0.0], y, z, [0.3, 0.2, 0.0])),
    ] {
        let scene = loaded(TOP, matrix).with_context(|| format!("the case {name}"))?;
        cases.push(Case::judged(name, scene, look([1.5, 2.2, 3.6], [0.0, 0.4, 0.0], size)));
    }
    Ok(cases)
}
