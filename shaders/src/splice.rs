//! WGSL with include-once imports: the first line `#import "shared/mask.wgsl"` is replaced by that file, later ones are
//! removed.
//!
//! All of `wgsl/` is compiled into the program. Files under `shared/` are only imported.

use thiserror::Error;

use crate::uniforms::Uniforms;

/// WGSL files: their paths under `wgsl/`, and their texts.
type Files = &'static [(&'static str, &'static str)];

/// Every WGSL file.
pub const FILES: [Files; 2] = [SHADING, TRACING];

/// Those of the client.
const SHADING: Files = &[
    ("shading/around.wgsl", include_str!("../wgsl/shading/around.wgsl")),
    ("shading/baseline.wgsl", include_str!("../wgsl/shading/baseline.wgsl")),
    ("shading/before.wgsl", include_str!("../wgsl/shading/before.wgsl")),
    ("shading/blend.wgsl", include_str!("../wgsl/shading/blend.wgsl")),
    ("shading/changed.wgsl", include_str!("../wgsl/shading/changed.wgsl")),
    ("shading/debug_view.wgsl", include_str!("../wgsl/shading/debug_view.wgsl")),
    ("shading/depth.wgsl", include_str!("../wgsl/shading/depth.wgsl")),
    ("shading/edges.wgsl", include_str!("../wgsl/shading/edges.wgsl")),
    ("shading/environment.wgsl", include_str!("../wgsl/shading/environment.wgsl")),
    ("shading/erase.wgsl", include_str!("../wgsl/shading/erase.wgsl")),
    ("shading/finish.wgsl", include_str!("../wgsl/shading/finish.wgsl")),
    ("shading/gbuffer.wgsl", include_str!("../wgsl/shading/gbuffer.wgsl")),
    ("shading/inputs.wgsl", include_str!("../wgsl/shading/inputs.wgsl")),
    ("shading/lighting.wgsl", include_str!("../wgsl/shading/lighting.wgsl")),
    ("shading/mask_words.wgsl", include_str!("../wgsl/shading/mask_words.wgsl")),
    ("shading/material.wgsl", include_str!("../wgsl/shading/material.wgsl")),
    ("shading/meter.wgsl", include_str!("../wgsl/shading/meter.wgsl")),
    ("shading/pieces.wgsl", include_str!("../wgsl/shading/pieces.wgsl")),
    ("shading/pose.wgsl", include_str!("../wgsl/shading/pose.wgsl")),
    ("shading/predict.wgsl", include_str!("../wgsl/shading/predict.wgsl")),
    ("shading/present.wgsl", include_str!("../wgsl/shading/present.wgsl")),
    ("shading/put_off.wgsl", include_str!("../wgsl/shading/put_off.wgsl")),
    ("shading/same_surface.wgsl", include_str!("../wgsl/shading/same_surface.wgsl")),
    ("shading/shade.wgsl", include_str!("../wgsl/shading/shade.wgsl")),
    ("shading/shadow_map.wgsl", include_str!("../wgsl/shading/shadow_map.wgsl")),
    ("shading/surface.wgsl", include_str!("../wgsl/shading/surface.wgsl")),
    ("shading/tone.wgsl", include_str!("../wgsl/shading/tone.wgsl")),
    ("shading/view.wgsl", include_str!("../wgsl/shading/view.wgsl")),
    ("shared/mask.wgsl", include_str!("../wgsl/shared/mask.wgsl")),
    ("shared/texels.wgsl", include_str!("../wgsl/shared/texels.wgsl")),
];

