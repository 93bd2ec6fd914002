//! Broken and unsupported files never panic, hang or take much memory. Whatever Khronos' validator passes loads, and
//! whatever it calls an error is refused, or mended with a warning.
//!
//! The tests read the peak of their process's memory, so this file holds nothing else.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod common;

use std::{
    path::{Path, PathBuf},
    sync::mpsc,
    thread,
    time::Duration,
};

use common::{files, one_light, peak_kib, scenes};
use gnomon_scene::{LoadOptions, LoadReport, Scene, SceneError, WarningKind};
use serde_json::Value;

/// Only a hang takes this long: the slowest file takes milliseconds.
const HANG: Duration = Duration::from_secs(120);

/// Most memory that the process may ever have had, in KiB.
const MAX_PEAK_KIB: u64 = 1 << 20;

/// Validator errors with which a file may load without a warning: code, part of the pointer to the fault (empty: any),
/// and the reason.
const ALLOWED: [(&str, &str, &str); 41] = [
    ("", "/animations", "animations are not read: the scene is shown at rest"),
    ("", "/skins", "a skin that moves no mesh is not read"),
    ("", "/cameras", "only the field of view is read, of cameras that a node places"),
    ("", "/targets", "targets without weight are not read"),
    ("", "KHR_materials_variants", "without a wish the default materials are shown"),
    ("", "KHR_materials_anisotropy", "it is not drawn, which is said"),
    ("", "KHR_materials_specular", "a material that nothing uses is not read"),
    ("", "KHR_materials_volume", "it is not drawn, which is said"),
    ("", "/attributes/COLOR_0", "vertex colours are clamped to 0 to 1"),
    ("", "/attributes/TANGENT", "tangents are normalised, and without a normal map not read"),
    ("ACCESSOR_ELEMENT_OUT_OF_MAX_BOUND", "", "bounds are computed, not read"),
    ("ACCESSOR_ELEMENT_OUT_OF_MIN_BOUND", "", "bounds are computed, not read"),
    ("ACCESSOR_MAX_MISMATCH", "", "bounds are computed, not read"),
    ("ACCESSOR_MIN_MISMATCH", "", "bounds are computed, not read"),
    ("MESH_PRIMITIVE_POSITION_ACCESSOR_WITHOUT_BOUNDS", "", "bounds are computed, not read"),
    ("GLB_CHUNK_LENGTH_UNALIGNED", "", "bytes are copied: nothing depends on alignment"),
    ("BUFFER_VIEW_INVALID_BYTE_STRIDE", "", "targets of views are not read: an accessor's use decides"),
    ("BUFFER_VIEW_TARGET_OVERRIDE", "", "targets of views are not read: an accessor's use decides"),
    ("ACCESSOR_VECTOR3_NON_UNIT", "NORMAL", "normals are normalised"),
    ("ACCESSOR_INDEX_OOB", "", "in a mesh that no node shows, which is not read"),
    ("MESH_PRIMITIVE_TOO_FEW_TEXCOORDS", "", "in a mesh that no node shows, which is not read"),
    ("MESH_PRIMITIVE_NO_TANGENT_SPACE", "", "a normal map without tangents gets them from texture coordinates"),
    ("MESH_PRIMITIVE_JOINTS_WEIGHTS_MISMATCH", "", "a set of joints without weights counts for nothing"),
    ("EMPTY_ENTITY", "", "an empty list is as good as none"),
    ("DUPLICATE_ELEMENTS", "", "a name listed twice is as good as once"),
    ("UNDECLARED_EXTENSION", "", "the list of used extensions is not read"),
    ("NON_REQUIRED_EXTENSION", "", "the list of used extensions is not read"),
    ("UNEXPECTED_EXTENSION_OBJECT", "", "an extension in a place where it means nothing is ignored"),
    ("UNSATISFIED_DEPENDENCY", "", "an offset of 0 without a view, a skin without a mesh"),
    ("MESH_PRIMITIVES_UNEQUAL_TARGETS_COUNT", "", "each primitive takes the weights that it has targets for"),
    ("INVALID_URI", "/buffers", "an empty parameter of a data URI is passed over"),
    ("TEXTURE_INVALID_IMAGE_MIME_TYPE", "", "the first bytes tell a picture's format"),
    ("BUFFER_MISSING_GLB_DATA", "", "no accessor reads the missing buffer"),
    ("BUFFER_VIEW_TOO_BIG_BYTE_STRIDE", "", "a stride matters where elements are read"),
    ("INVALID_JSON", "", "a byte order mark is skipped"),
    ("MESH_INVALID_WEIGHTS_COUNT", "", "weights without a target, and targets without a weight, count for nothing"),
    ("", "/attributes/JOINTS", "weights are normalised; a mesh that no node shows is not read"),
    ("", "/attributes/WEIGHTS", "weights are normalised; a mesh that no node shows is not read"),
    ("", "KHR_lights_punctual", "a light that no node shows is not read"),
    ("", "KHR_materials_emissive_strength", "a material that nothing uses is not read"),
    ("", "/images", "no texture uses the picture"),
];

