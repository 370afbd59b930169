//! The command line itself: version, shell completions, man pages, and the folder of the journal.

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

fn generate_into(folder: &Path) {
    let output = run_trued(&["generate", &folder.display().to_string()]);
    assert!(output.status.success(), "{}", stderr(&output));
}

/// What bash offers for the last of `words`.
fn bash_completions(script: &Path, words: &[&str]) -> Vec<String> {
    let code = "source \"$1\"; shift; COMP_WORDS=(\"$@\"); COMP_CWORD=$(($# - 1)); \
                _trued trued \"${@: -1}\" \"${@: -2:1}\"; printf '%s\\n' \"${COMPREPLY[@]}\"";
    let output = Command::new("bash").args(["-c", code, "bash"]).arg(script).args(words).output();
    let output = output.expect("bash starts");
    assert!(output.status.success() && output.stderr.is_empty(), "{}", stderr(&output));
    stdout(&output).lines().map(str::to_owned).collect()
}

fn bash_completes_commands_options_and_names() {
    let folder = TempDir::new().unwrap();
    generate_into(folder.path());
    let script = folder.path().join("trued.bash");
    assert_eq!(bash_completions(&script, &["trued", "pl"]), ["plan"]);
    assert_eq!(bash_completions(&script, &["trued", "run", "self"]), ["self-calibration"]);
    assert_eq!(bash_completions(&script, &["trued", "resume", "--hom"]), ["--homed"]);
    let dialects = bash_completions(&script, &["trued", "plan", "--gcode", ""]);
    assert_eq!(dialects, ["grbl", "grbl-m19", "linuxcnc"]);
}

fn every_command_has_a_man_page() {
    let folder = TempDir::new().unwrap();
    generate_into(folder.path());
    let help = stdout(&run_trued(&["--help"]));
    let commands = help.lines().filter_map(|line| line.strip_prefix("  ")?.split_whitespace().next());
    let commands: Vec<&str> = commands.take_while(|word| *word != "help").filter(|word| *word != "-h,").collect();
    assert!(commands.contains(&"run") && commands.contains(&"token"), "{help}");
    for command in commands {
        let page = std::fs::read_to_string(folder.path().join(format!("trued-{command}.1"))).expect(command);
        assert!(page.contains(".SH SYNOPSIS") && page.contains(".SH OPTIONS"), "{command}: {page}");
    }
    let page = std::fs::read_to_string(folder.path().join("trued.1")).unwrap();
    assert!(page.contains("trued\\-run(1)"), "{page}");
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
        bash_completes_commands_options_and_names,
        every_command_has_a_man_page,
        run_and_runs_name_the_folder_of_the_journal,
    ]
}
