//! Checks of the architecture beyond those of cargo: the layers inside a package, the forbidden dependencies of a
//! package without IO, import circles between files, and the length of a file. Reads `src/` with syn. `cargo test
//! --test architecture -- --nocapture` prints the imports between the modules of `trued`.

mod import_parser;
mod parsed_sources;
mod path_resolver;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::LazyLock;

use import_parser::{FileImports, PathSegments};
use path_resolver::{ResolvedPath, Resolver};

/// Maximum length of a file; the target is half of it.
const MAX_FILE_LINES: usize = 400;

/// Allowed dependencies of each package (table in DESIGN); tests may depend on more. Cargo itself rejects only
/// circles.
const PACKAGE_DEPENDENCIES: [(&str, &[&str]); 7] = [
    ("estimation", &[]),
    ("machine", &[]),
    ("link", &[]),
    ("planning", &["estimation", "machine"]),
    ("methods", &["estimation", "machine", "planning"]),
    ("devices", &["link", "machine", "planning"]),
    ("simulator", &["estimation", "link", "machine"]),
];

/// Random numbers without a seed: `estimation::random::seeded_stream` is the only source.
const UNSEEDED_RANDOM_PATHS: [&str; 5] =
    ["rand::rng", "rand::random", "rand::make_rng", "rand::rngs::ThreadRng", "rand::rngs::SysRng"];

/// Modules of the package `trued`, lowest layer first. A module imports from lower layers only.
const MODULE_LAYERS: [&[&str]; 7] = [
    &["store", "report"],
    &["setup", "archive"],
    &["compensation"],
    &["run"],
    &["service", "commissioning"],
    &["cli"],
    &["main"],
];

/// Each is a package and a module of it whose folders must not import each other: each is one method or one driver.
const PARENTS_OF_SIBLING_FOLDERS: [(&str, &[&str]); 3] =
    [("methods", &[]), ("devices", &["controllers"]), ("devices", &["sensors"])];

/// Folders of `methods` that all methods use. They import no method.
const SHARED_METHOD_FOLDERS: [&str; 3] = ["ball_measurement", "decision", "identification"];

/// Packages that do no IO and read no clock.
const PACKAGES_WITHOUT_IO: [&str; 4] = ["estimation", "machine", "planning", "methods"];
const IO_AND_CLOCK_PATHS: [&str; 9] = [
    "std::fs",
    "std::net",
    "std::process",
    "std::env",
    "std::thread",
    "std::io::stdin",
    "std::time::Instant",
    "std::time::SystemTime",
    "jiff",
];

struct Package {
    name: String,
    files: Vec<FileImports>,
    resolver: Resolver,
}

static PACKAGES: LazyLock<Vec<Package>> = LazyLock::new(|| {
    let of = |(name, folder): (String, PathBuf)| build_package(name, &parsed_sources::parse_package_sources(&folder));
    parsed_sources::workspace_packages().into_iter().map(of).collect()
});

fn build_package(name: String, sources: &[parsed_sources::SourceFile]) -> Package {
    let files: Vec<FileImports> = sources.iter().map(import_parser::imports_of_file).collect();
    let resolver = Resolver::new(&files);
    Package { name, files, resolver }
}

#[test]
fn imports_point_to_lower_layers() {
    let trued = PACKAGES.iter().find(|package| package.name == "trued").unwrap();
    let (imports, breaches) = module_imports_and_layer_breaches(trued);
    for (module, imported) in imports {
        println!("{module:<14} {}", imported.into_iter().collect::<Vec<_>>().join(" "));
    }
    assert!(breaches.is_empty(), "\n{}", breaches.join("\n"));
}

#[test]
fn methods_and_drivers_do_not_import_each_other() {
    let breaches: Vec<String> = PACKAGES.iter().flat_map(sibling_import_breaches).collect();
    assert!(breaches.is_empty(), "\n{}", breaches.join("\n"));
}

