//! The results of a run, and their reproduction from stored data.

use std::path::Path;

use serde_json::Value;

use super::{
    MachineShop, assert_stderr_has, machine_toml_with_control, simulated_machine_toml, stderr, successful_json_output,
};
use crate::support::grbl_control::GrblControl;

pub fn exported_readings_give_the_stored_estimate() {
    let shop = MachineShop::with_machine_file(&simulated_machine_toml());
    let run = shop.run_self_calibration();
    assert_eq!(run.status.code(), Some(0), "{}", stderr(&run));
    assert_eq!(shop.exported_reading_steps().len(), 69);
    let file = |name: &str| shop.path_text(&format!("export/run-1-{name}"));
    let again = shop.run_trued(&[
        "identify",
        "self-calibration",
        "--json",
        "--machine",
        &file("machine.toml"),
        "--plan",
        &file("plan.json"),
        "--readings",
        &file("readings.csv"),
    ]);
    assert_eq!(again.status.code(), Some(0), "{}", stderr(&again));
    let stored = std::fs::read_to_string(file("estimate.json")).unwrap();
    let run = String::from_utf8(run.stdout).unwrap();
    assert_eq!(stored.trim(), run.trim(), "the stored estimate is not what was printed");
    assert_eq!(String::from_utf8(again.stdout).unwrap(), run);
    let shown = shop.run_trued(&["show", "1", "--json"]);
    assert_eq!(String::from_utf8(shown.stdout).unwrap(), run);
}

/// Without any declared source, U(EX0C) is at most 3 µm.
pub fn undeclared_sources_are_assumed_and_marked() {
    let sources = [
        "drift_um_per_h",
        "squareness_urad",
        "resolution_um",
        "error_motion_um",
        "backlash_um",
        "lobing_um",
        "lobing_orders",
        "stylus_offset_um",
    ];
    let is_taken_out = |line: &&str| !sources.iter().any(|key| line.starts_with(key));
    let silent: String =
        simulated_machine_toml().lines().filter(is_taken_out).map(|line| format!("{line}\n")).collect();
    let shop = MachineShop::with_machine_file(&silent);
    let estimate = successful_json_output(&shop.run_self_calibration());
    let found = &estimate["parameters"][0];
    assert_eq!(found["symbol"], "EX0C");
    let expanded = found["U"].as_f64().unwrap();
    assert!(expanded > 1.0 && expanded <= 3.0, "{expanded}");
    let budget = found["budget"].as_array().unwrap();
    let is_assumed = |line: &&Value| line["assumed"] == true;
    let assumed = budget.iter().filter(is_assumed).map(|line| line["source"].as_str().unwrap());
    let wanted = [
        "resolution",
        "stylus offset",
        "probe lobing",
        "backlash",
        "error motions of X, Y and Z",
        "error motions of C",
    ];
    assert_eq!(assumed.collect::<Vec<_>>(), wanted);
    let report = shop.path_text("report.html");
    assert!(shop.run_trued(&["show", "1", "--report", &report]).status.success());
    let report = std::fs::read_to_string(report).unwrap();
    assert!(report.contains("probe lobing (assumed)"), "{report}");
    let plan = shop.run_trued(&["plan", "self-calibration", "--machine", &shop.machine_path()]);
    let plan = String::from_utf8(plan.stdout).unwrap();
    assert!(plan.contains("assumed") && plan.contains("axes.X.backlash_um"), "{plan}");
}

pub fn self_calibration_at_two_heights_finds_axis_tilts() {
    let settings = "positions = 12\nheights_mm = [20, 80]\n";
    let errors = "[simulated.errors]\nEA0C_urad = 40.0\nEB0C_urad = -25.0";
    let file = simulated_machine_toml().replace("[simulated.errors]", errors) + settings;
    let estimate = successful_json_output(&MachineShop::with_machine_file(&file).run_self_calibration());
    for (symbol, truth) in [("EA0C", 40.0), ("EB0C", -25.0)] {
        let found = estimate["parameters"].as_array().unwrap();
        let found = found.iter().find(|p| p["symbol"] == symbol).unwrap();
        let number = |key: &str| found[key].as_f64().unwrap();
        assert_eq!(found["unit"], Value::from("urad"));
        let (off, expanded) = (number("value") - truth, number("U"));
        assert!(off.abs() < expanded && expanded < 25.0, "{symbol}: off by {off}, U {expanded}");
    }
}

pub fn spindle_orientation_without_template_is_refused() {
    let follows = simulated_machine_toml() + "spindle = \"follow\"\n";
    let bench = GrblControl::start(&follows);
    // A plain grbl has no word to orient the spindle.
    let control = format!("kind = \"grbl\"\ntcp = \"{}\"", bench.address);
    let shop = MachineShop::with_machine_file(&machine_toml_with_control(&follows, &control));
    let refused = shop.run_self_calibration();
    assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
    assert_stderr_has(&refused, &["no template `orient`", "nothing has moved", "spindle = \"fixed\""]);
    assert_eq!(shop.run_states(), ["failed"]);
    assert!(shop.exported_reading_steps().is_empty());
}

pub fn a_stored_run_is_identified_again_and_keeps_its_first_estimate() {
    let shop = MachineShop::with_machine_file(&simulated_machine_toml());
    let first = shop.run_self_calibration();
    let tight = simulated_machine_toml() + "[tolerance]\nEX0C_um = 1.0\n";
    std::fs::write(shop.path_text("tight.toml"), tight).unwrap();
    let again = shop.run_trued(&["identify", "self-calibration", "--run", "1", "--json"]);
    assert_eq!(again.stdout, first.stdout, "{}", stderr(&again));
    let tight = shop.path_text("tight.toml");
    let judged = shop.run_trued(&["identify", "self-calibration", "--run", "1", "--json", "--machine", &tight]);
    // The axis is 50 µm off: far beyond the tolerance of 1 µm.
    assert_eq!(judged.status.code(), Some(3), "{}", stderr(&judged));
    let journal = trued::store::Journal::open(Path::new(&shop.path_text("state"))).unwrap();
    let stored = journal.load_run(trued::store::RunId(1)).unwrap();
    let verdicts: Vec<_> = stored.estimates.iter().map(|e| e.estimate.verdict).collect();
    use machine::record::estimate::Verdict;
    assert_eq!(verdicts, [Verdict::None, Verdict::None, Verdict::Fail]);
}
