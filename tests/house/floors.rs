//! The floors: who may import whom, and what a room must never touch.

use std::collections::{BTreeMap, BTreeSet};

use super::facts::{Facts, Path};
use super::resolve::{Resolver, Target};

/// The plan of the house, as in ARCHITECTURE.md.
const FLOORS: [&[&str]; 10] = [
    &["base"],
    &["estimation", "record"],
    &["kinematics", "artefact", "link"],
    &["planning", "gcode", "world", "decision"],
    &["methods", "proof", "compensation"],
    &["controllers", "sensors", "store", "report"],
    &["setup", "archive"],
    &["run"],
    &["service", "commissioning"],
    &["cli", "main"],
];

/// Folders whose inner folders are rooms of their own; the parent is their seam and their list.
const SEAMS: [&str; 4] = ["methods", "controllers", "sensors", "service"];

/// Floors up to this one compute: no IO, no clock, no chance without a seed.
const PURE_UP_TO: usize = 4;
/// On the lower floors all the same: it opens ports.
const IMPURE: [&str; 1] = ["link"];
const IO: [&str; 11] = [
    "std::fs",
    "std::net",
    "std::process",
    "std::env",
    "std::thread",
    "std::io::stdin",
    "tokio",
    "tokio_modbus",
    "tokio_serial",
    "rusqlite",
    "socketcan",
];
const CLOCKS: [&str; 3] = ["std::time::Instant", "std::time::SystemTime", "jiff"];
const CHANCE: [&str; 5] =
    ["rand::rng", "rand::random", "rand::thread_rng", "rand::rngs::ThreadRng", "rand::rngs::OsRng"];

/// Who imports whom, and every breach of the rules.
#[derive(Default)]
pub struct Picture {
    pub imports: BTreeMap<String, BTreeSet<String>>,
    pub breaches: BTreeSet<String>,
}

pub fn look(all: &[Facts]) -> Picture {
    let resolver = Resolver::new(all);
    let rooms = Rooms::new(all);
    let mut picture = Picture::default();
    for facts in all {
        let from = rooms.of(&facts.module);
        picture.imports.entry(from.clone()).or_default();
        if floor(&from).is_none() && from != "lib" {
            picture.breaches.insert(format!("{}: `{from}` has no floor in the plan", facts.file));
        }
        for reference in &facts.references {
            for target in resolver.targets(&reference.module, &reference.segments) {
                let broken = match &target {
                    // A test may read its golden files; the floors hold for it as well.
                    Target::Outside(_) if reference.in_test => None,
                    Target::Outside(path) => forbidden(&from, path),
                    Target::Module(module) => {
                        let to = rooms.of(module);
                        if to != from {
                            picture.imports.entry(from.clone()).or_default().insert(to.clone());
                        }
                        let twins = || twins(&rooms, facts, module);
                        // Driver and twin meet in tests; that is what the twin is for.
                        breach(&from, &to).or_else(|| (!reference.in_test).then(twins).flatten())
                    }
                };
                if let Some(why) = broken {
                    let at = format!("{}:{}", facts.file, reference.line);
                    picture.breaches.insert(format!("{at}: {why}"));
                }
            }
        }
    }
    picture
}

struct Rooms {
    inner: BTreeSet<String>,
}

impl Rooms {
    fn new(all: &[Facts]) -> Self {
        let inner = all.iter().filter_map(|facts| {
            let mut parts = facts.file.strip_prefix("src/")?.split('/');
            let (seam, folder) = (parts.next()?, parts.next()?);
            (SEAMS.contains(&seam) && parts.next().is_some()).then(|| format!("{seam}/{folder}"))
        });
        Self { inner: inner.collect() }
    }

    fn of(&self, module: &[String]) -> String {
        match module {
            [] => "lib".to_owned(),
            [seam, folder, ..] if self.inner.contains(&format!("{seam}/{folder}")) => {
                format!("{seam}/{folder}")
            }
            [room, ..] => room.clone(),
        }
    }
}

fn seam(room: &str) -> &str {
    room.split('/').next().unwrap_or(room)
}

pub fn floor(room: &str) -> Option<usize> {
    FLOORS.iter().position(|rooms| rooms.contains(&seam(room)))
}

/// Why `from` may not import `to`.
fn breach(from: &str, to: &str) -> Option<String> {
    if from == to || from == "lib" || from == "main" {
        return None;
    }
    if to == "lib" {
        return Some("goes through lib.rs, which only lists the rooms".to_owned());
    }
    if to == "world" && seam(from) == "methods" {
        return Some(format!("`{from}` sees `world`: a method must not know the truth"));
    }
    // A room sees its own seam; the seam may name its rooms.
    if seam(from) == seam(to) && (from == seam(from) || to == seam(to)) {
        return None;
    }
    let (Some(here), Some(there)) = (floor(from), floor(to)) else {
        return Some(format!("`{from}` or `{to}` has no floor in the plan"));
    };
    (there >= here).then(|| format!("`{from}` (floor {here}) imports `{to}` (floor {there})"))
}

/// A device's simulated twin shares nothing with its driver, and only the twin knows the world.
fn twins(rooms: &Rooms, facts: &Facts, to: &Path) -> Option<String> {
    let from = rooms.of(&facts.module);
    if !["controllers", "sensors"].contains(&seam(&from)) || facts.module.len() < 3 {
        return None;
    }
    let here = is_twin(&facts.module);
    if to.first().is_some_and(|room| room == "world") && !here {
        return Some(format!("the driver in `{from}` sees `world`; only its twin may"));
    }
    let both_inside = rooms.of(to) == from && to.len() >= 3;
    (both_inside && here != is_twin(to))
        .then(|| format!("driver and simulated twin in `{from}` import each other"))
}

fn is_twin(module: &[String]) -> bool {
    module.iter().skip(2).any(|part| part.starts_with("firmware") || part.starts_with("simulated"))
}

/// Why `from` may not touch `path` of another crate.
fn forbidden(from: &str, path: &[String]) -> Option<String> {
    let path = path.join("::");
    let hit = |list: &[&'static str]| {
        let inside = |entry: &&&str| path == **entry || path.starts_with(&format!("{entry}::"));
        list.iter().find(inside).copied()
    };
    let pure = floor(from).is_some_and(|floor| floor <= PURE_UP_TO) && !IMPURE.contains(&from);
    if let Some(entry) = hit(&CHANCE) {
        return Some(format!("`{entry}`: chance comes from base::random, with a seed"));
    }
    if let Some(entry) = hit(&IO).filter(|_| pure) {
        return Some(format!("`{entry}`: `{from}` does no IO"));
    }
    // base/clock.rs is the seam to the host's clock.
    let entry = hit(&CLOCKS).filter(|_| pure && from != "base")?;
    Some(format!("`{entry}`: `{from}` has no clock; time is given to it"))
}

/// The house as text, top floor first.
pub fn drawn(picture: &Picture) -> String {
    let mut text = String::new();
    for (number, _) in FLOORS.iter().enumerate().rev() {
        for (room, imports) in
            picture.imports.iter().filter(|(room, _)| floor(room) == Some(number))
        {
            let imports: Vec<&str> = imports.iter().map(String::as_str).collect();
            text += &format!("{number}  {room:<28} {}\n", imports.join(" "));
        }
    }
    text
}
