//! A crate's modules: the names that each defines and imports, and the paths that it uses.

use std::{
    collections::{HashMap, HashSet},
    path::PathBuf,
};

pub(crate) type Names = Vec<String>;

/// A `use` of one path.
#[derive(Debug)]
pub(crate) struct Import {
    pub(crate) path: Names,
    /// The bound name; none for `as _` and for `*`.
    pub(crate) name: Option<String>,
    pub(crate) glob: bool,
    pub(crate) reexport: bool,
}

/// A file or an inline module.
#[derive(Debug, Default)]
pub(crate) struct Module {
    /// Index into [`Crate::files`].
    pub(crate) file: usize,
    pub(crate) parent: Option<usize>,
    pub(crate) children: HashMap<String, usize>,
    pub(crate) items: HashSet<String>,
    pub(crate) imports: Vec<Import>,
    /// Paths in code, macros and attributes.
    pub(crate) paths: HashSet<Names>,
}

#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub(crate) enum Target {
    Module(usize),
    Item(usize),
}

/// All modules of a crate but its unit tests; the first is the root.
#[derive(Debug, Default)]
pub(crate) struct Crate {
    pub(crate) files: Vec<PathBuf>,
    pub(crate) modules: Vec<Module>,
    /// Macros marked `#[macro_export]`: named at the root, defined in these modules.
    pub(crate) exported_macros: HashMap<String, usize>,
}

/// Most re-exports followed in a chain.
const DEEPEST: usize = 16;

impl Crate {
    pub(crate) fn add_module(&mut self, file: usize, parent: Option<usize>) -> usize {
        self.modules.push(Module { file, parent, ..Module::default() });
        self.modules.len() - 1
    }

    /// Returns the target of `path` from `module`, or none if it lies outside this crate.
    pub(crate) fn resolve(&self, module: usize, path: &[String]) -> Option<Target> {
        self.resolve_within(module, path, DEEPEST)
    }

    fn resolve_within(&self, module: usize, path: &[String], depth: usize) -> Option<Target> {
        let mut current = module;
        for (index, name) in path.iter().enumerate() {
            current = match name.as_str() {
                "crate" => 0,
                "self" => current,
                "super" => self.modules[current].parent?,
                name => match self.look_up(current, name, index + 1 == path.len(), depth) {
                    Some(Target::Module(module)) => module,
                    Some(item) => return Some(item),
                    // A name of another crate, or one that a macro makes.
                    None if index == 0 => return None,
                    None => return Some(Target::Item(current)),
                },
            };
        }
        Some(Target::Module(current))
    }

    /// Returns what `name` means in `module`. If an item and a module share it, the `last` segment of a path is the
    /// item.
    fn look_up(&self, module: usize, name: &str, last: bool, depth: usize) -> Option<Target> {
        let depth = depth.checked_sub(1)?;
        let looked_in = &self.modules[module];
        let child = looked_in.children.get(name).map(|child| Target::Module(*child));
        let item = looked_in.items.contains(name).then_some(Target::Item(module));
        if let Some(found) = if last { item.or(child) } else { child.or(item) } {
            return Some(found);
        }
        if let Some(module) = self.exported_macros.get(name).filter(|_| module == 0) {
            return Some(Target::Item(*module));
        }
        let named = looked_in.imports.iter().filter(|import| import.name.as_deref() == Some(name));
        let found = named.filter_map(|import| self.resolve_within(module, &import.path, depth)).next();
        found.or_else(|| {
            let globs = looked_in.imports.iter().filter(|import| import.glob);
            globs
                .filter_map(|import| match self.resolve_within(module, &import.path, depth)? {
                    Target::Module(module) => self.look_up(module, name, last, depth),
                    Target::Item(_) => None,
                })
                .next()
        })
    }

    pub(crate) fn is_below(&self, module: usize, above: usize) -> bool {
        let mut parents = std::iter::successors(self.modules[module].parent, |module| self.modules[*module].parent);
        parents.any(|parent| parent == above)
    }
}
