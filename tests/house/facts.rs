//! What one walk through a file finds: names it brings in, paths it follows, functions with their
//! lengths, and places where it may panic. Macro bodies are read as tokens.

use std::collections::{BTreeMap, BTreeSet};

use proc_macro2::{Span, TokenStream, TokenTree};
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{Attribute, Item, UseTree};

use super::source::{Source, is_test};

pub type Path = Vec<String>;

/// A path as written, in the module where it stands.
pub struct Reference {
    pub module: Path,
    pub segments: Path,
    pub line: usize,
    pub in_test: bool,
}

pub struct Function {
    pub name: String,
    pub line: usize,
    pub lines: usize,
}

pub struct Panic {
    pub line: usize,
    pub what: String,
}

#[derive(Default)]
pub struct Facts {
    pub file: String,
    pub module: Path,
    /// Every module of the file, inline ones included.
    pub modules: Vec<Path>,
    pub references: Vec<Reference>,
    /// (module, name) → path as written in that module.
    pub names: BTreeMap<(Path, String), Path>,
    /// (module, name) of every item.
    pub items: BTreeSet<(Path, String)>,
    /// `use x::*` in a module.
    pub globs: Vec<(Path, Path)>,
    pub functions: Vec<Function>,
    pub panics: Vec<Panic>,
    /// Lines of the file without its tests.
    pub lines: usize,
    tests: usize,
    test_lines: usize,
}

pub fn gather(source: &Source) -> Facts {
    let mut facts = Facts {
        file: source.file.clone(),
        module: source.module.clone(),
        modules: vec![source.module.clone()],
        tests: usize::from(source.test_only),
        ..Facts::default()
    };
    facts.visit_file(&source.syntax);
    let lines = source.text.lines().count();
    facts.lines = if source.test_only { 0 } else { lines - facts.test_lines };
    // The walk has left every inline module again.
    assert_eq!(facts.module, source.module);
    facts
}

const PANICKING_METHODS: [&str; 4] = ["unwrap", "expect", "unwrap_err", "expect_err"];
const PANICKING_MACROS: [&str; 4] = ["panic", "todo", "unimplemented", "unreachable"];

impl Facts {
    fn refer(&mut self, segments: Path, span: Span) {
        // `pub(crate)`, `use super::*`: names a place, brings in nothing of another room.
        if let [only] = segments.as_slice()
            && ["crate", "super", "self"].contains(&only.as_str())
        {
            return;
        }
        self.references.push(Reference {
            module: self.module.clone(),
            segments,
            line: span.start().line,
            in_test: self.tests > 0,
        });
    }

    fn panic(&mut self, span: Span, what: String) {
        if self.tests == 0 {
            self.panics.push(Panic { line: span.start().line, what });
        }
    }

    fn function(&mut self, signature: &syn::Signature, end: Span) {
        if self.tests == 0 {
            let line = signature.span().start().line;
            let lines = end.end().line + 1 - line;
            self.functions.push(Function { name: signature.ident.to_string(), line, lines });
        }
    }

    /// Walk something that may be a test; its lines then do not count.
    fn guarded(&mut self, attributes: &[Attribute], span: Span, walk: impl FnOnce(&mut Self)) {
        let test = is_test(attributes);
        if test && self.tests == 0 {
            self.test_lines += span.end().line + 1 - span.start().line;
        }
        self.tests += usize::from(test);
        walk(self);
        self.tests -= usize::from(test);
    }

    fn bring_in(&mut self, tree: &UseTree, prefix: &Path) {
        let with = |ident: &syn::Ident| [prefix.clone(), vec![ident.to_string()]].concat();
        match tree {
            UseTree::Path(path) => self.bring_in(&path.tree, &with(&path.ident)),
            UseTree::Name(name) => self.named(&name.ident, &name.ident, prefix),
            UseTree::Rename(rename) => self.named(&rename.ident, &rename.rename, prefix),
            UseTree::Glob(glob) => {
                self.refer(prefix.clone(), glob.span());
                self.globs.push((self.module.clone(), prefix.clone()));
            }
            UseTree::Group(group) => {
                group.items.iter().for_each(|tree| self.bring_in(tree, prefix));
            }
        }
    }

