//! Whole runs of the method `latch-delay` by the real program: proof, wire, journal, report.

use crate::support::harness::{Pool, Trials, trials};
use std::process::{Command, Output};

use serde_json::Value;

const MACHINE_FILE: &str = include_str!("../../config/simulated.toml");

fn run_trued(state: &std::path::Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
    command.arg("--state").arg(state).args(arguments).output().unwrap()
}

/// Estimate of a run of the built-in machine with `wire` in place of its own and with the additional `truth`.
fn run_latch_delay(wire: &str, truth: &str) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let machine =
        MACHINE_FILE.replace("wire = \"memory\"", wire).replace("[simulated]\n", &format!("[simulated]\n{truth}\n"));
    let file = folder.path().join("machine.toml");
    std::fs::write(&file, machine).unwrap();
    let report = folder.path().join("report.html");
    let report = report.to_str().unwrap();
    let arguments = ["run", "latch-delay", "--machine", file.to_str().unwrap(), "--json", "--report", report];
    let ran = run_trued(folder.path(), &arguments);
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let page = std::fs::read_to_string(report).unwrap();
    assert!(page.contains(">latch</sub>") && page.contains("ms</td>"));
    serde_json::from_slice(&ran.stdout).unwrap()
}

/// Value and expanded uncertainty of a parameter, and whether it is identifiable.
fn value_expanded_u_and_is_identifiable(estimate: &Value, symbol: &str) -> (f64, f64, bool) {
    let all = estimate["parameters"].as_array().unwrap();
    let found = all.iter().find(|parameter| parameter["symbol"] == symbol).unwrap();
    let number = |key: &str| found[key].as_f64().unwrap();
    (number("value"), number("U"), found["identifiable"].as_bool().unwrap())
}

fn latch_delay_over_grbl_is_within_u_of_the_truth() {
    let estimate = run_latch_delay("wire = \"pty\"", "latch = { delay_ms = 4.0 }");
    let (delay, expanded, _) = value_expanded_u_and_is_identifiable(&estimate, "t_latch");
    assert!((delay - 4.0).abs() <= expanded && expanded < 0.3, "{delay} {expanded}");
    assert!(!value_expanded_u_and_is_identifiable(&estimate, "T_scan").2);
}

/// The simulated control of the line window, whose contacts are latched by a PLC scan from the second line on.
fn plc_scan_time_and_latch_delay_over_modbus_are_within_u() {
    let wire = "speaks = \"modbus\"\nwire = \"tcp\"";
    let fault = "[[simulated.fault]]\nkind = \"slow-latch\"\n";
    let machine = MACHINE_FILE.replace("wire = \"memory\"", wire);
    assert_ne!(machine, MACHINE_FILE);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("machine.toml");
    std::fs::write(&file, format!("{machine}\n{fault}")).unwrap();
    let arguments = ["run", "latch-delay", "--machine", file.to_str().unwrap(), "--json"];
    let ran = run_trued(folder.path(), &arguments);
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let estimate: Value = serde_json::from_slice(&ran.stdout).unwrap();
    let (scan, expanded, seen) = value_expanded_u_and_is_identifiable(&estimate, "T_scan");
    assert!(seen && (scan - 10.0).abs() <= expanded, "{scan} {expanded}");
    let (delay, expanded, _) = value_expanded_u_and_is_identifiable(&estimate, "t_latch");
    assert!((delay - 5.0).abs() <= expanded, "{delay} {expanded}");
}

pub fn trials() -> Trials {
    trials![Pool::Computing, 5;
        latch_delay_over_grbl_is_within_u_of_the_truth,
        plc_scan_time_and_latch_delay_over_modbus_are_within_u,
    ]
}
