//! The sources of this workspace, checked.

use std::path::Path;

use gnomon_lint::{Sources, circles, too_long};

#[test]
fn no_import_circles() {
    let sources = Sources::find(Path::new("../..")).unwrap();
    assert!(sources.roots.len() > 10, "{:?}", sources.roots);
    let found: Vec<String> = sources.roots.iter().flat_map(|root| circles(root).unwrap()).collect();
    assert!(found.is_empty(), "{} import circles:\n{}", found.len(), found.join("\n"));
}

#[test]
fn no_long_files_and_lines() {
    let found = too_long(&Sources::find(Path::new("../..")).unwrap().files).unwrap();
    assert!(found.is_empty(), "{} too long:\n{}", found.len(), found.join("\n"));
}