#[test]
fn packages_depend_on_lower_packages_only() {
    let of = |(name, folder): (String, PathBuf)| {
        let allowed = PACKAGE_DEPENDENCIES.iter().find(|(package, _)| *package == name)?.1;
        let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).unwrap();
        let manifest: toml::Table = manifest.parse().unwrap();
        let dependencies = manifest["dependencies"].as_table().unwrap().keys();
        let ours = |name: &&String| PACKAGE_DEPENDENCIES.iter().any(|(own, _)| own == *name);
        let refused = dependencies.filter(ours).filter(|name| !allowed.contains(&name.as_str()));
        Some(refused.map(|refused| format!("`{name}` depends on `{refused}`")).collect::<Vec<_>>())
    };
    let checked: Vec<_> = parsed_sources::workspace_packages().into_iter().filter_map(of).collect();
    assert_eq!(checked.len(), PACKAGE_DEPENDENCIES.len(), "a package is missing from the table");
    let breaches = checked.concat();
    assert!(breaches.is_empty(), "\n{}", breaches.join("\n"));
}

#[test]
fn every_random_number_has_a_seed() {
    let uses = |package| uses_of_forbidden_paths(package, &UNSEEDED_RANDOM_PATHS);
    let breaches: Vec<String> = PACKAGES.iter().flat_map(uses).collect();
    assert!(breaches.is_empty(), "\n{}", breaches.join("\n"));
}

#[test]
fn only_planning_and_tests_use_proof_for_tests() {
    let users = PACKAGES.iter().filter(|package| package.name != "planning");
    let breaches: Vec<String> =
        users.flat_map(|package| uses_of_forbidden_paths(package, &["planning::proof::for_tests"])).collect();
    assert!(breaches.is_empty(), "\n{}", breaches.join("\n"));
}

#[test]
fn packages_without_io_use_neither_io_nor_clock() {
    let pure = PACKAGES.iter().filter(|package| PACKAGES_WITHOUT_IO.contains(&package.name.as_str()));
    let breaches: Vec<String> =
        pure.flat_map(|package| uses_of_forbidden_paths(package, &IO_AND_CLOCK_PATHS)).collect();
    assert!(breaches.is_empty(), "\n{}", breaches.join("\n"));
}

#[test]
fn files_have_no_import_circles() {
    let circles: Vec<String> = PACKAGES.iter().flat_map(import_circles).collect();
    assert!(circles.is_empty(), "{} circles\n{}", circles.len(), circles.join("\n"));
}

#[test]
fn files_are_within_the_line_limit() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let files = PACKAGES.iter().flat_map(|package| &package.files);
    let long: Vec<String> = files
        .filter_map(|file| {
            let text = std::fs::read_to_string(root.join(&file.file)).unwrap();
            let tests = text.find("#[cfg(test)]\nmod tests {").unwrap_or(text.len());
            let lines = text[..tests].lines().count();
            (lines > MAX_FILE_LINES).then(|| format!("{}: {lines} lines; split it", file.file))
        })
        .collect();
    assert!(long.is_empty(), "\n{}", long.join("\n"));
}

fn module_imports_and_layer_breaches(package: &Package) -> (BTreeMap<String, BTreeSet<String>>, Vec<String>) {
    let (mut imports, mut breaches) = (BTreeMap::<_, BTreeSet<_>>::new(), Vec::new());
    let layer = |module: &str| MODULE_LAYERS.iter().position(|layer| layer.contains(&module));
    for (file, line, target) in internal_references(package) {
        let (Some(from), Some(to)) = (file.module_path.first(), target.first()) else { continue };
        if from == to {
            continue;
        }
        imports.entry(from.clone()).or_default().insert(to.clone());
        if layer(from).is_none() || layer(to).is_none() || layer(from) <= layer(to) {
            breaches.push(format!("{}:{line}: `{from}` imports `{to}`", file.file));
        }
    }
    (imports, breaches)
}

fn sibling_import_breaches(package: &Package) -> Vec<String> {
    let mut breaches = Vec::new();
    for (_, parent) in PARENTS_OF_SIBLING_FOLDERS.iter().filter(|(name, _)| *name == package.name) {
        let folders = folder_modules_below(package, parent);
        let sibling_of = |module: &PathSegments| {
            let below = module.strip_prefix(owned_path(parent).as_slice())?;
            folders.get(below.first()?)
        };
        for (file, line, target) in internal_references(package) {
            if let (Some(from), Some(to)) = (sibling_of(&file.module_path), sibling_of(&target))
                && from != to
                && !SHARED_METHOD_FOLDERS.contains(&to.as_str())
            {
                breaches.push(format!("{}:{line}: `{from}` imports `{to}`", file.file));
            }
        }
    }
    breaches
}

