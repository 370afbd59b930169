//! The command line itself: version, and the folder of the journal.

use std::path::Path;
use std::process::{Command, Output};

use tempfile::TempDir;

use crate::support::harness::{Pool, Trials, trials};
use crate::support::machine_shop::stderr;

fn run_trued(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_trued")).args(arguments).output().expect("the program starts")
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// A release states its commit; a development build does not have one.
fn version_states_the_commit_of_a_release() {
    let output = run_trued(&["--version"]);
    let build = if cfg!(debug_assertions) {
        "development build".to_owned()
    } else {
        let folder = env!("CARGO_MANIFEST_DIR");
        let head = Command::new("git").args(["-C", folder, "rev-parse", "HEAD"]).output().expect("git starts");
        stdout(&head)[..12].to_owned()
    };
    assert_eq!(stdout(&output), format!("trued {} ({build})\n", env!("CARGO_PKG_VERSION")));
}

fn run_and_runs_name_the_folder_of_the_journal() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("shop.toml");
    let machine = include_str!("../../config/simulated.toml");
    std::fs::write(&file, format!("{machine}\n[method.self-calibration]\nmonte_carlo_trials = 100\n")).unwrap();
    let [state, file] = [folder.path().join("state"), file].map(|path| path.display().to_string());
    let run = run_trued(&["run", "self-calibration", "--machine", &file, "--state", &state]);
    assert!(stdout(&run).contains(&format!("stored as run 1 in {state}: ")), "{}{}", stdout(&run), stderr(&run));
    let runs = run_trued(&["runs", "--state", &state]);
    assert!(stderr(&runs).contains(&format!("state folder: {state}\n")), "{}", stderr(&runs));
    assert!(Path::new(&state).join("journal.sqlite").exists());
}

pub fn trials() -> Trials {
    trials![Pool::Waiting, 0;
        version_states_the_commit_of_a_release,
        run_and_runs_name_the_folder_of_the_journal,
    ]
}
