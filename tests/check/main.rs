//! `trued check` names the mistake: each that is planted, in words that come up for no other.

mod bench;
mod links;
mod mistakes;
mod people;

use std::thread;

use bench::{against, checked, failures, machine, with_control};
use mistakes::{MISTAKES, Mistake};
use trued::commissioning::Verdict;
use trued::setup::Pace;

fn all() -> impl Iterator<Item = &'static Mistake> {
    MISTAKES.iter().chain(links::MISTAKES)
}

#[test]
fn each_planted_mistake_is_named_and_no_other() {
    thread::scope(|scope| {
        let rows = all().map(|row| (row, scope.spawn(move || (row.check)())));
        let rows: Vec<_> = rows.collect();
        let mut wrong = Vec::new();
        for (row, checked) in rows {
            let summary = checked.join().unwrap();
            let failed = failures(&summary);
            println!("--- {}\n{failed}", row.name);
            if !failed.contains(row.phrase) {
                wrong.push(format!("{}: not named (`{}`):\n{summary}", row.name, row.phrase));
            }
            for other in all().filter(|other| other.phrase != row.phrase) {
                if failed.contains(other.phrase) {
                    wrong.push(format!("{}: `{}` is said:\n{summary}", row.name, other.phrase));
                }
            }
        }
        assert!(wrong.is_empty(), "\n{}", wrong.join("\n\n"));
    });
}

#[test]
fn a_sound_machine_passes_whatever_it_speaks() {
    let controls = [
        "wire = \"memory\"",
        "wire = \"pty\"",
        "speaks = \"modbus\"\nwire = \"tcp\"",
        "speaks = \"modbus\"\nwire = \"pty\"",
    ];
    thread::scope(|scope| {
        let check = |keys| scope.spawn(move || (keys, checked(&with_control(keys, &machine(&[])))));
        let all: Vec<_> = controls.into_iter().map(check).collect();
        for one in all {
            let (keys, summary) = one.join().unwrap();
            assert_eq!(summary.count(Verdict::Failed), 0, "{keys}\n{summary}");
            let told = summary.to_string();
            for words in ["open at rest, closed while deflected", "held on its way"] {
                assert!(told.contains(words), "{keys}: {words}\n{summary}");
            }
            for axis in ["X ", "Y ", "Z ", "B ", "C "] {
                let seen = |line: &str| {
                    line.starts_with("axes    ok")
                        && line.contains(axis)
                        && line.contains("as it should")
                };
                assert!(told.lines().any(seen), "{keys}: {axis}\n{summary}");
            }
            assert_eq!(summary.count(Verdict::NotLookedAt), 1, "{keys}\n{summary}");
        }
    });
}

/// As a person's own machine file has it: nothing simulated in the program itself.
#[test]
fn a_sound_control_elsewhere_passes() {
    for keys in ["wire = \"pty\"", "speaks = \"modbus\""] {
        let truth = with_control(keys, &machine(&[]));
        let dialect = |keys| keys + "\ndialect = \"grbl-m19\"";
        let summary = against(&machine(&[]), &truth, Pace::Fast, dialect);
        assert_eq!(summary.count(Verdict::Failed), 0, "{keys}\n{summary}");
    }
}
