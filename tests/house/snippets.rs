//! Each check fails where it should, and only there.

use super::{FILE_LINES, FUNCTION_LINES, facts, floors, panics, source, too_large};

fn gathered(files: &[(&str, &str)]) -> Vec<facts::Facts> {
    source::parse(files.iter().copied()).iter().map(facts::gather).collect()
}

/// One file `src/{room}` in a small house; the breaches found in it.
fn breaches(file: &str, text: &str) -> Vec<String> {
    let mut files = vec![
        ("src/lib.rs", "pub mod base; pub mod record; pub mod world; pub mod methods;"),
        ("src/base/mod.rs", "pub mod axis; pub use axis::Axis; pub struct Clock;"),
        ("src/base/axis.rs", "pub enum Axis { X }"),
        ("src/record/mod.rs", "pub mod plan;"),
        ("src/record/plan.rs", "use crate::base::Axis; pub struct Plan(Axis);"),
        ("src/estimation/mod.rs", "pub fn solve() {}"),
        ("src/gcode/mod.rs", "pub fn render() {}"),
        ("src/world/mod.rs", "pub struct Truth;"),
        ("src/methods/mod.rs", "pub mod samba; pub mod dome; pub trait Method {}"),
        ("src/methods/samba/mod.rs", "use super::Method; pub struct Samba;"),
        ("src/methods/dome/mod.rs", "pub struct Dome;"),
        ("src/controllers/mod.rs", "pub mod grbl; pub trait Driver {}"),
        ("src/controllers/grbl/mod.rs", "mod driver; mod firmware;"),
        ("src/controllers/grbl/driver.rs", "pub fn parse() {}"),
        ("src/controllers/grbl/firmware.rs", "use crate::world::Truth; pub struct Chip(Truth);"),
    ];
    files.retain(|(name, _)| *name != file);
    files.push((file, text));
    floors::look(&gathered(&files)).breaches.into_iter().collect()
}

#[track_caller]
fn sound(file: &str, text: &str) {
    assert_eq!(breaches(file, text), Vec::<String>::new());
}

#[track_caller]
fn broken(file: &str, text: &str, why: &str) {
    let found = breaches(file, text);
    assert!(found.len() == 1 && found[0].contains(why), "{why}: {found:?}");
}

#[test]
fn down_is_sound() {
    sound("src/gcode/mod.rs", "use crate::record::plan::Plan; use crate::base::{Axis, axis};");
    sound("src/methods/samba/mod.rs", "use crate::gcode; fn f() { gcode::render() }");
    sound("src/methods/mod.rs", "pub mod samba; pub fn list() -> samba::Samba { loop {} }");
    sound("src/main.rs", "use trued::methods::samba::Samba; fn main() { trued::gcode::render() }");
}

#[test]
fn up_and_sideways_break_in_every_spelling() {
    let up = "`record` (floor 1) imports `gcode` (floor 3)";
    let file = "src/record/plan.rs";
    for text in [
        "use crate::gcode::render;",
        "use crate::{base::Axis, gcode::{render}};",
        "use super::super::gcode::render;",
        "fn f() { crate::gcode::render() }",
        "use crate as house; fn f() { house::gcode::render() }",
        "fn f() { println!(\"{:?}\", crate::gcode::render()); }",
        "mod inner { fn f() { super::super::super::gcode::render() } }",
        "use crate::gcode as text;",
        "use crate::gcode::*;",
        "impl crate::gcode::Render for Plan {}",
        "#[cfg(test)] mod tests { use crate::gcode::render; }",
    ] {
        broken(file, text, up);
    }
    let side = "`estimation` (floor 1) imports `record` (floor 1)";
    broken("src/estimation/mod.rs", "use crate::record::plan::Plan;", side);
}

#[test]
fn a_name_once_brought_in_is_followed() {
    let text = "use crate::base; fn f() { base::Axis::X; base::gone::x() }";
    sound("src/record/plan.rs", text);
    // A floor below smuggles: it breaks there, and everywhere it is taken from there.
    let found = breaches("src/base/mod.rs", "pub mod axis; pub use crate::world::Truth as Axis;");
    assert!(found.iter().any(|f| f.starts_with("src/base/mod.rs:1: `base`")), "{found:?}");
    assert!(found.iter().any(|f| f.starts_with("src/record/plan.rs:1: `record`")), "{found:?}");
}

#[test]
fn rooms_of_one_seam_do_not_see_each_other() {
    let side = "`methods/samba` (floor 4) imports `methods/dome` (floor 4)";
    broken("src/methods/samba/mod.rs", "use super::dome::Dome;", side);
    broken("src/methods/samba/plan.rs", "use crate::methods::dome::Dome;", side);
    // A re-export in the seam does not open a door.
    let seam = "pub mod samba; pub mod dome; pub use dome::Dome;";
    let files = [
        ("src/methods/mod.rs", seam),
        ("src/methods/dome/mod.rs", "pub struct Dome;"),
        ("src/methods/samba/mod.rs", "use super::Dome;"),
    ];
    let found = floors::look(&gathered(&files)).breaches;
    assert!(found.iter().any(|breach| breach.contains(side)), "{found:?}");
    let glob = [("src/methods/mod.rs", "pub mod samba; pub mod dome; pub use dome::inner::*;")];
    let found = floors::look(&gathered(&[
        glob[0],
        ("src/methods/dome/mod.rs", "pub mod inner { pub mod deep {} }"),
        ("src/methods/samba/mod.rs", "use super::deep::Thing;"),
    ]))
    .breaches;
    assert!(found.iter().any(|breach| breach.contains(side)), "{found:?}");
    let found = floors::look(&gathered(&[
        ("src/methods/mod.rs", "pub mod samba; pub mod dome; pub use dome::*;"),
        files[1],
        files[2],
    ]))
    .breaches;
    assert!(found.iter().any(|breach| breach.contains(side)), "{found:?}");
}

