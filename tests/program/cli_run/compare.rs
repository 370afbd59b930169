//! `trued compare`: two runs of one machine, and runs that cannot be compared.

use serde_json::Value;

use super::{MachineShop, assert_stderr_has, simulated_machine_toml, stderr, successful_json_output};

fn json_number(of: &Value, key: &str) -> f64 {
    of[key].as_f64().unwrap_or(f64::INFINITY)
}

/// Another seed is another machine; the numerical tests check the agreement.
pub fn two_runs_are_compared() {
    let shop = MachineShop::with_machine_file(&simulated_machine_toml());
    let first = successful_json_output(&shop.run_self_calibration());
    shop.replace_in_machine_file("seed = 1", "seed = 2");
    let second = successful_json_output(&shop.run_self_calibration());
    let compared = successful_json_output(&shop.run_trued(&["compare", "1", "2", "--json"]));
    let common = compared["common_sources"].as_array().unwrap();
    assert!(common.contains(&"probe lobing".into()) && !common.contains(&"resolution".into()));
    assert_eq!(compared["besides"][0], "the machine file was changed between the runs");
    let differences = compared["differences"].as_array().unwrap();
    assert_eq!(differences.len(), first["parameters"].as_array().unwrap().len());
    let value = |of: &Value| json_number(&of["parameters"][0], "value");
    let difference = &differences[0];
    assert!((json_number(difference, "by") - (value(&second) - value(&first))).abs() < 1e-9);
    let expected = json_number(difference, "by").abs() / json_number(difference, "U");
    assert!((json_number(difference, "E_n") - expected).abs() < 1e-9 && expected > 0.0);
    let functions = compared["functions"].as_array().unwrap();
    assert!(functions.iter().any(|function| function["symbol"] == "EXC"));
    let table = shop.run_trued(&["compare", "1", "2"]);
    let table = String::from_utf8(table.stdout).unwrap();
    for words in ["E_X0C", "E_n", "E_XC ", "common sources of uncertainty: ", "probe lobing", "at 0°"] {
        assert!(table.contains(words), "{words} in {table}");
    }
}

pub fn incomparable_runs_are_refused_with_advice() {
    let shop = MachineShop::with_machine_file(&simulated_machine_toml());
    successful_json_output(&shop.run_self_calibration());
    let refused = |other: &str| {
        let output = shop.run_trued(&["compare", "1", other]);
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        output
    };
    assert_stderr_has(&refused("7"), &["the journal has no run 7", "→"]);
    successful_json_output(&shop.run_trued(&["run", "latch-delay", "--json", "--machine", &shop.machine_path()]));
    assert_stderr_has(&refused("2"), &["run 2 by latch-delay", "choose two runs with common parameters"]);
    // A run compared with itself: no differences.
    let same = shop.run_trued(&["compare", "1", "1"]);
    let same = String::from_utf8(same.stdout).unwrap();
    assert!(!same.contains("differs") && same.contains("parameters agree"), "{same}");
}
