//! Small scenes with one difficulty each: triangles, bounds and lights match an independent reader's counts.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod common;

use common::{files, one_light, scenes};
use gnomon_scene::{LightKind, LoadOptions, Scene, SceneError};

/// File, triangles kept, zero-area triangles dropped, lowest and highest corner in metres.
type Expected = (&'static str, usize, u64, [f64; 3], [f64; 3]);

const UNIT: [f64; 3] = [1.0; 3];
const HALF: [f64; 3] = [0.5; 3];
const MINUS_UNIT: [f64; 3] = [-1.0; 3];
const MINUS_HALF: [f64; 3] = [-0.5; 3];

const SCENES: [Expected; 36] = [
    ("alpha/01_alpha_mask/01_alpha_mask.gltf", 2, 0, [-1.0, 0.0, -1.0], [1.0, 0.0, 1.0]),
    ("alpha/AlphaBlendModeTest.glb", 61, 0, [-4.3, -0.1, -0.75], [4.3, 2.3, 0.55]),
    ("alpha/PrimitiveModeNormalsTest.glb", 2562, 0, [-10.0, -7.0, -1.5], [10.0, 7.0, 1.5]),
    ("animated/03_all_animations/03_all_animations.gltf", 976, 0, [-1.0, -1.0, -5.118], [1.0, 5.0, 1.0]),
    (
        "animated/05_metallic_sphere_light/05_metallic_sphere_light.gltf",
        962,
        0,
        [-10.0, -1.0, -10.0],
        [10.0, 1.0, 10.0],
    ),
    ("animated/07_nla-anim/07_nla-anim.gltf", 36, 0, [-1.0, -1.0, -4.0], [4.0, 1.0, 1.0]),
    ("animated/AnimatedCube/glTF/AnimatedCube.gltf", 12, 0, MINUS_UNIT, UNIT),
    ("animated/CesiumMilkTruck.glb", 3624, 0, [-2.431, 0.001, -1.396], [2.438, 2.584, 1.396]),
    ("animated/SimpleAnimation.glb", 12, 0, [-0.001, -0.385, -0.615], [0.999, 0.615, 0.385]),
    ("cornell/CornellBox.glb", 36, 0, [-556.0, 0.0, -559.2], [0.0, 548.8, 0.0]),
    ("correctness/01_vertex_count_32bit/01_vertex_count_32bit.gltf", 130380, 0, [-1.0, -1.0, -2.627], [1.0, 1.0, 2.8]),
    ("correctness/02_shared_mesh/02_shared_mesh.gltf", 24, 0, [-1.0, -1.414, -1.414], [5.0, 1.414, 1.414]),
    (
        "correctness/2CylinderEngine-glTF-Binary/2CylinderEngine.glb",
        110336,
        11160,
        [-371.692, -180.972, -140.0],
        [371.692, 92.042, 128.0],
    ),
    ("correctness/Box With Spaces/glTF/Box With Spaces.gltf", 12, 0, MINUS_UNIT, UNIT),
    ("correctness/BoxInterleaved.glb", 12, 0, MINUS_HALF, HALF),
    ("correctness/Duck.glb", 4212, 0, [-0.693, 0.099, -0.613], [0.962, 1.64, 0.539]),
    (
        "correctness/OrientationTest/glTF-Binary/OrientationTest.glb",
        524,
        0,
        [-5.331, -5.331, -5.331],
        [5.331, 5.331, 5.331],
    ),
    (
        "correctness/OrientationTest/glTF-Embedded/OrientationTest.gltf",
        524,
        0,
        [-5.331, -5.331, -5.331],
        [5.331, 5.331, 5.331],
    ),
    ("correctness/OrientationTest/glTF/OrientationTest.gltf", 524, 0, [-5.331, -5.331, -5.331], [5.331, 5.331, 5.331]),
    ("correctness/TriangleWithPaddingInGlbBin.glb", 1, 0, [0.0, 0.0, 0.0], [1.0, 1.0, 0.0]),
    ("correctness/TwoSidedPlane.glb", 2, 0, [-1.0, 0.0, -1.0], [1.0, 0.0, 1.0]),
    ("correctness/box_sparse.glb", 12, 0, MINUS_HALF, HALF),
    ("correctness/cubeFan.glb", 12, 0, MINUS_HALF, HALF),
    ("correctness/cubeFanIndexed.glb", 12, 0, MINUS_HALF, HALF),
    ("correctness/cubeQuantized.glb", 12, 0, MINUS_HALF, HALF),
    ("correctness/cubeStrip.glb", 12, 6, MINUS_HALF, HALF),
    ("correctness/many-cubes/many-cubes.gltf", 6012, 0, [-3.779, -3.896, -4.02], [4.785, 4.466, 4.322]),
    ("correctness/mode5.gltf", 2786, 0, [-18.506, 1.778, 15.686], [38.644, 66.314, 91.804]),
    ("correctness/nested.glb", 36, 0, [-1.167, -2.337, -0.269], [0.269, 1.0, 0.269]),
    ("correctness/no_indices_3storybuilding.glb", 72, 0, [-23.207, 0.0, 0.0], [32.873, 9.0, 63.361]),
    ("correctness/textureTransform/TextureTransformTest.gltf", 24, 0, [-1.6, -1.141, 0.0], [1.6, 1.05, 0.01]),
    ("lights/Cubes.glb", 36, 0, [-4.284, -1.938, -2.994], [4.603, 3.591, 3.639]),
    ("lights/DepthOfFieldExample.glb", 10610, 0, [-3.238, 0.168, -3.238], [3.238, 1.175, 3.238]),
    ("lights/Extensions-overwrite-issue261/issue-261.gltf", 12, 0, MINUS_HALF, HALF),
    ("lights/Lights.glb", 12, 0, MINUS_UNIT, UNIT),
    ("lights/geometry-camera-light.glb", 14, 0, [-7.102, -7.102, -1.04], [7.102, 7.102, 1.0]),
];

/// The same square in every triangle mode.
const SQUARES: [&str; 8] = ["04", "05", "06", "11", "12", "13", "14", "15"];

fn expected() -> impl Iterator<Item = (String, usize, u64, [f64; 3], [f64; 3])> {
    let squares = SQUARES.map(|number| {
        let file = format!("correctness/glTF-Asset-Generator/Mesh_PrimitiveMode/Mesh_PrimitiveMode_{number}.gltf");
        (file, 2, 0, [-0.5, -0.5, 0.0], [0.5, 0.5, 0.0])
    });
    SCENES
        .map(|(file, triangles, dropped, min, max)| (file.to_owned(), triangles, dropped, min, max))
        .into_iter()
        .chain(squares)
}

#[test]
fn every_small_scene_has_its_triangles_and_bounds() {
    let folder = tempfile::tempdir().unwrap();
    let options = one_light(folder.path());
    for (file, triangles, dropped, min, max) in expected() {
        let path = scenes().join(&file);
        let loaded = Scene::load_with_report(&path, &options);
        let (scene, report) = loaded.unwrap_or_else(|error| panic!("{file}: {error}"));
        assert_eq!((scene.triangles.len(), report.dropped_triangles), (triangles, dropped), "{file}");
        let summary = scene.summary();
        for (got, expected) in [(summary.min_m, min), (summary.max_m, max)] {
            let difference = (got - glam::DVec3::from_array(expected)).abs().max_element();
            assert!(difference <= 1e-3, "{file}: {got} instead of {expected:?}");
        }
        let packed = scene.pack().unwrap_or_else(|error| panic!("{file}: {error}"));
        assert!(Scene::unpack(&packed).unwrap() == scene, "{file} did not survive packing");
        let kept = folder.path().join("kept.scene");
        std::fs::write(&kept, &packed).unwrap();
        assert!(Scene::load(&kept, &LoadOptions::default()).unwrap() == scene, "{file} is another scene from its pack");
        std::fs::write(&kept, &packed[..packed.len() / 2]).unwrap();
        let error = Scene::load(&kept, &LoadOptions::default()).unwrap_err();
        assert!(matches!(error, SceneError::Packed { .. }), "{file}: {error}");
    }
}

#[test]
fn every_small_scene_is_listed() {
    for folder in ["correctness", "alpha", "animated", "lights", "cornell"] {
        for path in files(&scenes().join(folder)) {
            if !path.extension().is_some_and(|extension| extension == "gltf" || extension == "glb") {
                continue;
            }
            let listed = expected().any(|(file, ..)| path.ends_with(file));
            if !listed {
                // Points and lines.
                let error = Scene::load(&path, &LoadOptions::default()).expect_err(&path.display().to_string());
                assert!(matches!(error, SceneError::NoTriangles { skipped: 1, .. }), "{}: {error}", path.display());
            }
        }
    }
}

#[test]
fn lights_of_every_kind_are_found() {
    let kinds = |file: &str| {
        let scene = Scene::load(&scenes().join("lights").join(file), &LoadOptions::default()).unwrap();
        let kind = |kind| match kind {
            LightKind::Directional => "directional",
            LightKind::Point => "point",
            LightKind::Spot { .. } => "spot",
        };
        scene.lights.iter().map(|light| kind(light.kind)).collect::<Vec<_>>()
    };
    assert_eq!(kinds("Cubes.glb"), ["point"]);
    assert_eq!(kinds("DepthOfFieldExample.glb"), ["directional"]);
    assert_eq!(kinds("Extensions-overwrite-issue261/issue-261.gltf"), ["point"]);
    assert_eq!(kinds("Lights.glb"), ["point", "spot", "spot", "directional"]);
    assert_eq!(kinds("geometry-camera-light.glb"), ["point", "spot"]);
}