/// Legal files that are refused: the file, and a part of the error.
const REFUSED: [(&str, &str); 2] = [
    ("asset/min_version_valid.gltf", "2.1"),
    // Its mesh lies in a buffer without bytes.
    ("root/named_objects.gltf", "no uri"),
];

fn load(path: &Path, options: &LoadOptions) -> Result<(Scene, LoadReport), SceneError> {
    let (sender, receiver) = mpsc::sync_channel(1);
    let (file, options) = (path.to_owned(), options.clone());
    let worker = thread::spawn(move || sender.send(Scene::load_with_report(&file, &options)).is_ok());
    let result = receiver.recv_timeout(HANG);
    let result = result.unwrap_or_else(|error| panic!("{}: panicked or hung ({error})", path.display()));
    assert!(worker.join().unwrap());
    result
}

/// Returns the validator's errors about a file, as (code, pointer). `None` without a report.
fn reported(path: &Path) -> Option<Vec<(String, String)>> {
    let mut report = path.as_os_str().to_owned();
    report.push(".report.json");
    let report: Value = serde_json::from_slice(&std::fs::read(PathBuf::from(report)).ok()?).unwrap();
    let messages = report["issues"]["messages"].as_array().unwrap().iter();
    let text = |message: &Value, key: &str| message[key].as_str().unwrap_or_default().to_owned();
    Some(
        messages
            .filter(|message| message["severity"] == 0)
            .map(|message| (text(message, "code"), text(message, "pointer")))
            .collect(),
    )
}

#[test]
fn every_file_loads_or_fails_clearly() {
    let folder = tempfile::tempdir().unwrap();
    let options = one_light(folder.path());
    let mut used = [false; ALLOWED.len()];
    let (mut walked, mut judged, mut loaded, mut mended, mut wrong) = (0, 0, 0, 0, Vec::new());
    for path in files(&scenes().join("invalid")) {
        walked += 1;
        let result = load(&path, &options);
        loaded += usize::from(result.is_ok());
        let Some(errors) = reported(&path) else { continue };
        judged += 1;
        let warned = |report: &LoadReport| {
            let mended = |kind| matches!(kind, WarningKind::Mended | WarningKind::LeftOut);
            report.all().iter().any(|warning| mended(warning.kind))
        };
        match result {
            Ok((_, report)) if warned(&report) => mended += usize::from(!errors.is_empty()),
            Err(SceneError::NoTriangles { report, .. }) if warned(&report) => mended += usize::from(!errors.is_empty()),
            // Without triangles the load fails, whether or not the fault was found.
            Ok(_) | Err(SceneError::NoTriangles { .. }) => {
                for (code, pointer) in errors {
                    let allowed =
                        ALLOWED.iter().position(|(c, p, _)| (c.is_empty() || *c == code) && pointer.contains(p));
                    match allowed {
                        Some(index) => used[index] = true,
                        None => wrong.push(format!("{} has {code} at {pointer}, but loads", path.display())),
                    }
                }
            }
            Err(error) if errors.is_empty() => {
                let known = REFUSED.iter().any(|(file, says)| path.ends_with(file) && error.to_string().contains(says));
                if !known {
                    wrong.push(format!("{} is legal, but: {error}", path.display()));
                }
            }
            Err(_) => {}
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let stale: Vec<_> = ALLOWED.iter().zip(used).filter(|(_, used)| !used).collect();
    assert!(stale.is_empty(), "allowances without a file: {stale:?}");
    assert!(walked > 500 && judged > 200 && loaded > 0, "{walked} files, {judged} reports, {loaded} loaded");
    println!("{walked} files, {judged} judged by their reports, {loaded} loaded, {mended} of them mended");
    let peak = peak_kib();
    println!("peak of memory: {peak} KiB");
    assert!(peak < MAX_PEAK_KIB, "peak of memory: {peak} KiB");
}

/// Files that require what is not drawn, and the extension that their error must name.
const UNSUPPORTED: [(&str, &str); 2] =
    [("other/batched.glb", "CESIUM_RTC"), ("other/basic.glb", "KHR_gaussian_splatting")];

#[test]
fn files_with_rare_features_load_or_name_what_they_require() {
    let folder = tempfile::tempdir().unwrap();
    let options = one_light(folder.path());
    let rare = scenes().join("unsupported");
    let (mut loaded, mut refused) = (0, 0);
    for path in files(&rare) {
        if !path.extension().is_some_and(|extension| extension == "gltf" || extension == "glb") {
            continue;
        }
        let name = path.strip_prefix(&rare).unwrap().display().to_string();
        match UNSUPPORTED.iter().find(|(part, _)| name == *part) {
            Some((_, feature)) => {
                let error = load(&path, &options).expect_err(&name).to_string();
                assert!(error.contains(feature) && error.contains("not supported"), "{name}: {error}");
                refused += 1;
            }
            None => {
                load(&path, &options).unwrap_or_else(|error| panic!("{name}: {error}"));
                loaded += 1;
            }
        }
    }
    assert_eq!((loaded, refused), (20, UNSUPPORTED.len()));
}
