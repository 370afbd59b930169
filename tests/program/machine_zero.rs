//! Machines whose zero is in a corner, as with a homed grblHAL with soft limits: travel from 0 to the negative
//! side, rotary axes far from zero.

use crate::support::harness::{Pool, Trials, trials};
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;
use toml::Table;

const GRBLHAL_MACHINE: &str = include_str!("../../config/grblhal-serial.toml");
const SIMULATED_MACHINE: &str = include_str!("../../config/simulated.toml");
const LASER_MACHINE: &str = include_str!("../../config/laser.toml");
const SAMBA_MACHINE: &str = include_str!("../../config/samba.toml");

pub fn run_trued(folder: &Path, machine: &Table, arguments: &[&str]) -> Output {
    let path = folder.join("machine.toml");
    std::fs::write(&path, toml::to_string(machine).unwrap()).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
    command.args(arguments).arg("--machine").arg(path).output().unwrap()
}

/// JSON output of the program. Exit code 3 is allowed: the verdict is `fail`.
#[track_caller]
pub fn run_json(machine: &Table, arguments: &[&str]) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("state");
    let mut arguments = arguments.to_vec();
    if arguments[0] == "run" {
        arguments.extend(["--speed", "fast", "--state", state.to_str().unwrap()]);
    }
    let output = run_trued(folder.path(), machine, &arguments);
    let messages = String::from_utf8_lossy(&output.stderr);
    assert!(matches!(output.status.code(), Some(0 | 3)), "{arguments:?}: {messages}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Value and expanded uncertainty U of a parameter.
#[track_caller]
fn value_and_expanded_u(estimate: &Value, symbol: &str) -> [f64; 2] {
    let parameters = estimate["parameters"].as_array().unwrap();
    let found = parameters.iter().find(|parameter| parameter["symbol"] == symbol);
    let found = found.unwrap_or_else(|| panic!("no {symbol} in {parameters:#?}"));
    ["value", "U"].map(|key| found[key].as_f64().unwrap())
}

#[track_caller]
pub fn assert_within_expanded_u(estimate: &Value, symbol: &str, truth: f64) {
    let [value, u] = value_and_expanded_u(estimate, symbol);
    println!("{symbol} {value} ± {u}, true {truth}");
    assert!((value - truth).abs() <= u, "{symbol}: {value} ± {u}, true {truth}");
}

/// The machine without drift and without errors of X, Y and Z: in machine coordinates the rotary axis is at the
/// position in the file.
pub fn machine_without_drift_and_linear_axis_errors(machine: &str) -> Table {
    let mut machine: Table = machine.parse().unwrap();
    machine["machine"]["drift_um_per_h"] = 0.0.into();
    for axis in ["X", "Y", "Z"] {
        machine["axes"][axis]["error_motion_um"] = 0.0.into();
    }
    machine
}

/// config/grblhal-serial.toml with the simulated grblHAL, its C axis stated at `stated` and truly at X -149.95, Y
/// -100.03 mm.
fn machine_with_stated_c_axis_position(stated: [f64; 2]) -> Table {
    let mut machine = machine_without_drift_and_linear_axis_errors(GRBLHAL_MACHINE);
    machine["controller"] = Table::from_iter([("kind".into(), "simulated".into())]).into();
    let point = [stated[0], stated[1], -265.0].map(toml::Value::from).to_vec();
    machine["axes"]["C"]["point_mm"] = point.into();
    for (key, true_mm, stated_mm) in [("EX0C_um", -149.95, stated[0]), ("EY0C_um", -100.03, stated[1])] {
        machine["simulated"]["errors"][key] = ((true_mm - stated_mm) * 1e3).into();
    }
    machine
}

fn c_axis_offset_is_relative_to_its_stated_position() {
    let estimate =
        run_json(&machine_with_stated_c_axis_position([-150.0, -100.0]), &["run", "self-calibration", "--json"]);
    assert_within_expanded_u(&estimate, "EX0C", 50.0);
    assert_within_expanded_u(&estimate, "EY0C", -30.0);
    assert_within_expanded_u(&estimate, "X_C", -149.95);
    assert_within_expanded_u(&estimate, "Y_C", -100.03);

    let found = ["X_C", "Y_C"].map(|symbol| value_and_expanded_u(&estimate, symbol)[0]);
    let corrected = run_json(&machine_with_stated_c_axis_position(found), &["run", "self-calibration", "--json"]);
    assert_within_expanded_u(&corrected, "EX0C", 0.0);
    assert_within_expanded_u(&corrected, "EY0C", 0.0);
    assert_within_expanded_u(&corrected, "X_C", -149.95);
    assert_within_expanded_u(&corrected, "Y_C", -100.03);
    let rounded = (value_and_expanded_u(&corrected, "X_C")[0] * 1e4).round() / 1e4;
    let line = format!("measured [{rounded}, ");
    let gauge = corrected["gauge"].to_string();
    assert!(gauge.contains(&line), "{line} is not in {gauge}");
}

/// The machine with its zero moved by `zero` (X, Y, Z): positions on the table count from the new zero.
fn machine_with_moved_zero(machine: &str, zero: [f64; 3]) -> Table {
    let mut machine: Table = machine.parse().unwrap();
    let number = |value: &toml::Value| value.as_float().or(value.as_integer().map(|integer| integer as f64)).unwrap();
    let shifted = |point: Option<&toml::Value>| -> toml::Value {
        let old = |i: usize| point.map_or(0.0, |point| number(&point[i]));
        let new: Vec<toml::Value> = (0..3).map(|i| (old(i) - zero[i]).into()).collect();
        new.into()
    };
    for (name, axis) in machine["axes"].as_table_mut().unwrap() {
        if let Some(i) = ["X", "Y", "Z"].iter().position(|linear| linear == name) {
            for end in ["min", "max"] {
                axis[end] = (number(&axis[end]) - zero[i]).into();
            }
        } else if name != "S" {
            let point = shifted(axis.get("point_mm"));
            axis.as_table_mut().unwrap().insert("point_mm".to_owned(), point);
        }
    }
    for solid in machine["solid"].as_array_mut().unwrap() {
        if solid["on"].as_str() != Some("spindle") {
            solid["from_mm"] = shifted(solid.get("from_mm"));
            solid["to_mm"] = shifted(solid.get("to_mm"));
        }
    }
    let artefact = &mut machine["artefact"];
    match artefact.get_mut("balls") {
        Some(balls) => balls.as_array_mut().unwrap().iter_mut().for_each(|ball| {
            ball["centre_mm"] = shifted(ball.get("centre_mm"));
        }),
        None => artefact["centre_mm"] = shifted(artefact.get("centre_mm")),
    }
    machine
}

/// A plan has the same positions on table and part for every zero of the linear axes.
fn planned_positions_move_with_the_machine_zero() {
    let cases = [
        ("self-calibration", SIMULATED_MACHINE, [250.0, 250.0, 450.0]),
        ("latch-delay", SIMULATED_MACHINE, [250.0, 250.0, 450.0]),
        ("laser-r-test", LASER_MACHINE, [210.0, 105.0, 420.0]),
    ];
    for (method, machine, corner) in cases {
        let arguments = ["plan", method, "--json"];
        let [middle, moved] = [[0.0; 3], corner].map(|zero| {
            run_json(&machine_with_moved_zero(machine, zero), &arguments)["steps"].as_array().unwrap().clone()
        });
        assert_eq!(middle.len(), moved.len(), "{method}");
        for (one, other) in middle.iter().zip(&moved) {
            assert_eq!(one["label"], other["label"], "{method}");
            for end in ["from", "to"] {
                for (axis, value) in one[end].as_object().unwrap() {
                    let i = ["X", "Y", "Z"].iter().position(|linear| linear == axis);
                    let expected = value.as_f64().unwrap() - i.map_or(0.0, |i| corner[i]);
                    let off = (other[end][axis].as_f64().unwrap() - expected).abs();
                    assert!(off < 1e-9, "{method}, {}: {axis} is off by {off}", one["label"]);
                }
            }
        }
    }
}

/// Gains and squareness count from the zero of X, Y and Z, so the indexations may differ.
fn samba_plan_has_equal_step_count_with_corner_zero() {
    let steps = |zero| {
        let plan = run_json(&machine_with_moved_zero(SAMBA_MACHINE, zero), &["plan", "samba", "--json"]);
        plan["steps"].as_array().unwrap().len()
    };
    assert_eq!(steps([400.0, 400.0, 760.0]), steps([0.0; 3]));
}

/// The paper's own estimator, for comparison, also counts from the intersection of B and C.
fn laser_r_test_is_near_the_truth_with_corner_zero() {
    let settings = "[method.laser-r-test]\nmonte_carlo_trials = 100\ntilt_deg = [-60.0, 0.0, 60.0]\n\
                    turn_deg = [0.0, 120.0, 240.0]\npoints = 9\nsamples = 4\n";
    let machine = machine_with_moved_zero(&format!("{LASER_MACHINE}\n{settings}"), [210.0, 105.0, 420.0]);
    let estimate = run_json(&machine, &["run", "laser-r-test", "--json"]);
    for (symbol, truth) in [("EB0B", -42.0), ("EX0C", -1.0), ("EA0C", 5.2)] {
        let [value, u] = value_and_expanded_u(&estimate, symbol);
        assert!((value - truth).abs() <= 2.0 * u, "{symbol}: {value} ± {u}, true {truth}");
    }
    let gauge = estimate["gauge"].to_string();
    let paper = gauge.split("EX0C ").last().unwrap().split(' ').next().unwrap();
    assert!(paper.parse::<f64>().unwrap().abs() < 10.0, "EX0C {paper} um by the paper in {gauge}");
}

pub fn trials() -> Trials {
    trials![Pool::Computing, 3;
        c_axis_offset_is_relative_to_its_stated_position,
        planned_positions_move_with_the_machine_zero,
        samba_plan_has_equal_step_count_with_corner_zero,
        laser_r_test_is_near_the_truth_with_corner_zero,
    ]
}
