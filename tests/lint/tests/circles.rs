//! Planted circles are found, and nothing else is.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::fs;

use gnomon_lint::{Sources, circles, too_long};

/// Writes a crate of these files under `src`, and returns its circles.
fn circles_of(files: &[(&str, &str)]) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("Cargo.toml"), "").unwrap();
    for (name, text) in files {
        let path = folder.path().join("src").join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    let sources = Sources::find(folder.path()).unwrap();
    assert_eq!(sources.roots, [folder.path().join("src/lib.rs")]);
    let source = format!("{}/", folder.path().join("src").display());
    circles(&sources.roots[0]).unwrap().iter().map(|circle| circle.replace(&source, "")).collect()
}

#[test]
fn siblings_that_import_each_other() {
    let found = circles_of(&[
        ("lib.rs", "mod a; mod b; mod c;"),
        ("a.rs", "use crate::b::{B, other}; pub struct A(B);"),
        ("b.rs", "pub struct B; pub fn other() -> Option<super::a::A> { None }"),
        ("c.rs", "use crate::{a::A, b::B};"),
    ]);
    assert_eq!(found, ["  a.rs -> b.rs: B, other\n  b.rs -> a.rs: super::a::A\n"]);
}

#[test]
fn a_circle_of_three_through_a_facade_a_glob_and_a_macro() {
    let found = circles_of(&[
        ("lib.rs", "mod a; mod b; mod c; pub use a::A;"),
        ("a.rs", "use crate::b::*; pub struct A(B);"),
        ("b/mod.rs", "mod inner; pub use inner::B;"),
        ("b/inner.rs", "use crate::c; pub struct B; pub fn made() { vec![c::C]; }"),
        ("c.rs", "use crate::A as Renamed; pub struct C(Renamed);"),
    ]);
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(found[0].contains("b/inner.rs -> c.rs: c::C"), "{found:?}");
    assert!(found[0].contains("c.rs -> a.rs: A, Renamed"), "{found:?}");
}

#[test]
fn a_parent_and_a_child_that_use_each_other() {
    let files =
        [("lib.rs", "mod a; pub use a::A; pub struct Top; fn f() { A; }"), ("a.rs", "pub struct A(super::Top);")];
    assert_eq!(circles_of(&files).len(), 1);
}

#[test]
fn declarations_reexports_unit_tests_and_outer_names_are_no_imports() {
    let found = circles_of(&[
        ("lib.rs", "mod a; mod b; pub use a::A; pub use b::{B, self as beta}; pub struct Error;"),
        ("a.rs", "use super::Error; use std::fmt; pub struct A(Error); #[cfg(test)] mod tests { use crate::b::B; }"),
        ("b.rs", "use crate::{A, Error}; mod a {} pub struct B(A); impl B { #[cfg(test)] fn f() { crate::b::B } }"),
    ]);
    assert_eq!(found, [""; 0]);
}

#[test]
fn long_lines_are_found_but_for_those_that_cannot_be_broken() {
    let folder = tempfile::tempdir().unwrap();
    let (rust, text) = (folder.path().join("a.rs"), folder.path().join("a.md"));
    let long = "é".repeat(121);
    fs::write(&rust, format!("// {}\n// https://{long}\n// {long}\n{}", "é".repeat(117), "\n".repeat(498))).unwrap();
    fs::write(&text, format!("| {long} |\n```\n{long}\n```\n{long}\n")).unwrap();
    let found = too_long(&[rust.clone(), text.clone()]).unwrap();
    let (rust, text) = (rust.display(), text.display());
    let expected =
        [format!("{rust}: 501 lines"), format!("{rust}:3: 124 characters"), format!("{text}:5: 121 characters")];
    assert_eq!(found, expected);
}