/// Those of the server alone. A page fetches less without them.
#[cfg(not(target_family = "wasm"))]
const TRACING: Files = &[
    ("shared/alpha.wgsl", include_str!("../wgsl/shared/alpha.wgsl")),
    ("shared/cwbvh.wgsl", include_str!("../wgsl/shared/cwbvh.wgsl")),
    ("shared/double.wgsl", include_str!("../wgsl/shared/double.wgsl")),
    ("shared/ray.wgsl", include_str!("../wgsl/shared/ray.wgsl")),
    ("shared/traced_scene.wgsl", include_str!("../wgsl/shared/traced_scene.wgsl")),
    ("visibility/block_walk.wgsl", include_str!("../wgsl/visibility/block_walk.wgsl")),
    ("visibility/candidates.wgsl", include_str!("../wgsl/visibility/candidates.wgsl")),
    ("visibility/closest_hit.wgsl", include_str!("../wgsl/visibility/closest_hit.wgsl")),
    ("visibility/counts.wgsl", include_str!("../wgsl/visibility/counts.wgsl")),
    ("visibility/frustum.wgsl", include_str!("../wgsl/visibility/frustum.wgsl")),
    ("visibility/lanes_subgroup.wgsl", include_str!("../wgsl/visibility/lanes_subgroup.wgsl")),
    ("visibility/lanes_workgroup.wgsl", include_str!("../wgsl/visibility/lanes_workgroup.wgsl")),
    ("visibility/lists.wgsl", include_str!("../wgsl/visibility/lists.wgsl")),
    ("visibility/pose.wgsl", include_str!("../wgsl/visibility/pose.wgsl")),
    ("visibility/pose_math.wgsl", include_str!("../wgsl/visibility/pose_math.wgsl")),
    ("visibility/pose_nodes.wgsl", include_str!("../wgsl/visibility/pose_nodes.wgsl")),
    ("visibility/pose_shapes.wgsl", include_str!("../wgsl/visibility/pose_shapes.wgsl")),
    ("visibility/pose_triangles.wgsl", include_str!("../wgsl/visibility/pose_triangles.wgsl")),
    ("visibility/pose_vertices.wgsl", include_str!("../wgsl/visibility/pose_vertices.wgsl")),
    ("visibility/primary.wgsl", include_str!("../wgsl/visibility/primary.wgsl")),
    ("visibility/primary_listed.wgsl", include_str!("../wgsl/visibility/primary_listed.wgsl")),
    ("visibility/primary_lists.wgsl", include_str!("../wgsl/visibility/primary_lists.wgsl")),
    ("visibility/primary_queued.wgsl", include_str!("../wgsl/visibility/primary_queued.wgsl")),
    ("visibility/primary_ray.wgsl", include_str!("../wgsl/visibility/primary_ray.wgsl")),
    ("visibility/primary_rest.wgsl", include_str!("../wgsl/visibility/primary_rest.wgsl")),
    ("visibility/primary_seen.wgsl", include_str!("../wgsl/visibility/primary_seen.wgsl")),
    ("visibility/ray_query.wgsl", include_str!("../wgsl/visibility/ray_query.wgsl")),
    ("visibility/shadow.wgsl", include_str!("../wgsl/visibility/shadow.wgsl")),
    ("visibility/shadow_listed.wgsl", include_str!("../wgsl/visibility/shadow_listed.wgsl")),
    ("visibility/shadow_lists.wgsl", include_str!("../wgsl/visibility/shadow_lists.wgsl")),
    ("visibility/shadow_queued.wgsl", include_str!("../wgsl/visibility/shadow_queued.wgsl")),
    ("visibility/shadow_ray.wgsl", include_str!("../wgsl/visibility/shadow_ray.wgsl")),
    ("visibility/shadow_rest.wgsl", include_str!("../wgsl/visibility/shadow_rest.wgsl")),
    ("visibility/shadow_shaft.wgsl", include_str!("../wgsl/visibility/shadow_shaft.wgsl")),
    ("visibility/shaft.wgsl", include_str!("../wgsl/visibility/shaft.wgsl")),
    ("visibility/surface.wgsl", include_str!("../wgsl/visibility/surface.wgsl")),
    ("visibility/traverse.wgsl", include_str!("../wgsl/visibility/traverse.wgsl")),
];
#[cfg(target_family = "wasm")]
const TRACING: Files = &[];

/// Why a shader cannot be spliced.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum SpliceError {
    #[error("no WGSL file {0:?}")]
    Missing(String),
    /// A line starts with `#` but is no import.
    #[error("{file}:{line}: expected #import \"PATH\"")]
    Directive { file: String, line: usize },
}

