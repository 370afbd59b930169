//! Input errors of a user: each is refused with advice, and nothing moves.

use crate::support::harness::{Pool, Trials, trials};
use std::process::{Command, Output};

use tempfile::TempDir;

fn run_trued(state: &TempDir, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_trued"))
        .args(arguments)
        .arg("--state")
        .arg(state.path())
        .output()
        .expect("the program starts")
}

const MACHINE_FILE: &str = include_str!("../../config/simulated.toml");

/// Runs a changed machine file; returns the exit code and the message.
fn exit_code_and_error(machine: &str) -> (Option<i32>, String) {
    let state = TempDir::new().unwrap();
    let file = state.path().join("shop.toml");
    std::fs::write(&file, machine).unwrap();
    let output = run_trued(&state, &["run", "self-calibration", "--machine", &file.display().to_string(), "--json"]);
    assert!(output.stdout.is_empty(), "an estimate in spite of everything");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

fn line_number(text: &str, key: &str) -> usize {
    text.lines().position(|line| line.starts_with(key)).expect("the key") + 1
}

fn an_unknown_key_names_file_line_key_and_the_nearest() {
    let machine = MACHINE_FILE.replace("ball_radius_mm", "ball_radus_mm");
    let (code, said) = exit_code_and_error(&machine);
    assert_eq!(code, Some(1), "{said}");
    let line = line_number(&machine, "ball_radus_mm");
    assert!(said.contains(&format!("shop.toml:{line}")), "{said}");
    assert!(said.contains("ball_radus_mm") && said.contains("`ball_radius_mm`"), "{said}");
}

fn a_wrong_unit_names_the_right_one() {
    let (code, said) = exit_code_and_error(&MACHINE_FILE.replace("\nradius_mm", "\nradius_um"));
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("radius_um") && said.contains("`radius_mm`"), "{said}");
}

fn a_rank_deficient_design_names_a_better_one() {
    let machine = format!("{MACHINE_FILE}\n[method.self-calibration]\npositions = 16\nprobe_angles_deg = [0, 45]\n");
    let (code, said) = exit_code_and_error(&machine);
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("[0, 22.5]"), "{said}");
}

fn machine_toml_with_controller(lines: &str) -> String {
    MACHINE_FILE.replace("kind = \"simulated\"\n", &format!("{lines}\n")).replace("wire = \"memory\"\n", "")
}

fn a_missing_port_is_reported() {
    let (code, said) = exit_code_and_error(&machine_toml_with_controller(
        "kind = \"grbl\"\nserial = \"/dev/ttyNOSUCH7\"\nbaud = 115200",
    ));
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("/dev/ttyNOSUCH7 does not exist"), "{said}");
}

fn silent_and_garbled_ports_have_different_messages() {
    for (answer, named) in [(None, "no reply"), (Some(b"\xff\xfe\x80\x91\xc3\x28"), "baud rate")] {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let server = std::thread::spawn(move || {
            use std::io::{Read, Write};
            let (mut stream, _) = listener.accept().unwrap();
            let mut buffer = [0; 256];
            // Answer every request until the client disconnects.
            while stream.read(&mut buffer).is_ok_and(|count| count > 0) {
                if let Some(bytes) = answer {
                    let _ = stream.write_all(bytes);
                }
            }
        });
        let (code, said) =
            exit_code_and_error(&machine_toml_with_controller(&format!("kind = \"grbl\"\ntcp = \"127.0.0.1:{port}\"")));
        assert_eq!(code, Some(1), "{said}");
        assert!(said.contains(named), "{said}");
        server.join().unwrap();
    }
}

fn usage_errors_exit_with_2() {
    let state = TempDir::new().unwrap();
    assert_eq!(run_trued(&state, &["run"]).status.code(), Some(2));
    assert_eq!(run_trued(&state, &["nonsense"]).status.code(), Some(2));
}

