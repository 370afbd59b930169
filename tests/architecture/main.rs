//! Checks of the architecture beyond those of cargo: the layers inside a package, the forbidden dependencies of a
//! package without IO, import circles between files, and the length of a file. Reads `src/` with syn. `cargo test
//! --test architecture -- --nocapture` prints the imports between the modules of `trued`.

mod imports;
mod resolve;
mod source;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::LazyLock;

use imports::{Imports, Path};
use resolve::{Resolver, Target};

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
const UNSEEDED_RANDOM: [&str; 5] =
    ["rand::rng", "rand::random", "rand::make_rng", "rand::rngs::ThreadRng", "rand::rngs::SysRng"];

/// Modules of the package `trued`, lowest layer first. A module imports from lower layers only.
const LAYERS: [&[&str]; 6] =
    [&["store", "report"], &["setup", "archive"], &["run"], &["service", "commissioning"], &["cli"], &["main"]];

/// Package and module whose folders must not import each other: each is one method or one driver.
const SIBLINGS: [(&str, &[&str]); 3] = [("methods", &[]), ("devices", &["controllers"]), ("devices", &["sensors"])];

/// Folders of `methods` that all methods use. They import no method.
const SHARED: [&str; 3] = ["ball_measurement", "decision", "identification"];

/// Packages that do no IO and read no clock.
const PURE: [&str; 4] = ["estimation", "machine", "planning", "methods"];
const IMPURE_PATHS: [&str; 9] = [
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
    files: Vec<Imports>,
    resolver: Resolver,
}

static PACKAGES: LazyLock<Vec<Package>> = LazyLock::new(|| {
    let of = |(name, folder): (String, PathBuf)| package(name, &source::of_package(&folder));
    source::packages().into_iter().map(of).collect()
});

fn package(name: String, sources: &[source::Source]) -> Package {
    let files: Vec<Imports> = sources.iter().map(imports::of_file).collect();
    let resolver = Resolver::new(&files);
    Package { name, files, resolver }
}

#[test]
fn imports_point_to_lower_layers() {
    let trued = PACKAGES.iter().find(|package| package.name == "trued").unwrap();
    let (imports, breaches) = upward_imports(trued);
    for (module, imported) in imports {
        println!("{module:<14} {}", imported.into_iter().collect::<Vec<_>>().join(" "));
    }
    assert!(breaches.is_empty(), "\n{}", breaches.join("\n"));
}

#[test]
fn methods_and_drivers_do_not_import_each_other() {
    let breaches: Vec<String> = PACKAGES.iter().flat_map(sibling_imports).collect();
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
    let checked: Vec<_> = source::packages().into_iter().filter_map(of).collect();
    assert_eq!(checked.len(), PACKAGE_DEPENDENCIES.len(), "a package is missing from the table");
    let breaches = checked.concat();
    assert!(breaches.is_empty(), "\n{}", breaches.join("\n"));
}

#[test]
fn every_random_number_has_a_seed() {
    let uses = |package| used_paths(package, &UNSEEDED_RANDOM);
    let breaches: Vec<String> = PACKAGES.iter().flat_map(uses).collect();
    assert!(breaches.is_empty(), "\n{}", breaches.join("\n"));
}

#[test]
fn only_tests_execute_blocks_without_a_proof_of_bodies() {
    let users = PACKAGES.iter().filter(|package| package.name != "planning");
    let breaches: Vec<String> =
        users.flat_map(|package| used_paths(package, &["planning::proof::for_tests"])).collect();
    assert!(breaches.is_empty(), "\n{}", breaches.join("\n"));
}

#[test]
fn packages_that_compute_do_no_io() {
    let pure = PACKAGES.iter().filter(|package| PURE.contains(&package.name.as_str()));
    let breaches: Vec<String> = pure.flat_map(|package| used_paths(package, &IMPURE_PATHS)).collect();
    assert!(breaches.is_empty(), "\n{}", breaches.join("\n"));
}

#[test]
fn no_file_imports_itself_through_others() {
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

fn upward_imports(package: &Package) -> (BTreeMap<String, BTreeSet<String>>, Vec<String>) {
    let (mut imports, mut breaches) = (BTreeMap::<_, BTreeSet<_>>::new(), Vec::new());
    let layer = |module: &str| LAYERS.iter().position(|layer| layer.contains(&module));
    for (file, line, target) in internal_references(package) {
        let (Some(from), Some(to)) = (file.module.first(), target.first()) else { continue };
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

fn sibling_imports(package: &Package) -> Vec<String> {
    let mut breaches = Vec::new();
    for (_, parent) in SIBLINGS.iter().filter(|(name, _)| *name == package.name) {
        let folders = folders_below(package, parent);
        let sibling_of = |module: &Path| {
            let below = module.strip_prefix(owned(parent).as_slice())?;
            folders.get(below.first()?)
        };
        for (file, line, target) in internal_references(package) {
            if let (Some(from), Some(to)) = (sibling_of(&file.module), sibling_of(&target))
                && from != to
                && !SHARED.contains(&to.as_str())
            {
                breaches.push(format!("{}:{line}: `{from}` imports `{to}`", file.file));
            }
        }
    }
    breaches
}

/// The modules right below `parent` that are folders.
fn folders_below(package: &Package, parent: &[&str]) -> BTreeSet<String> {
    let parent = owned(parent);
    let folders = package.files.iter().filter(|file| file.file.ends_with("/mod.rs"));
    let below = folders.filter_map(|file| match file.module.strip_prefix(parent.as_slice())? {
        [name] => Some(name.clone()),
        _ => None,
    });
    below.collect()
}

fn owned(path: &[&str]) -> Path {
    path.iter().map(|segment| (*segment).to_owned()).collect()
}

/// Where a package uses one of `paths` of other crates.
fn used_paths(package: &Package, paths: &[&str]) -> Vec<String> {
    let mut breaches = Vec::new();
    for (file, reference) in references(package) {
        let target = package.resolver.target(&reference.module, &reference.segments);
        let Some(Target::Outside(path)) = target else { continue };
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
    let file_of: BTreeMap<&Path, &str> =
        package.files.iter().flat_map(|file| file.modules.iter().map(|module| (module, file.file.as_str()))).collect();
    let mut edges: BTreeMap<&str, BTreeMap<&str, usize>> = BTreeMap::new();
    for (file, line, target) in internal_references(package) {
        let is_family = target.starts_with(&file.module) || file.module.starts_with(&target);
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

fn references(package: &Package) -> impl Iterator<Item = (&Imports, &imports::Reference)> {
    let of_file = |file| {
        let file: &Imports = file;
        file.references.iter().map(move |reference| (file, reference))
    };
    package.files.iter().flat_map(of_file)
}

/// File, line and defining module of everything that a file uses of its own package.
fn internal_references(package: &Package) -> impl Iterator<Item = (&Imports, usize, Path)> {
    references(package).filter(|(_, reference)| !reference.is_reexport).filter_map(|(file, reference)| {
        match package.resolver.target(&reference.module, &reference.segments)? {
            Target::Module(module) => Some((file, reference.line, module)),
            Target::Outside(_) => None,
        }
    })
}
