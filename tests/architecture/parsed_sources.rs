//! The source files of one package, parsed, each with its module.

use std::path::{Path, PathBuf};

use syn::{Attribute, Item};

pub struct SourceFile {
    /// Path from the root of the repository: `src/machine/record/plan.rs`.
    pub file: String,
    /// Module path within its package: `["record", "plan"]`; empty for lib.rs.
    pub module: Vec<String>,
    pub syntax: syn::File,
}

/// The packages of the workspace: name and folder; the root package is `trued`.
pub fn workspace_packages() -> Vec<(String, PathBuf)> {
    let folders = std::fs::read_dir(repository_root().join("src")).unwrap().map(|entry| entry.unwrap().path());
    let mut packages: Vec<_> = folders
        .filter(|folder| folder.join("Cargo.toml").is_file())
        .map(|folder| (folder.file_name().unwrap().to_str().unwrap().to_owned(), folder))
        .collect();
    packages.push(("trued".to_owned(), repository_root().join("src")));
    packages.sort();
    packages
}

/// The files of the package in `folder` without those that only tests compile.
pub fn parse_package_sources(folder: &Path) -> Vec<SourceFile> {
    let mut files = Vec::new();
    collect_rust_files(folder, &mut files);
    let texts = files.iter().map(|path| {
        let file = path.strip_prefix(repository_root()).unwrap().to_str().unwrap().to_owned();
        (file, module_path_of_file(path.strip_prefix(folder).unwrap()), std::fs::read_to_string(path).unwrap())
    });
    parse_without_test_modules(texts)
}

pub fn parse_without_test_modules(files: impl IntoIterator<Item = (String, Vec<String>, String)>) -> Vec<SourceFile> {
    let mut sources: Vec<SourceFile> = files
        .into_iter()
        .map(|(file, module, text)| {
            let syntax = syn::parse_file(&text).unwrap_or_else(|error| panic!("{file}: {error}"));
            SourceFile { file, module, syntax }
        })
        .collect();
    let tests: Vec<Vec<String>> = sources.iter().flat_map(test_module_paths).collect();
    sources.retain(|source| !tests.iter().any(|test| source.module.starts_with(test)));
    sources
}

fn repository_root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Folders of other packages are left out.
fn collect_rust_files(folder: &Path, files: &mut Vec<PathBuf>) {
    let mut entries: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() && !path.join("Cargo.toml").is_file() {
            collect_rust_files(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
}

fn module_path_of_file(file: &Path) -> Vec<String> {
    let path = file.with_extension("");
    let mut module: Vec<String> = path.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
    if module.last().is_some_and(|last| ["mod", "lib"].contains(&last.as_str())) {
        module.pop();
    }
    module
}

/// `#[cfg(test)] mod x;` of a file.
fn test_module_paths(source: &SourceFile) -> Vec<Vec<String>> {
    let declared = source.syntax.items.iter().filter_map(|item| match item {
        Item::Mod(module) if module.content.is_none() && is_test_only(&module.attrs) => Some(module.ident.to_string()),
        _ => None,
    });
    declared.map(|name| [source.module.clone(), vec![name]].concat()).collect()
}

/// `#[test]`, `#[cfg(test)]`, `#[cfg(all(test, ..))]`; not `#[cfg(not(test))]`.
pub fn is_test_only(attributes: &[Attribute]) -> bool {
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
