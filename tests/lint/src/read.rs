//! Reads a crate's files.

use std::{fs, io, path::Path};

use crate::{modules::Crate, uses::read_uses};

/// Reads the crate that starts with the file `root`.
pub(crate) fn read_crate(root: &Path) -> io::Result<Crate> {
    let mut read = Crate::default();
    read_file(&mut read, root, root.parent().unwrap_or(root), None)?;
    Ok(read)
}

/// Reads a module's file, whose children lie in `folder`. Returns the module.
fn read_file(read: &mut Crate, path: &Path, folder: &Path, parent: Option<usize>) -> io::Result<usize> {
    let text = fs::read_to_string(path)?;
    let syntax = syn::parse_file(&text).map_err(|error| io::Error::other(format!("{}: {error}", path.display())))?;
    read.files.push(path.to_owned());
    let module = read.add_module(read.files.len() - 1, parent);
    for (parent, names) in read_uses(read, module, &syntax) {
        let (name, inline) = names.split_last().map_or(("", &[][..]), |(name, inline)| (name.as_str(), inline));
        let folder = inline.iter().fold(folder.to_owned(), |folder, name| folder.join(name));
        let below = folder.join(name);
        let beside = folder.join(format!("{name}.rs"));
        let file = if beside.is_file() { beside } else { below.join("mod.rs") };
        let child = read_file(read, &file, &below, Some(parent))?;
        read.modules[parent].children.insert(name.to_owned(), child);
    }
    Ok(module)
}