    /// `use prefix::ident as name`; `{self}` stands for the prefix itself.
    fn named(&mut self, ident: &syn::Ident, name: &syn::Ident, prefix: &Path) {
        let own = ident == "self" && !prefix.is_empty();
        let tail = if own { vec![] } else { vec![ident.to_string()] };
        let target = [prefix.clone(), tail].concat();
        let name = match (own && name == "self", prefix.last()) {
            (true, Some(last)) => last.clone(),
            _ => name.to_string(),
        };
        self.refer(target.clone(), ident.span());
        self.names.insert((self.module.clone(), name), target);
    }

    /// Paths and panics in a macro's body.
    fn tokens(&mut self, tokens: TokenStream) {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        let mut at = 0;
        while let Some(token) = tokens.get(at) {
            at += 1;
            match token {
                TokenTree::Group(group) => self.tokens(group.stream()),
                TokenTree::Ident(first) => {
                    let mut path = vec![first.to_string()];
                    while let Some(TokenTree::Ident(next)) = tokens.get(at + 2)
                        && is_punct(tokens.get(at), ':')
                        && is_punct(tokens.get(at + 1), ':')
                    {
                        path.push(next.to_string());
                        at += 3;
                    }
                    self.token_path(path, first.span(), &tokens, at);
                }
                _ => {}
            }
        }
    }

    fn token_path(&mut self, path: Path, span: Span, tokens: &[TokenTree], next: usize) {
        let last = path.last().unwrap().as_str();
        let after_dot = next >= 2 && is_punct(tokens.get(next - 2), '.');
        if PANICKING_METHODS.contains(&last) && (after_dot || path.len() > 1) {
            self.panic(span, format!("{last}()"));
        } else if PANICKING_MACROS.contains(&last) && is_punct(tokens.get(next), '!') {
            self.panic(span, format!("{last}!"));
        }
        if path.len() > 1 {
            self.refer(path, span);
        }
    }
}

fn is_punct(token: Option<&TokenTree>, sign: char) -> bool {
    matches!(token, Some(TokenTree::Punct(punct)) if punct.as_char() == sign)
}

impl<'ast> Visit<'ast> for Facts {
    fn visit_item(&mut self, item: &'ast Item) {
        if let Some(name) = name(item) {
            self.items.insert((self.module.clone(), name));
        }
        self.guarded(attributes(item), item.span(), |facts| visit::visit_item(facts, item));
    }

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        self.module.push(item.ident.to_string());
        self.modules.push(self.module.clone());
        visit::visit_item_mod(self, item);
        self.module.pop();
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        self.bring_in(&item.tree, &Vec::new());
    }

    fn visit_item_fn(&mut self, item: &'ast syn::ItemFn) {
        self.function(&item.sig, item.block.span());
        visit::visit_item_fn(self, item);
    }

    fn visit_impl_item_fn(&mut self, item: &'ast syn::ImplItemFn) {
        self.guarded(&item.attrs, item.span(), |facts| {
            facts.function(&item.sig, item.block.span());
            visit::visit_impl_item_fn(facts, item);
        });
    }

    fn visit_trait_item_fn(&mut self, item: &'ast syn::TraitItemFn) {
        if let Some(block) = &item.default {
            self.function(&item.sig, block.span());
        }
        visit::visit_trait_item_fn(self, item);
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let segments: Path = path.segments.iter().map(|part| part.ident.to_string()).collect();
        if let [_, .., last] = segments.as_slice()
            && PANICKING_METHODS.contains(&last.as_str())
        {
            self.panic(path.span(), format!("{last}()"));
        }
        self.refer(segments, path.span());
        visit::visit_path(self, path);
    }

    fn visit_expr_method_call(&mut self, call: &'ast syn::ExprMethodCall) {
        let method = call.method.to_string();
        if PANICKING_METHODS.contains(&method.as_str()) {
            self.panic(call.method.span(), format!("{method}()"));
        }
        visit::visit_expr_method_call(self, call);
    }

    fn visit_macro(&mut self, item: &'ast syn::Macro) {
        if let Some(last) = item.path.segments.last()
            && PANICKING_MACROS.iter().any(|name| last.ident == name)
        {
            self.panic(item.span(), format!("{}!", last.ident));
        }
        self.tokens(item.tokens.clone());
        visit::visit_macro(self, item);
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

fn name(item: &Item) -> Option<String> {
    let ident = match item {
        Item::Const(item) => &item.ident,
        Item::Enum(item) => &item.ident,
        Item::Fn(item) => &item.sig.ident,
        Item::Static(item) => &item.ident,
        Item::Struct(item) => &item.ident,
        Item::Trait(item) => &item.ident,
        Item::Type(item) => &item.ident,
        _ => return None,
    };
    Some(ident.to_string())
}