/// A wrong name of a method, dialect or control is wrong usage; the message lists the names.
fn a_wrong_name_exits_with_2_and_lists_the_names() {
    let state = TempDir::new().unwrap();
    let readings = ["--readings", "none.csv"];
    for (arguments, named) in [
        (&["run", "self-calibrate"][..], &["laser-r-test", "a similar value exists: 'self-calibration'"][..]),
        (&["plan", "sambo"], &["laser-r-test", "a similar value exists: 'samba'"]),
        (&[&["identify", "x"][..], &readings].concat(), &["self-calibration", "samba"]),
        (&["simulate", "x"], &["self-calibration", "samba"]),
        (&["plan", "samba", "--gcode", "foo"], &["'--gcode <DIALECT>'", "grbl, grbl-m19, linuxcnc"]),
        (&["init", "--kind", "grb", "--tcp", "127.0.0.1:1"], &["linuxcnc", "a similar value exists: 'grbl'"]),
    ] {
        let output = run_trued(&state, arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(named.iter().all(|name| said.contains(name)), "{arguments:?}: {said}");
    }
}

fn a_part_with_horizontal_axis_is_refused() {
    let (code, said) = exit_code_and_error(&MACHINE_FILE.replace("axis = [0.0, 0.0, 1.0]", "axis = [1.0, 0.0, 0.0]"));
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("upright") && said.contains("nothing has moved"), "{said}");
}

fn tolerance_that_matches_no_parameter_is_named() {
    let state = TempDir::new().unwrap();
    let file = state.path().join("shop.toml");
    let machine =
        format!("{MACHINE_FILE}\n[tolerance]\nEX0Q_um = 3.0\n[method.self-calibration]\nmonte_carlo_trials = 100\n");
    std::fs::write(&file, machine).unwrap();
    let run = run_trued(&state, &["run", "self-calibration", "--machine", &file.display().to_string()]);
    assert_eq!(run.status.code(), Some(4));
    let said = String::from_utf8_lossy(&run.stdout);
    assert!(said.contains("limit for `EX0Q` in µm matches no parameter"), "{said}");
}

/// Settings that would fail during the run are refused before the first move, with advice.
fn settings_that_cannot_work_are_refused_before_motion() {
    for (setting, named) in [
        ("standoff_mm = 0.0", "greater than 0"),
        ("search_mm = -1.0", "greater than 0"),
        ("locate = false", "uncertainty_mm = 2"),
        ("heights_mm = [150.0]", "off the flank"),
        ("heights_mm = [2.0]", "off the flank"),
        ("heights_mm = [20.0, 20.1]", "differ by less than 1 mm"),
        ("repeats = 0", "1 to 100"),
        ("drift_order = 100000", "drift_order 0 to 3"),
        ("positions = 5\nreferences = false\ndrift_order = 3", "does not separate the unknowns"),
        ("probe_angles_deg = [0, 45, 45]", "contains an angle twice"),
        ("monte_carlo_trials = 1", "too few for an uncertainty"),
        ("positions = 4", "choose positions = 8"),
        ("probe_angles_deg = [0, 50]", "not a multiple"),
    ] {
        let (code, said) = exit_code_and_error(&format!("{MACHINE_FILE}\n[method.self-calibration]\n{setting}\n"));
        assert_eq!(code, Some(1), "{setting}: {said}");
        assert!(said.contains(named) && said.contains("nothing has moved"), "{setting}: {said}");
    }
}

pub fn trials() -> Trials {
    trials![Pool::Waiting, 0;
        an_unknown_key_names_file_line_key_and_the_nearest,
        a_wrong_unit_names_the_right_one,
        a_rank_deficient_design_names_a_better_one,
        a_missing_port_is_reported,
        silent_and_garbled_ports_have_different_messages,
        usage_errors_exit_with_2,
        a_wrong_name_exits_with_2_and_lists_the_names,
        a_part_with_horizontal_axis_is_refused,
        tolerance_that_matches_no_parameter_is_named,
        settings_that_cannot_work_are_refused_before_motion,
    ]
}
