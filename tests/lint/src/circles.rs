//! Finds files that import each other, directly or through others.
//!
//! An import leads to the file that defines the name, through any re-exports. Declaring a child module and re-exporting
//! a child's item are no imports.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
    io,
    path::Path,
};

use crate::{
    modules::{Crate, Target},
    read::read_crate,
};

/// For each file, the files that it imports from, and the names.
type Graph = BTreeMap<usize, BTreeMap<usize, BTreeSet<String>>>;

/// Returns a description of each import circle of the crate that starts with the file `root`. Errors if a file of the
/// crate cannot be read or parsed.
pub fn circles(root: &Path) -> io::Result<Vec<String>> {
    let read = read_crate(root)?;
    let graph = imports(&read);
    let reached: BTreeMap<usize, BTreeSet<usize>> = graph.keys().map(|file| (*file, reach(&graph, *file))).collect();
    let tied =
        |a: usize, b: usize| reached[&a].contains(&b) && reached.get(&b).is_some_and(|reached| reached.contains(&a));
    let mut found = Vec::new();
    let mut told = BTreeSet::new();
    for file in graph.keys() {
        let circle: Vec<usize> = reached[file].iter().copied().filter(|other| tied(*file, *other)).collect();
        if circle.is_empty() || !told.insert(circle.clone()) {
            continue;
        }
        let mut text = String::new();
        for (from, to) in circle.iter().flat_map(|from| graph[from].keys().map(move |to| (from, to))) {
            if circle.contains(to) {
                let names: Vec<&str> = graph[from][to].iter().map(String::as_str).collect();
                let (from, to) = (read.files[*from].display(), read.files[*to].display());
                let _ = writeln!(text, "  {from} -> {to}: {}", names.join(", "));
            }
        }
        found.push(text);
    }
    Ok(found)
}

fn imports(read: &Crate) -> Graph {
    let mut graph = Graph::new();
    for (index, module) in read.modules.iter().enumerate() {
        let mut add = |name: &str, target: Target| {
            let (Target::Module(target) | Target::Item(target)) = target;
            let file = read.modules[target].file;
            if file != module.file {
                graph.entry(module.file).or_default().entry(file).or_default().insert(name.to_owned());
            }
        };
        for import in &module.imports {
            match read.resolve(index, &import.path) {
                Some(target @ Target::Item(of)) if !(import.reexport && read.is_below(of, index)) => {
                    add(import.path.last().map_or("", String::as_str), target);
                }
                Some(target @ Target::Module(_)) if import.glob && !import.reexport => add("*", target),
                _ => {}
            }
        }
        for path in &module.paths {
            if let Some(target @ Target::Item(_)) = read.resolve(index, path) {
                add(&path.join("::"), target);
            }
        }
    }
    graph
}

/// Returns the files that can be reached from `start`, which is among them only if it lies on a circle.
fn reach(graph: &Graph, start: usize) -> BTreeSet<usize> {
    let mut reached = BTreeSet::new();
    let mut open = vec![start];
    while let Some(file) = open.pop() {
        for next in graph.get(&file).into_iter().flat_map(BTreeMap::keys) {
            if reached.insert(*next) {
                open.push(*next);
            }
        }
    }
    reached
}
