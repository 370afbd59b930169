//! A run with an estimate, stored without a measurement.

use std::path::Path;

use machine::record::estimate::Estimate;
use serde_json::json;
use trued::setup::{self, MachineFile};
use trued::store::{Journal, NewRun, RunState};

/// C is at (50, −30) µm, U = 1 µm.
pub fn store_run(folder: &Path, file: &MachineFile) {
    store_run_with(folder, file, "self-calibration", &[("EX0C", "um", 50.0), ("EY0C", "um", -30.0)]);
}

/// Each value with u = 0.5; errors of position are valid at (0, 0, 90) mm.
pub fn store_run_with(folder: &Path, file: &MachineFile, method: &str, values: &[(&str, &str, f64)]) {
    store_run_at(folder, file, method, [0.0, 0.0, 90.0], values);
}

/// As [`store_run_with`], with errors of position that are valid at `at_mm`.
pub fn store_run_at(folder: &Path, file: &MachineFile, method: &str, at_mm: [f64; 3], values: &[(&str, &str, f64)]) {
    let journal = Journal::open(folder).unwrap();
    let plan = setup::plan_without_steps(file, method, json!({}));
    let new = NewRun { machine_file_text: file.text().to_owned(), plan };
    let run = journal.begin_run(&new).wait().unwrap();
    let parameter = |(symbol, unit, value): &(&str, &str, f64)| {
        json!({"symbol": symbol, "value": value, "unit": unit, "u": 0.5, "U": 1.0, "k": 2.0, "dof": null,
            "identifiable": true})
    };
    let symbols: Vec<&str> = values.iter().map(|(symbol, ..)| *symbol).collect();
    let row = |i: usize| (0..symbols.len()).map(|j| if i == j { 0.25 } else { 0.0 }).collect::<Vec<f64>>();
    let rows: Vec<Vec<f64>> = (0..symbols.len()).map(row).collect();
    let estimate: Estimate = serde_json::from_value(json!({
        "trued_estimate": 1, "method": method, "functions": [], "rank": 2, "unknowns": 2,
        "parameters": values.iter().map(parameter).collect::<Vec<_>>(),
        "covariance": {"symbols": symbols, "rows": rows}, "condition": 1.0,
        "gauge": [], "not_identifiable": [], "residual_rms_um": 0.1, "degrees_of_freedom": 10, "chi2_per_dof": 1.0,
        "verdict": "none", "warnings": [], "priors": [], "location_at_mm": at_mm,
        "measured": {"X": [-60.0, 60.0], "Y": [-60.0, 60.0], "Z": [90.0, 90.0], "B": [0.0, 0.0], "C": [0.0, 315.0]},
    }))
    .unwrap();
    journal.add_estimate(run, &estimate).wait().unwrap();
    journal.set_state(run, RunState::Finished).wait().unwrap();
}