/// The modules right below `parent` that are folders.
fn folder_modules_below(package: &Package, parent: &[&str]) -> BTreeSet<String> {
    let parent = owned_path(parent);
    let folders = package.files.iter().filter(|file| file.file.ends_with("/mod.rs"));
    let below = folders.filter_map(|file| match file.module_path.strip_prefix(parent.as_slice())? {
        [name] => Some(name.clone()),
        _ => None,
    });
    below.collect()
}

fn owned_path(path: &[&str]) -> PathSegments {
    path.iter().map(|segment| (*segment).to_owned()).collect()
}

/// Where a package uses one of `paths` of other crates.
fn uses_of_forbidden_paths(package: &Package, paths: &[&str]) -> Vec<String> {
    let mut breaches = Vec::new();
    for (file, reference) in all_references(package) {
        let target = package.resolver.resolve_path(&reference.using_module, &reference.segments);
        let Some(ResolvedPath::OtherCrate(path)) = target else { continue };
        let path = path.join("::");
        let inside = |entry: &&&str| path == **entry || path.starts_with(&format!("{entry}::"));
        if let Some(entry) = paths.iter().find(inside) {
            breaches.push(format!("{}:{}: uses `{entry}`", file.file, reference.line));
        }
    }
    breaches
}

/// Groups of files that import each other: strongly connected components of the files' imports. The file of a
/// module and the files below it count as one, because the module lists and joins them.
fn import_circles(package: &Package) -> Vec<String> {
    let file_of: BTreeMap<&PathSegments, &str> = package
        .files
        .iter()
        .flat_map(|file| file.module_paths.iter().map(|module| (module, file.file.as_str())))
        .collect();
    let mut edges: BTreeMap<&str, BTreeMap<&str, usize>> = BTreeMap::new();
    for (file, line, target) in internal_references(package) {
        let is_family = target.starts_with(&file.module_path) || file.module_path.starts_with(&target);
        if let Some(to) = file_of.get(&target).filter(|_| !is_family) {
            edges.entry(&file.file).or_default().entry(to).or_insert(line);
        }
    }
    let reachable = |from: &str| {
        let (mut found, mut open) = (BTreeSet::new(), vec![from]);
        while let Some(file) = open.pop() {
            for to in edges.get(file).into_iter().flat_map(BTreeMap::keys) {
                if found.insert(*to) {
                    open.push(*to);
                }
            }
        }
        found
    };
    let reach: BTreeMap<&str, BTreeSet<&str>> = edges.keys().map(|file| (*file, reachable(file))).collect();
    let (mut circles, mut done) = (Vec::new(), BTreeSet::new());
    for (file, reached) in &reach {
        if !reached.contains(file) || !done.insert(*file) {
            continue;
        }
        let members: BTreeSet<&str> =
            reached.iter().copied().filter(|other| reach.get(other).is_some_and(|back| back.contains(file))).collect();
        done.extend(&members);
        let mut text = format!("circle of {} files:", members.len());
        for from in &members {
            for (to, line) in edges[from].iter().filter(|(to, _)| members.contains(*to)) {
                text += &format!("\n  {from}:{line} -> {to}");
            }
        }
        circles.push(text);
    }
    circles
}

fn all_references(package: &Package) -> impl Iterator<Item = (&FileImports, &import_parser::Reference)> {
    let of_file = |file| {
        let file: &FileImports = file;
        file.references.iter().map(move |reference| (file, reference))
    };
    package.files.iter().flat_map(of_file)
}

/// File, line and defining module of everything that a file uses of its own package.
fn internal_references(package: &Package) -> impl Iterator<Item = (&FileImports, usize, PathSegments)> {
    all_references(package).filter(|(_, reference)| !reference.is_reexport).filter_map(
        |(file, reference)| match package.resolver.resolve_path(&reference.using_module, &reference.segments)? {
            ResolvedPath::OwnModule(module) => Some((file, reference.line, module)),
            ResolvedPath::OtherCrate(_) => None,
        },
    )
}
