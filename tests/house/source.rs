//! The files of `src/`, parsed, with the module each one is.

use std::path::Path;

use syn::{Attribute, Item};

pub struct Source {
    /// From the package's root: `src/record/plan.rs`.
    pub file: String,
    /// `["record", "plan"]`; empty for lib.rs.
    pub module: Vec<String>,
    pub text: String,
    pub syntax: syn::File,
    /// Compiled for tests only (`#[cfg(test)] mod tests;` in a parent).
    pub test_only: bool,
}

pub fn of_crate() -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    rust_files(&root.join("src"), &mut files);
    let texts: Vec<(String, String)> = files
        .into_iter()
        .map(|path| {
            let text = std::fs::read_to_string(&path).unwrap();
            (path.strip_prefix(root).unwrap().to_str().unwrap().to_owned(), text)
        })
        .collect();
    parse(texts.iter().map(|(file, text)| (file.as_str(), text.as_str())))
}

fn rust_files(folder: &Path, files: &mut Vec<std::path::PathBuf>) {
    let mut entries: Vec<_> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            rust_files(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
}

pub fn parse<'a>(texts: impl IntoIterator<Item = (&'a str, &'a str)>) -> Vec<Source> {
    let mut sources: Vec<Source> = texts
        .into_iter()
        .map(|(file, text)| Source {
            file: file.to_owned(),
            module: module_of(file),
            text: text.to_owned(),
            syntax: syn::parse_file(text).unwrap_or_else(|error| panic!("{file}: {error}")),
            test_only: false,
        })
        .collect();
    let tests: Vec<Vec<String>> = sources.iter().flat_map(test_modules).collect();
    for source in &mut sources {
        source.test_only = tests.iter().any(|test| source.module.starts_with(test));
    }
    sources
}

fn module_of(file: &str) -> Vec<String> {
    let path = file.strip_prefix("src/").unwrap().strip_suffix(".rs").unwrap();
    let mut module: Vec<String> = path.split('/').map(str::to_owned).collect();
    if ["mod", "lib"].contains(&module.last().unwrap().as_str()) {
        module.pop();
    }
    module
}

/// `#[cfg(test)] mod x;` of a file.
fn test_modules(source: &Source) -> Vec<Vec<String>> {
    let declared = source.syntax.items.iter().filter_map(|item| match item {
        Item::Mod(module) if module.content.is_none() && is_test(&module.attrs) => {
            Some(module.ident.to_string())
        }
        _ => None,
    });
    declared.map(|name| [source.module.clone(), vec![name]].concat()).collect()
}

/// `#[test]`, `#[cfg(test)]`, `#[cfg(all(test, ..))]`; not `#[cfg(not(test))]`.
pub fn is_test(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("test")
            || attribute.path().is_ident("cfg")
                && attribute.meta.require_list().is_ok_and(|list| {
                    let words = list.tokens.to_string();
                    words.split(|c: char| !c.is_alphanumeric() && c != '_').any(|w| w == "test")
                        && !words.contains("not")
                })
    })
}
