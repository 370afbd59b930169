//! Resolves a path as written to the module that defines the item: `crate`, `self`, `super`, imported names and
//! re-exports are followed.

use std::collections::{BTreeMap, BTreeSet};

use super::import_parser::{FileImports, PathSegments};

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum ResolvedPath {
    /// A module of the crate.
    OwnModule(PathSegments),
    /// A path into another crate, as far as written.
    OtherCrate(PathSegments),
}

/// Longest chain of names that is followed; only a circle of names is longer.
const MAX_NAME_CHAIN_LENGTH: usize = 24;

pub struct Resolver {
    module_paths: BTreeSet<PathSegments>,
    imported_names: BTreeMap<(PathSegments, String), PathSegments>,
    defined_items: BTreeSet<(PathSegments, String)>,
    glob_imports: Vec<(PathSegments, PathSegments)>,
}

impl Resolver {
    pub fn new(files: &[FileImports]) -> Self {
        Self {
            module_paths: files.iter().flat_map(|file| file.module_paths.clone()).collect(),
            imported_names: files.iter().flat_map(|file| file.imported_names.clone()).collect(),
            defined_items: files.iter().flat_map(|file| file.defined_items.clone()).collect(),
            glob_imports: files.iter().flat_map(|file| file.glob_imports.clone()).collect(),
        }
    }

    /// Target of the path `segments`, written in `module`; `None` for a local name.
    pub fn resolve_path(&self, module: &PathSegments, segments: &PathSegments) -> Option<ResolvedPath> {
        let mut targets = Vec::new();
        self.collect_targets(module, segments, MAX_NAME_CHAIN_LENGTH, &mut targets);
        targets.pop()
    }

    /// Adds to `found` the modules that re-export an item of the path, then the defining module or external path.
    fn collect_targets(&self, module: &PathSegments, segments: &[String], depth: usize, found: &mut Vec<ResolvedPath>) {
        let Some(first) = segments.first().filter(|_| depth > 0) else { return };
        let mut at: PathSegments = match first.as_str() {
            "crate" => Vec::new(),
            "self" => module.clone(),
            "super" => parent_module(module),
            "Self" => return,
            _ => match self.resolve_name(module, first, depth) {
                Some((home, path)) if path != [first.clone()] => {
                    return self.collect_targets(&home, &join_paths(&path, &segments[1..]), depth - 1, found);
                }
                _ if self.module_paths.contains(&join_paths(module, &segments[..1])) => {
                    join_paths(module, &segments[..1])
                }
                _ => return found.push(ResolvedPath::OtherCrate(segments.to_vec())),
            },
        };
        for (index, segment) in segments.iter().enumerate().skip(1) {
            let inner = join_paths(&at, std::slice::from_ref(segment));
            if segment == "super" {
                at = parent_module(&at);
            } else if self.module_paths.contains(&inner) {
                at = inner;
            } else if let Some((home, path)) = self.resolve_name(&at, segment, depth) {
                found.push(ResolvedPath::OwnModule(at));
                let rest = join_paths(&path, &segments[index + 1..]);
                return self.collect_targets(&home, &rest, depth - 1, found);
            } else {
                break;
            }
        }
        found.push(ResolvedPath::OwnModule(at));
    }

    /// The path to which `name` refers in `module`, and the module in which that path is written.
    fn resolve_name(&self, module: &PathSegments, name: &str, depth: usize) -> Option<(PathSegments, PathSegments)> {
        let depth = depth.checked_sub(1)?;
        if let Some(path) = self.imported_names.get(&(module.clone(), name.to_owned())) {
            return Some((module.clone(), path.clone()));
        }
        self.glob_imports.iter().filter(|(home, _)| home == module).find_map(|(_, glob)| {
            let mut targets = Vec::new();
            self.collect_targets(module, glob, depth, &mut targets);
            let Some(ResolvedPath::OwnModule(source)) = targets.pop() else { return None };
            let inner = join_paths(&source, &[name.to_owned()]);
            if self.module_paths.contains(&inner) || self.defined_items.contains(&(source.clone(), name.to_owned())) {
                return Some((Vec::new(), join_paths(&["crate".to_owned()], &inner)));
            }
            (source != *module).then(|| self.resolve_name(&source, name, depth)).flatten()
        })
    }
}

fn join_paths(head: &[String], tail: &[String]) -> PathSegments {
    [head, tail].concat()
}

fn parent_module(module: &[String]) -> PathSegments {
    module.split_last().map(|(_, rest)| rest.to_vec()).unwrap_or_default()
}
