//! Each check fails only for its own violation.

use super::{IO_AND_CLOCK_PATHS, UNSEEDED_RANDOM_PATHS};
use super::{
    build_package, import_circles, module_imports_and_layer_breaches, parsed_sources, sibling_import_breaches,
    uses_of_forbidden_paths,
};

/// Package of modules, each with its path (empty for the root) and its text.
fn parse_package(name: &str, modules: &[(&str, &str)]) -> super::Package {
    let files = modules.iter().map(|(module, text)| {
        let path = module.split("::").filter(|part| !part.is_empty()).map(str::to_owned).collect();
        (format!("{}/mod.rs", module.replace("::", "/")), path, (*text).to_owned())
    });
    build_package(name.to_owned(), &parsed_sources::parse_without_test_modules(files))
}

#[test]
fn an_import_of_a_higher_layer_is_found_in_every_spelling() {
    let breaches = |text: &str| {
        let files = [
            ("", "mod setup; mod run;"),
            ("run", "mod inner; pub use inner::Run; pub fn go() {}"),
            ("run::inner", "pub struct Run;"),
            ("setup", text),
        ];
        module_imports_and_layer_breaches(&parse_package("trued", &files)).1.len()
    };
    for text in [
        "use crate::run::go;",
        "use crate::{run::{go}};",
        "use super::run::Run;",
        "fn f() { crate::run::go() }",
        "fn f() { println!(\"{:?}\", crate::run::go()) }",
        "use crate::run as other;",
        "pub mod inner { use crate::run::*; }",
    ] {
        assert!(breaches(text) > 0, "{text}");
    }
    assert_eq!(breaches("#[cfg(test)] mod tests { use crate::run::go; }"), 0);
    assert_eq!(breaches("fn run() {} fn f() { run() }"), 0);
}

#[test]
fn import_between_methods_is_found() {
    let files = [
        ("", "pub mod samba; pub mod latch_delay; pub fn shared() {}"),
        ("latch_delay", "pub fn fit() {}"),
        ("samba", "use crate::latch_delay::fit; use crate::shared;"),
    ];
    assert_eq!(sibling_import_breaches(&parse_package("methods", &files)).len(), 1);
}

#[test]
fn io_behind_an_alias_is_found() {
    let found =
        |text: &str| uses_of_forbidden_paths(&parse_package("methods", &[("", text)]), &IO_AND_CLOCK_PATHS).len();
    assert!(found("use std::fs as files; fn f() { files::read(\"x\"); }") > 0);
    assert!(found("fn f() -> std::time::Instant { std::time::Instant::now() }") > 0);
    assert_eq!(found("use std::time::Duration; fn f(d: Duration) {}"), 0);
}

#[test]
fn random_without_a_seed_is_found() {
    let found =
        |text: &str| uses_of_forbidden_paths(&parse_package("methods", &[("", text)]), &UNSEEDED_RANDOM_PATHS).len();
    assert!(found("fn f() -> u8 { rand::random() }") > 0);
    assert!(found("use rand::{rng as any, Rng}; fn f() { any(); }") > 0);
    assert_eq!(found("use rand::Rng; fn f(stream: &mut impl Rng) {}"), 0);
}

#[test]
fn a_module_without_a_layer_is_refused() {
    let files = [("", "mod run; mod extra;"), ("run", "use crate::extra::x;"), ("extra", "pub fn x() {}")];
    assert_eq!(module_imports_and_layer_breaches(&parse_package("trued", &files)).1.len(), 1);
}

#[test]
fn import_circle_is_found_but_a_reexport_is_not_one() {
    let circles = |a: &str, b: &str| {
        import_circles(&parse_package("methods", &[("", "pub mod a; pub mod b;"), ("a", a), ("b", b)]))
    };
    let found = circles("use super::b::B; pub struct A(B);", "pub struct B; fn f(_: super::a::A) {}");
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(circles("use super::b::B;", "pub struct B;"), Vec::<String>::new());
    // A module that re-exports a type of its child and defines a trait that the child implements.
    let files =
        [("", "mod child; pub use child::C; pub trait T {}"), ("child", "pub struct C; impl super::T for C {}")];
    assert_eq!(import_circles(&parse_package("methods", &files)), Vec::<String>::new());
}
