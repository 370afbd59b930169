//! The house keeps its order: floors, sizes, no panics. Reads `src/` as text, with syn, so that
//! inline paths, macros and re-exports count. `cargo test --test house -- --nocapture` draws it.

#[path = "house/facts.rs"]
mod facts;
#[path = "house/floors.rs"]
mod floors;
#[path = "house/resolve.rs"]
mod resolve;
#[path = "house/snippets.rs"]
mod snippets;
#[path = "house/source.rs"]
mod source;

use facts::Facts;

/// A file longer than this is refused; half of it is the aim.
const FILE_LINES: usize = 400;
/// A function longer than this is refused; `FUNCTION_AIM` is the aim.
const FUNCTION_LINES: usize = 60;
const FUNCTION_AIM: usize = 40;

fn house() -> Vec<Facts> {
    source::of_crate().iter().map(facts::gather).collect()
}

#[test]
fn imports_go_down() {
    let picture = floors::look(&house());
    println!("{}", floors::drawn(&picture));
    let breaches: Vec<_> = picture.breaches.into_iter().collect();
    assert!(breaches.is_empty(), "\n{}", breaches.join("\n"));
}

#[test]
fn files_and_functions_are_small() {
    let all = house();
    println!("functions over the aim of {FUNCTION_AIM} lines:");
    for (facts, function) in functions(&all).filter(|(_, f)| f.lines > FUNCTION_AIM) {
        println!("  {}:{} {} {}", facts.file, function.line, function.name, function.lines);
    }
    let large = too_large(&all);
    assert!(large.is_empty(), "\n{}", large.join("\n"));
}

#[test]
fn nothing_panics_on_the_way_of_a_run() {
    let panics = panics(&house());
    assert!(panics.is_empty(), "\n{}", panics.join("\n"));
}

fn functions(all: &[Facts]) -> impl Iterator<Item = (&Facts, &facts::Function)> {
    all.iter().flat_map(|facts| facts.functions.iter().map(move |function| (facts, function)))
}

fn too_large(all: &[Facts]) -> Vec<String> {
    let files = all
        .iter()
        .filter(|facts| facts.lines > FILE_LINES)
        .map(|facts| format!("{}: {} lines without its tests; split it", facts.file, facts.lines));
    let functions = functions(all).filter(|(_, f)| f.lines > FUNCTION_LINES).map(|(facts, f)| {
        format!("{}:{}: `{}` has {} lines; split it", facts.file, f.line, f.name, f.lines)
    });
    files.chain(functions).collect()
}

fn panics(all: &[Facts]) -> Vec<String> {
    all.iter()
        .flat_map(|facts| {
            facts.panics.iter().map(move |panic| {
                format!("{}:{}: {} outside tests", facts.file, panic.line, panic.what)
            })
        })
        .collect()
}
