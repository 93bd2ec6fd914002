//! Collects the names that a file defines, imports and uses.

use proc_macro2::{TokenStream, TokenTree};
use syn::{
    Attribute, File, ImplItem, Item, ItemMod, ItemUse, Macro, MetaList, UseTree, Visibility,
    visit::{self, Visit},
};

use crate::modules::{Crate, Import, Names};

/// Fills `module` with what `file` defines, imports and uses, and adds its inline modules. Returns each `mod child;`:
/// the module that declares it, and the path to it from the file's own module.
pub(crate) fn read_uses(read: &mut Crate, module: usize, file: &File) -> Vec<(usize, Names)> {
    let mut collector = Collector { read, module, inline: Vec::new(), declared: Vec::new() };
    collector.visit_file(file);
    collector.declared
}

struct Collector<'a> {
    read: &'a mut Crate,
    module: usize,
    /// The inline modules around the visited item.
    inline: Names,
    declared: Vec<(usize, Names)>,
}

impl Collector<'_> {
    fn define(&mut self, item: &Item) {
        let name = match item {
            Item::Const(item) => &item.ident,
            Item::Enum(item) => &item.ident,
            Item::Fn(item) => &item.sig.ident,
            Item::Static(item) => &item.ident,
            Item::Struct(item) => &item.ident,
            Item::Trait(item) => &item.ident,
            Item::Type(item) => &item.ident,
            Item::Union(item) => &item.ident,
            Item::Macro(item) => {
                let Some(name) = &item.ident else { return };
                if item.attrs.iter().any(|attribute| attribute.path().is_ident("macro_export")) {
                    self.read.exported_macros.insert(name.to_string(), self.module);
                }
                name
            }
            _ => return,
        };
        let name = name.to_string();
        self.read.modules[self.module].items.insert(name);
    }

    fn import(&mut self, tree: &UseTree, mut path: Names, reexport: bool) {
        let (name, glob) = match tree {
            UseTree::Path(tree) => {
                path.push(tree.ident.to_string());
                return self.import(&tree.tree, path, reexport);
            }
            UseTree::Group(tree) => {
                return tree.items.iter().for_each(|tree| self.import(tree, path.clone(), reexport));
            }
            UseTree::Name(tree) => {
                path.extend(Some(tree.ident.to_string()).filter(|name| name != "self"));
                (path.last().cloned(), false)
            }
            UseTree::Rename(tree) => {
                path.extend(Some(tree.ident.to_string()).filter(|name| name != "self"));
                (Some(tree.rename.to_string()).filter(|name| name != "_"), false)
            }
            UseTree::Glob(_) => (None, true),
        };
        self.read.modules[self.module].imports.push(Import { path, name, glob, reexport });
    }

    fn use_path(&mut self, path: Names) {
        if !path.is_empty() {
            self.read.modules[self.module].paths.insert(path);
        }
    }

    /// Collects what looks like a path in the tokens of a macro or an attribute.
    fn use_tokens(&mut self, tokens: TokenStream) {
        let mut path = Names::new();
        let mut before = String::new();
        for token in tokens {
            match token {
                TokenTree::Ident(name) => {
                    if before != "::" {
                        self.use_path(std::mem::take(&mut path));
                    }
                    // A field or a method.
                    if before != "." {
                        path.push(name.to_string());
                    }
                    before.clear();
                }
                TokenTree::Punct(mark) => before.push(mark.as_char()),
                TokenTree::Group(group) => {
                    self.use_tokens(group.stream());
                    before.clear();
                }
                TokenTree::Literal(_) => before.clear(),
            }
        }
        self.use_path(path);
    }
}

impl<'ast> Visit<'ast> for Collector<'_> {
    fn visit_item(&mut self, item: &'ast Item) {
        if !only_in_tests(attributes(item)) {
            self.define(item);
            visit::visit_item(self, item);
        }
    }

    fn visit_impl_item(&mut self, item: &'ast ImplItem) {
        if !matches!(item, ImplItem::Fn(function) if only_in_tests(&function.attrs)) {
            visit::visit_impl_item(self, item);
        }
    }

    fn visit_item_mod(&mut self, item: &'ast ItemMod) {
        let name = item.ident.to_string();
        self.inline.push(name.clone());
        if item.content.is_some() {
            let outer = self.module;
            self.module = self.read.add_module(self.read.modules[outer].file, Some(outer));
            self.read.modules[outer].children.insert(name, self.module);
            visit::visit_item_mod(self, item);
            self.module = outer;
        } else {
            self.declared.push((self.module, self.inline.clone()));
        }
        self.inline.pop();
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        let reexport = !matches!(item.vis, Visibility::Inherited);
        if item.leading_colon.is_none() {
            self.import(&item.tree, Names::new(), reexport);
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        if path.leading_colon.is_none() {
            self.use_path(path.segments.iter().map(|segment| segment.ident.to_string()).collect());
        }
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, used: &'ast Macro) {
        self.visit_path(&used.path);
        self.use_tokens(used.tokens.clone());
    }

    fn visit_meta_list(&mut self, list: &'ast MetaList) {
        self.use_tokens(list.tokens.clone());
    }
}

fn attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Const(item) => &item.attrs,
        Item::Enum(item) => &item.attrs,
        Item::Fn(item) => &item.attrs,
        Item::Impl(item) => &item.attrs,
        Item::Macro(item) => &item.attrs,
        Item::Mod(item) => &item.attrs,
        Item::Static(item) => &item.attrs,
        Item::Struct(item) => &item.attrs,
        Item::Trait(item) => &item.attrs,
        Item::Type(item) => &item.attrs,
        Item::Use(item) => &item.attrs,
        _ => &[],
    }
}

fn only_in_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute.parse_args::<syn::Ident>().is_ok_and(|condition| condition == "test")
    })
}
