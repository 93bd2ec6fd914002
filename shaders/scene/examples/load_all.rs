//! Loads every glTF file below a folder and prints a line for each: whether it loads, what it holds, what was mended.
//!
//! `cargo run -p gnomon-scene --example load_all -- FOLDER [--geometry] [--notes]`. `--geometry` adds a digest of what
//! tracers read: positions, triangles, and texture coordinates where there is a base colour picture.

use std::{
    error::Error,
    path::{Path, PathBuf},
};

use gnomon_scene::{LoadOptions, Scene};

fn files(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            found.extend(files(&path)?);
        } else if path.extension().is_some_and(|extension| extension == "gltf" || extension == "glb") {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// Digest of what tracers read.
fn geometry(scene: &Scene) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    let mut words = |values: &[u32]| {
        values.iter().for_each(|value| {
            hasher.update(&value.to_le_bytes());
        });
    };
    for position in &scene.positions {
        words(&position.to_array().map(f32::to_bits));
    }
    for draw in &scene.draws {
        let first = draw.first_triangle as usize;
        let textured = scene.materials[draw.material as usize].base_color_texture.is_some();
        words(&[draw.first_triangle, draw.triangles, u32::from(textured)]);
        for triangle in &scene.triangles[first..first + draw.triangles as usize] {
            words(triangle);
            for corner in triangle.iter().filter(|_| textured) {
                words(&scene.uvs[*corner as usize].to_array().map(f32::to_bits));
            }
        }
    }
    hasher.finalize()
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("usage: load_all FOLDER [--geometry] [--notes]")?);
    let flags: Vec<String> = arguments.collect();
    let [with_geometry, with_notes] = ["--geometry", "--notes"].map(|flag| flags.iter().any(|given| given == flag));
    let (mut loaded, files) = (0, files(&folder)?);
    for path in &files {
        let name = path.strip_prefix(&folder).unwrap_or(path).display();
        match Scene::load_with_report(path, &LoadOptions::default()) {
            Ok((scene, report)) => {
                loaded += 1;
                let digest = if with_geometry { format!(" {}", geometry(&scene)) } else { String::new() };
                println!("{name}: {} triangles{digest}", scene.triangles.len());
                if with_notes {
                    println!("{report}");
                }
            }
            Err(error) => println!("{name}: REFUSED: {error}"),
        }
    }
    println!("{loaded} of {} load", files.len());
    Ok(())
}
