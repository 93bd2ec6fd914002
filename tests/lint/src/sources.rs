//! Finds the source files, and those that are too long.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

const MOST_LINES: usize = 500;
const MOST_CHARACTERS: usize = 120;
/// Folders without sources of ours.
const SKIPPED: [&str; 5] = ["target", "scenes", "shared", "corpus", "node_modules"];

#[derive(Debug, Default)]
pub struct Sources {
    /// Rust, WGSL and Markdown.
    pub files: Vec<PathBuf>,
    /// The first file of each crate: libraries, programs, tests and benchmarks.
    pub roots: Vec<PathBuf>,
}

impl Sources {
    pub fn find(folder: &Path) -> io::Result<Self> {
        let mut sources = Self::default();
        sources.walk(folder)?;
        sources.files.sort();
        sources.roots.sort();
        Ok(sources)
    }

    fn walk(&mut self, folder: &Path) -> io::Result<()> {
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if path.is_dir() {
                if !name.starts_with('.') && !SKIPPED.contains(&&*name) {
                    self.walk(&path)?;
                }
            } else if has_extension(&path, &["rs", "wgsl", "md"]) {
                if is_root(&path) {
                    self.roots.push(path.clone());
                }
                self.files.push(path);
            }
        }
        Ok(())
    }
}

/// Returns whether cargo starts a crate with this file.
fn is_root(file: &Path) -> bool {
    let folder = file.parent().unwrap_or(file);
    let beside_manifest = |folder: &Path| folder.parent().is_some_and(|above| above.join("Cargo.toml").is_file());
    let of_its_own = |folder: &Path| has_name(folder, &["tests", "benches", "examples", "bin"]);
    has_extension(file, &["rs"])
        && match file.file_name().and_then(|name| name.to_str()) {
            Some("lib.rs") => beside_manifest(folder),
            Some("main.rs") => beside_manifest(folder) || folder.parent().is_some_and(of_its_own),
            _ => of_its_own(folder) && (beside_manifest(folder) || has_name(folder, &["bin"])),
        }
}

fn has_name(path: &Path, names: &[&str]) -> bool {
    path.file_name().is_some_and(|name| names.iter().any(|one| name == *one))
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().is_some_and(|extension| extensions.iter().any(|one| extension == *one))
}

/// Returns a line for each Rust file of more than 500 lines and each line of more than 120 characters. A line that
/// cannot be broken may be longer: a row of a Markdown table, an address, a line of a listing.
pub fn too_long(files: &[PathBuf]) -> io::Result<Vec<String>> {
    let mut found = Vec::new();
    for file in files {
        let text = fs::read_to_string(file)?;
        let rust = has_extension(file, &["rs"]);
        let lines = text.lines().count();
        if rust && lines > MOST_LINES {
            found.push(format!("{}: {lines} lines", file.display()));
        }
        let mut listing = false;
        for (index, line) in text.lines().enumerate() {
            listing ^= line.trim_start().starts_with("```");
            let unbroken =
                line.contains("://") || has_extension(file, &["md"]) && (listing || line.starts_with(['|', '!']));
            let characters = line.chars().count();
            if characters > MOST_CHARACTERS && !unbroken {
                found.push(format!("{}:{}: {characters} characters", file.display(), index + 1));
            }
        }
    }
    Ok(found)
}