/// Returns the WGSL file `path` with its imports in place.
///
/// # Errors
/// If a file does not exist or a directive is malformed.
pub fn splice(path: &str) -> Result<String, SpliceError> {
    splice_from(&FILES, &[], path)
}

/// As [`splice`], with uniform buffers declared as `uniforms` says.
///
/// # Errors
/// Those of [`splice`].
pub fn splice_for(uniforms: Uniforms, path: &str) -> Result<String, SpliceError> {
    splice(path).map(|text| uniforms.declare(text))
}

/// As [`splice`], for tracing kernels that traverse the adapter's own acceleration structure.
///
/// # Errors
/// Those of [`splice`].
pub fn splice_ray_query(path: &str) -> Result<String, SpliceError> {
    let text = splice_from(&FILES, &[("visibility/traverse.wgsl", "visibility/ray_query.wgsl")], path)?;
    // Directives come before everything else.
    Ok(format!("enable wgpu_ray_query;\n{text}"))
}

/// As [`splice`], for adapters whose subgroups have 32 lanes.
///
/// # Errors
/// Those of [`splice`].
pub fn splice_subgroups(path: &str) -> Result<String, SpliceError> {
    splice_from(&FILES, &[("visibility/lanes_workgroup.wgsl", "visibility/lanes_subgroup.wgsl")], path)
}

/// Splices `path`. `replaced` has pairs of an import and the import that replaces it.
fn splice_from(files: &[&[(&str, &str)]], replaced: &[(&str, &str)], path: &str) -> Result<String, SpliceError> {
    let (mut text, mut seen) = (String::new(), Vec::new());
    append(files, replaced, path, &mut seen, &mut text)?;
    Ok(text)
}

fn append(
    files: &[&[(&str, &str)]],
    replaced: &[(&str, &str)],
    path: &str,
    seen: &mut Vec<String>,
    text: &mut String,
) -> Result<(), SpliceError> {
    let path = replaced.iter().find(|(name, _)| *name == path).map_or(path, |(_, other)| *other);
    if seen.iter().any(|done| done == path) {
        return Ok(());
    }
    seen.push(path.to_owned());
    let mut all = files.iter().copied().flatten();
    let (_, source) = all.find(|(name, _)| *name == path).ok_or_else(|| SpliceError::Missing(path.to_owned()))?;
    for (index, line) in source.lines().enumerate() {
        if let Some(directive) = line.strip_prefix('#') {
            let import = directive
                .strip_prefix("import \"")
                .and_then(|rest| rest.trim_end().strip_suffix('"'))
                .ok_or_else(|| SpliceError::Directive { file: path.to_owned(), line: index + 1 })?;
            append(files, replaced, import, seen, text)?;
        } else {
            text.push_str(line);
            text.push('\n');
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const TREE: &[(&str, &str)] = &[
        ("a", "#import \"b\"\n#import \"c\"\nA"),
        ("b", "#import \"c\"\nB"),
        ("c", "C"),
        ("d", "D"),
        ("loop", "#import \"loop\"\nL"),
        ("bad", "x\n#include \"c\""),
        ("gone", "#import \"nowhere\""),
    ];

    #[test]
    fn imports_come_once_and_before_the_importer() {
        assert_eq!(splice_from(&[TREE], &[], "a").as_deref(), Ok("C\nB\nA\n"));
        assert_eq!(splice_from(&[TREE], &[], "loop").as_deref(), Ok("L\n"));
    }

    #[test]
    fn a_replacement_takes_the_place_of_the_import() {
        assert_eq!(splice_from(&[TREE], &[("b", "d")], "a").as_deref(), Ok("D\nC\nA\n"));
    }

    #[test]
    fn the_client_needs_nothing_of_the_server() {
        for (path, _) in SHADING {
            splice_from(&[SHADING], &[], path).unwrap();
        }
    }

    #[test]
    fn errors_name_file_and_line() {
        assert_eq!(splice_from(&[TREE], &[], "bad"), Err(SpliceError::Directive { file: "bad".into(), line: 2 }));
        assert_eq!(splice_from(&[TREE], &[], "gone"), Err(SpliceError::Missing("nowhere".into())));
    }
}