#[test]
fn the_truth_stays_hidden() {
    broken("src/methods/samba/model.rs", "use crate::world::Truth;", "must not know the truth");
    broken("src/gcode/mod.rs", "use crate::world::Truth;", "imports `world`");
    let file = "src/controllers/grbl/driver.rs";
    broken(file, "use crate::world::Truth;", "only its twin may");
    broken(file, "use super::firmware::Chip;", "import each other");
    let file = "src/controllers/grbl/firmware.rs";
    broken(file, "use super::driver::parse;", "import each other");
    sound(file, "#[cfg(test)] mod tests { use super::super::driver::parse; }");
}

#[test]
fn pure_rooms_touch_no_outside() {
    let method = "src/methods/samba/plan.rs";
    broken(method, "use std::fs; fn f() { fs::read(\"x\"); }", "does no IO");
    broken(method, "async fn f() { tokio::time::sleep(x).await }", "does no IO");
    broken(method, "fn f() { std::time::Instant::now(); }", "has no clock");
    broken(method, "use rand::rng;", "with a seed");
    broken("src/service/mod.rs", "fn f() { rand::random::<u8>(); }", "with a seed");
    sound("src/service/mod.rs", "use std::fs; use std::time::Instant;");
    sound("src/link/mod.rs", "use tokio::io;");
    sound(method, "#[cfg(test)] mod tests { use std::fs; }");
    sound("src/base/clock.rs", "use std::time::Instant;");
}

#[test]
fn unknown_rooms_and_lib_are_no_way_round() {
    broken("src/shed/mod.rs", "pub struct Junk;", "has no floor");
    let found = breaches("src/lib.rs", "pub use crate::world::Truth;");
    assert_eq!(found, Vec::<String>::new());
    let files = [
        ("src/lib.rs", "pub use crate::world::Truth;"),
        ("src/world/mod.rs", "pub struct Truth;"),
        ("src/gcode/mod.rs", "use crate::Truth;"),
    ];
    let found = floors::look(&gathered(&files)).breaches;
    assert!(found.iter().any(|breach| breach.contains("goes through lib.rs")), "{found:?}");
    assert!(found.iter().any(|breach| breach.contains("imports `world`")), "{found:?}");
}

#[test]
fn sizes_count_without_tests() {
    let lines = |count: usize| "// a line\n".repeat(count);
    let large = |text: &str| too_large(&gathered(&[("src/record/mod.rs", text)]));
    assert!(large(&lines(FILE_LINES)).is_empty());
    assert_eq!(large(&lines(FILE_LINES + 1)).len(), 1);
    let tested = format!("{}#[cfg(test)]\nmod tests {{\n{}}}\n", lines(FILE_LINES), lines(50));
    assert!(large(&tested).is_empty());
    let function = |count: usize| format!("struct S; impl S {{ fn f() {{\n{}}} }}", lines(count));
    assert!(large(&function(FUNCTION_LINES - 2)).is_empty());
    let found = large(&function(FUNCTION_LINES - 1));
    assert!(found[0].contains("`f` has 61 lines"), "{found:?}");
    assert!(large(&format!("#[cfg(test)] mod tests {{ {} }}", function(90))).is_empty());
}

#[test]
fn panics_are_found_outside_tests_only() {
    let found = |text: &str| panics(&gathered(&[("src/record/mod.rs", text)])).len();
    for text in [
        "fn f() { x.unwrap(); }",
        "fn f() { x.expect(\"y\"); }",
        "fn f() { x.map(Option::unwrap); }",
        "fn f() { println!(\"{}\", x.unwrap()); }",
        "fn f() { panic!(\"no\") }",
        "fn f() { std::panic!(\"no\") }",
        "fn f() { todo!() }",
        "fn f() { vec![unimplemented!()] }",
        "#[cfg(not(test))] fn f() { x.unwrap(); }",
    ] {
        assert_eq!(found(text), 1, "{text}");
    }
    for text in [
        "fn f() { x.unwrap_or(1); x.unwrap_or_default(); unwrap(); }",
        "#[cfg(test)] mod tests { fn f() { x.unwrap(); panic!() } }",
        "#[test] fn f() { x.unwrap(); }",
        "impl S { #[cfg(test)] fn f() { println!(\"{}\", x.unwrap()); } }",
        "// x.unwrap()\nconst TEXT: &str = \"panic!()\";",
    ] {
        assert_eq!(found(text), 0, "{text}");
    }
    let declared = [
        ("src/record/mod.rs", "#[cfg(test)] mod tests;"),
        ("src/record/tests.rs", "fn f() { x.unwrap(); }"),
    ];
    assert!(panics(&gathered(&declared)).is_empty());
}
