//! Tables whose axis has another letter than C, and tables that are upright only at some angle of another rotary
//! axis.

use super::machine_zero::{
    assert_within_expanded_u, machine_without_drift_and_linear_axis_errors, run_json, run_trued,
};
use crate::support::harness::{Pool, Trials, trials};

use serde_json::Value;
use toml::Table;

const B_ON_A_MACHINE: &str = include_str!("../../config/b-on-a.toml");
const SIMULATED_MACHINE: &str = include_str!("../../config/simulated.toml");

const RUN_ARGUMENTS: [&str; 3] = ["run", "self-calibration", "--json"];

/// Symbols of all parameters and functions of an estimate.
fn parameter_symbols(estimate: &Value) -> Vec<String> {
    let lists = ["parameters", "functions"].map(|key| estimate[key].as_array().unwrap());
    let symbols = lists.into_iter().flatten().map(|entry| entry["symbol"].as_str().unwrap());
    symbols.map(str::to_owned).collect()
}

/// At A = 90° the table's Z is along the machine's +Y. B is 2 mm from A, so it is then 2 mm further in Y.
fn b_on_a_table_is_measured_with_a_at_90_degrees() {
    for sense in ["iso", "reversed"] {
        let mut machine = machine_without_drift_and_linear_axis_errors(B_ON_A_MACHINE);
        machine["axes"]["B"]["positive"] = sense.into();
        let estimate = run_json(&machine, &RUN_ARGUMENTS);
        assert_within_expanded_u(&estimate, "EX0B", 40.0);
        assert_within_expanded_u(&estimate, "EY0B", -25.0);
        assert_within_expanded_u(&estimate, "X_B", 3.04);
        assert_within_expanded_u(&estimate, "Y_B", 7.0 - 0.025);
        let text = estimate.to_string();
        assert!(!text.contains("sense of"), "{text}");
        assert!(text.contains("X and Y of the machine with A at 90°"), "{text}");
        let symbols = parameter_symbols(&estimate);
        for symbol in ["EXB_total", "EYB", "EX0B_lsc"] {
            assert!(symbols.iter().any(|found| found == symbol), "no {symbol} in {symbols:?}");
        }
    }
}

fn tilt_of_b_on_a_table_is_found_at_two_heights() {
    let mut machine = machine_without_drift_and_linear_axis_errors(B_ON_A_MACHINE);
    machine["method"]["self-calibration"]
        .as_table_mut()
        .unwrap()
        .insert("heights_mm".to_owned(), vec![toml::Value::from(6.0), 18.0.into()].into());
    // A tilt about the table's Z: at A = 90° about the machine's Y.
    let errors = machine["simulated"]["errors"].as_table_mut().unwrap();
    errors.insert("EC0B_urad".to_owned(), 300.0.into());
    let estimate = run_json(&machine, &RUN_ARGUMENTS);
    assert_within_expanded_u(&estimate, "EA0B", 0.0);
    assert_within_expanded_u(&estimate, "EB0B", 300.0);
}

fn vertical_table_axis_named_a_is_measured() {
    let text = SIMULATED_MACHINE
        .replace("V[w-C-B-b-Y-X-Z-(C)-t]", "V[w-A-b-Y-X-Z-(C)-t]")
        .replace("[axes.C]", "[axes.A]\ndirection = [0.0, 0.0, 1.0]")
        .replace("EX0C", "EX0A")
        .replace("EY0C", "EY0A")
        .replace("\"EXC\"", "\"EXA\"")
        .replace("\"EYC\"", "\"EYA\"");
    let mut machine = machine_without_drift_and_linear_axis_errors(&text);
    machine["axes"].as_table_mut().unwrap().remove("B");
    machine["solid"].as_array_mut().unwrap().retain(|solid| solid["on"].as_str() != Some("B"));
    let estimate = run_json(&machine, &RUN_ARGUMENTS);
    assert_within_expanded_u(&estimate, "EX0A", 50.0);
    assert_within_expanded_u(&estimate, "EY0A", -30.0);
    let symbols = parameter_symbols(&estimate);
    assert!(!symbols.iter().any(|symbol| symbol.contains("XC")), "{symbols:?}");
}

#[track_caller]
fn assert_plan_is_refused(at: Option<&str>, why: &str, instead: &str) {
    let mut machine: Table = B_ON_A_MACHINE.parse().unwrap();
    let settings = machine["method"]["self-calibration"].as_table_mut().unwrap();
    settings.remove("at");
    if let Some(at) = at {
        settings.extend(at.parse::<Table>().unwrap());
    }
    let folder = tempfile::tempdir().unwrap();
    let output = run_trued(folder.path(), &machine, &["plan", "self-calibration"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains(why) && message.contains(instead), "{message}");
}

fn invalid_measuring_angles_are_refused_with_a_remedy() {
    let none = "no rotary axis that carries the workpiece is along Z with A at 0°, B at 0°";
    assert_plan_is_refused(None, none, "for example at = { A = 90.0 }");
    assert_plan_is_refused(Some("at = { A = 45.0 }"), "is along Z with A at 45°", "at = { A = 90.0 }");
    assert_plan_is_refused(Some("at = { A = 170.0 }"), "`at` contains A = 170", "within their limits");
    assert_plan_is_refused(Some("at = { C = 10.0 }"), "`at` contains C = 10", "rotary axes of [axes]");
}

/// The part is stated with all axes at zero.
fn a_part_that_is_not_upright_where_it_is_measured_is_refused() {
    let mut machine: Table = B_ON_A_MACHINE.parse().unwrap();
    machine["artefact"]["axis"] = [0.0, 0.0, 1.0].map(toml::Value::from).to_vec().into();
    let folder = tempfile::tempdir().unwrap();
    let output = run_trued(folder.path(), &machine, &["plan", "self-calibration"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("the axis of the part is along [0, 1, 0] of the machine"), "{message}");
}

pub fn trials() -> Trials {
    trials![Pool::Computing, 2;
        b_on_a_table_is_measured_with_a_at_90_degrees,
        tilt_of_b_on_a_table_is_found_at_two_heights,
        vertical_table_axis_named_a_is_measured,
        invalid_measuring_angles_are_refused_with_a_remedy,
        a_part_that_is_not_upright_where_it_is_measured_is_refused,
    ]
}
