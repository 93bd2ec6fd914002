//! Gnomon's own scene, modelled in code: the courtyard of a cloister with its arcades, and camera paths through it.
//!
//! [`generate`] writes the same bytes on every run. Each file here models one thing; `layout` says where things stand.

use std::path::{Path, PathBuf};

mod arcade;
mod armillary;
mod fountain;
mod furnishing;
pub(crate) mod glb;
mod hangings;
mod house;
mod lantern;
mod layout;
mod lights;
mod materials;
pub(crate) mod mesh;
mod moving;
mod paths;
mod paving;
mod plants;
pub(crate) mod rng;
mod roof;
mod shapes;
mod sundial;
mod sweep;
mod textures;
mod tree;
mod vault;
mod walls;
mod well;

pub use glb::GlbError;

pub const SCENE_FILE: &str = "cloister.glb";
pub const PATHS_FILE: &str = "cloister.json";

/// Returns the path of `tests/assets/NAME`.
pub fn asset(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets").join(name)
}

/// Returns a report's options for the cloister along its walk.
pub fn options() -> String {
    format!("--scene {} --path {}#walk", asset(SCENE_FILE).display(), asset(PATHS_FILE).display())
}

#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    #[error("a picture of the cloister cannot be encoded: {0}")]
    Picture(#[from] image::ImageError),
    #[error(transparent)]
    Glb(#[from] GlbError),
    #[error("cannot write {}: {source}", path.display())]
    Write { path: PathBuf, source: std::io::Error },
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Report {
    pub bytes: usize,
    /// Part of `bytes`.
    pub picture_bytes: usize,
    pub meshes: usize,
    pub instances: usize,
    pub stored_triangles: usize,
    /// Counts every instance's triangles.
    pub triangles: usize,
}

/// Writes `cloister.glb` and `cloister.json` into the folder `out`.
pub fn generate(out: &Path) -> Result<Report, GenerateError> {
    let (scene, report) = scene()?;
    let mut paths = serde_json::to_vec_pretty(&paths::document()).map_err(GlbError::from)?;
    paths.push(b'\n');
    for (name, bytes) in [(SCENE_FILE, scene), (PATHS_FILE, paths)] {
        let path = out.join(name);
        std::fs::write(&path, bytes).map_err(|source| GenerateError::Write { path, source })?;
    }
    Ok(report)
}

fn scene() -> Result<(Vec<u8>, Report), GenerateError> {
    let mut glb = glb::Glb::default();
    let palette = materials::add(&mut glb)?;
    let picture_bytes = glb.binary_bytes();
    // Objects are drawn, and lights get the mask's planes, in this order: the sun first.
    lights::add_sun(&mut glb);
    let sides = house::sides(&mut glb);
    house::add(&mut glb, &palette, sides);
    furnishing::add(&mut glb, &palette, sides);
    moving::add(&mut glb, &palette);
    lights::add_lamps(&mut glb, &palette, sides);
    let counts = glb.counts();
    let bytes = glb.finish(concat!("Gnomon make-scene ", env!("CARGO_PKG_VERSION")))?;
    let report = Report {
        bytes: bytes.len(),
        picture_bytes,
        meshes: counts.meshes,
        instances: counts.instances,
        stored_triangles: counts.stored_triangles,
        triangles: counts.triangles,
    };
    Ok((bytes, report))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn committed(name: &str) -> Vec<u8> {
        let path = asset(name);
        std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    }

    #[test]
    fn the_committed_files_are_what_the_generator_writes() {
        let out = tempfile::tempdir().unwrap();
        let report = generate(out.path()).unwrap();
        for name in [SCENE_FILE, PATHS_FILE] {
            let made = std::fs::read(out.path().join(name)).unwrap();
            let same = made == committed(name);
            assert!(same, "{name} is not what the generator writes: run `lab make-scene` and commit it");
        }
        assert!(report.bytes <= 4 << 20, "{} bytes", report.bytes);
        assert!(report.triangles <= 250_000, "{} triangles are too many for software Vulkan", report.triangles);
        assert!(report.stored_triangles * 3 < report.triangles, "instances do not pay: {report:?}");
    }
}
