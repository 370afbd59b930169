//! Resolves a path as written to the module that defines the item: `crate`, `self`, `super`, imported names and
//! re-exports are followed.

use std::collections::{BTreeMap, BTreeSet};

use super::imports::{Imports, Path};

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Target {
    /// A module of the crate.
    Module(Path),
    /// A path into another crate, as far as written.
    Outside(Path),
}

/// Longest chain of names that is followed; only a circle of names is longer.
const MAX_CHAIN: usize = 24;

pub struct Resolver {
    modules: BTreeSet<Path>,
    names: BTreeMap<(Path, String), Path>,
    items: BTreeSet<(Path, String)>,
    globs: Vec<(Path, Path)>,
}

impl Resolver {
    pub fn new(files: &[Imports]) -> Self {
        Self {
            modules: files.iter().flat_map(|file| file.modules.clone()).collect(),
            names: files.iter().flat_map(|file| file.names.clone()).collect(),
            items: files.iter().flat_map(|file| file.items.clone()).collect(),
            globs: files.iter().flat_map(|file| file.globs.clone()).collect(),
        }
    }

    /// Target of the path `segments`, written in `module`; `None` for a local name.
    pub fn target(&self, module: &Path, segments: &Path) -> Option<Target> {
        let mut targets = Vec::new();
        self.follow(module, segments, MAX_CHAIN, &mut targets);
        targets.pop()
    }

    fn follow(&self, module: &Path, segments: &[String], depth: usize, found: &mut Vec<Target>) {
        let Some(first) = segments.first().filter(|_| depth > 0) else { return };
        let mut at: Path = match first.as_str() {
            "crate" => Vec::new(),
            "self" => module.clone(),
            "super" => parent(module),
            "Self" => return,
            _ => match self.name(module, first, depth) {
                Some((home, path)) if path != [first.clone()] => {
                    return self.follow(&home, &joined(&path, &segments[1..]), depth - 1, found);
                }
                _ if self.modules.contains(&joined(module, &segments[..1])) => joined(module, &segments[..1]),
                _ => return found.push(Target::Outside(segments.to_vec())),
            },
        };
        for (index, segment) in segments.iter().enumerate().skip(1) {
            let inner = joined(&at, std::slice::from_ref(segment));
            if segment == "super" {
                at = parent(&at);
            } else if self.modules.contains(&inner) {
                at = inner;
            } else if let Some((home, path)) = self.name(&at, segment, depth) {
                found.push(Target::Module(at));
                let rest = joined(&path, &segments[index + 1..]);
                return self.follow(&home, &rest, depth - 1, found);
            } else {
                break;
            }
        }
        found.push(Target::Module(at));
    }

    /// The path to which `name` refers in `module`, and the module in which that path is written.
    fn name(&self, module: &Path, name: &str, depth: usize) -> Option<(Path, Path)> {
        let depth = depth.checked_sub(1)?;
        if let Some(path) = self.names.get(&(module.clone(), name.to_owned())) {
            return Some((module.clone(), path.clone()));
        }
        self.globs.iter().filter(|(home, _)| home == module).find_map(|(_, glob)| {
            let mut targets = Vec::new();
            self.follow(module, glob, depth, &mut targets);
            let Some(Target::Module(source)) = targets.pop() else { return None };
            let inner = joined(&source, &[name.to_owned()]);
            if self.modules.contains(&inner) || self.items.contains(&(source.clone(), name.to_owned())) {
                return Some((Vec::new(), joined(&["crate".to_owned()], &inner)));
            }
            (source != *module).then(|| self.name(&source, name, depth)).flatten()
        })
    }
}

fn joined(head: &[String], tail: &[String]) -> Path {
    [head, tail].concat()
}

fn parent(module: &[String]) -> Path {
    module.split_last().map(|(_, rest)| rest.to_vec()).unwrap_or_default()
}
