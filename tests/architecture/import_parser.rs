//! The names that a file imports and the paths that it uses. Macro bodies are read as tokens.

use std::collections::{BTreeMap, BTreeSet};

use proc_macro2::{Span, TokenStream, TokenTree};
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{Attribute, Item, UseTree, Visibility};

use super::parsed_sources::{SourceFile, is_test_only};

pub type PathSegments = Vec<String>;

/// A path as written, in the module where it is used.
pub struct Reference {
    pub using_module: PathSegments,
    pub segments: PathSegments,
    pub line: usize,
    /// `pub use`: the module publishes the name and does not depend on it.
    pub is_reexport: bool,
}

/// Everything of one file that [`super::path_resolver::Resolver`] needs; test code is left out.
#[derive(Default)]
pub struct FileImports {
    pub file: String,
    pub module_path: PathSegments,
    /// Every module of the file, inline modules included.
    pub module_paths: Vec<PathSegments>,
    pub references: Vec<Reference>,
    /// (module, name) → path as written in that module.
    pub imported_names: BTreeMap<(PathSegments, String), PathSegments>,
    /// (module, name) of every item.
    pub defined_items: BTreeSet<(PathSegments, String)>,
    /// `use x::*` in a module.
    pub glob_imports: Vec<(PathSegments, PathSegments)>,
    is_in_reexport: bool,
}

pub fn imports_of_file(source: &SourceFile) -> FileImports {
    let mut imports = FileImports {
        file: source.file.clone(),
        module_path: source.module.clone(),
        module_paths: vec![source.module.clone()],
        ..FileImports::default()
    };
    imports.visit_file(&source.syntax);
    imports
}

impl FileImports {
    fn add_reference(&mut self, segments: PathSegments, span: Span) {
        // `pub(crate)` and `use super::*` name a module and import nothing.
        if let [only] = segments.as_slice()
            && ["crate", "super", "self"].contains(&only.as_str())
        {
            return;
        }
        self.references.push(Reference {
            using_module: self.module_path.clone(),
            segments,
            line: span.start().line,
            is_reexport: self.is_in_reexport,
        });
    }

    fn add_use_tree(&mut self, tree: &UseTree, prefix: &PathSegments) {
        let with = |ident: &syn::Ident| [prefix.clone(), vec![ident.to_string()]].concat();
        match tree {
            UseTree::Path(path) => self.add_use_tree(&path.tree, &with(&path.ident)),
            UseTree::Name(name) => self.add_imported_name(&name.ident, &name.ident, prefix),
            UseTree::Rename(rename) => self.add_imported_name(&rename.ident, &rename.rename, prefix),
            UseTree::Glob(glob) => {
                self.add_reference(prefix.clone(), glob.span());
                self.glob_imports.push((self.module_path.clone(), prefix.clone()));
            }
            UseTree::Group(group) => {
                group.items.iter().for_each(|tree| self.add_use_tree(tree, prefix));
            }
        }
    }

    /// `use prefix::ident as name`; in `use prefix::{self}` the name is the prefix's last segment.
    fn add_imported_name(&mut self, ident: &syn::Ident, name: &syn::Ident, prefix: &PathSegments) {
        let is_self = ident == "self" && !prefix.is_empty();
        let tail = if is_self { vec![] } else { vec![ident.to_string()] };
        let target = [prefix.clone(), tail].concat();
        let name = match (is_self && name == "self", prefix.last()) {
            (true, Some(last)) => last.clone(),
            _ => name.to_string(),
        };
        self.add_reference(target.clone(), ident.span());
        self.imported_names.insert((self.module_path.clone(), name), target);
    }

    fn add_macro_tokens(&mut self, tokens: TokenStream) {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        let mut at = 0;
        while let Some(token) = tokens.get(at) {
            at += 1;
            match token {
                TokenTree::Group(group) => self.add_macro_tokens(group.stream()),
                TokenTree::Ident(first) => {
                    let mut path = vec![first.to_string()];
                    while let Some(TokenTree::Ident(next)) = tokens.get(at + 2)
                        && is_colon(tokens.get(at))
                        && is_colon(tokens.get(at + 1))
                    {
                        path.push(next.to_string());
                        at += 3;
                    }
                    if path.len() > 1 {
                        self.add_reference(path, first.span());
                    }
                }
                _ => {}
            }
        }
    }
}

fn is_colon(token: Option<&TokenTree>) -> bool {
    matches!(token, Some(TokenTree::Punct(punct)) if punct.as_char() == ':')
}

impl<'ast> Visit<'ast> for FileImports {
    fn visit_item(&mut self, item: &'ast Item) {
        let (name, attributes) = name_and_attributes(item);
        if is_test_only(attributes) {
            return;
        }
        if let Some(name) = name {
            self.defined_items.insert((self.module_path.clone(), name.to_string()));
        }
        visit::visit_item(self, item);
    }

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        if item.content.is_none() {
            return;
        }
        self.module_path.push(item.ident.to_string());
        self.module_paths.push(self.module_path.clone());
        visit::visit_item_mod(self, item);
        self.module_path.pop();
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        self.is_in_reexport = !matches!(item.vis, Visibility::Inherited);
        self.add_use_tree(&item.tree, &Vec::new());
        self.is_in_reexport = false;
    }

    fn visit_impl_item_fn(&mut self, item: &'ast syn::ImplItemFn) {
        if !is_test_only(&item.attrs) {
            visit::visit_impl_item_fn(self, item);
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let segments: PathSegments = path.segments.iter().map(|part| part.ident.to_string()).collect();
        self.add_reference(segments, path.span());
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, item: &'ast syn::Macro) {
        self.add_macro_tokens(item.tokens.clone());
        visit::visit_macro(self, item);
    }
}

fn name_and_attributes(item: &Item) -> (Option<&syn::Ident>, &[Attribute]) {
    match item {
        Item::Const(item) => (Some(&item.ident), &item.attrs),
        Item::Enum(item) => (Some(&item.ident), &item.attrs),
        Item::Fn(item) => (Some(&item.sig.ident), &item.attrs),
        Item::Static(item) => (Some(&item.ident), &item.attrs),
        Item::Struct(item) => (Some(&item.ident), &item.attrs),
        Item::Trait(item) => (Some(&item.ident), &item.attrs),
        Item::Type(item) => (Some(&item.ident), &item.attrs),
        Item::Impl(item) => (None, &item.attrs),
        Item::Macro(item) => (None, &item.attrs),
        Item::Mod(item) => (None, &item.attrs),
        Item::Use(item) => (None, &item.attrs),
        _ => (None, &[]),
    }
}
