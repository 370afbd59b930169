//! Repeatability of the passes of a run, and of several runs.

use serde_json::Value;

use super::{MachineShop, assert_stderr_has, simulated_machine_toml, stderr, successful_json_output};

/// Value of each parameter of an estimate, by symbol.
fn parameter_values(estimate: &Value) -> Vec<(String, f64)> {
    let parameters = estimate["parameters"].as_array().unwrap().iter();
    parameters.map(|one| (one["symbol"].as_str().unwrap().to_owned(), one["value"].as_f64().unwrap())).collect()
}

/// Identifies the readings of one pass of run 1 from its exported files: the rows of this pass, and those of the steps
/// that were measured once.
fn identify_exported_pass(shop: &MachineShop, pass: &str, passes: usize) -> Vec<(String, f64)> {
    let csv = std::fs::read_to_string(shop.path("export/run-1-readings.csv")).unwrap();
    let fields = |line: &str| -> Vec<String> { line.split(',').map(str::to_owned).collect() };
    let is_reading = |line: &&str| line.starts_with(|first: char| first.is_ascii_digit());
    let step_count = |step: &str| csv.lines().filter(|line| line.split(',').next() == Some(step)).count();
    let mut rows = String::new();
    for line in csv.lines() {
        let mut row = fields(line);
        let is_repeated = is_reading(&line) && step_count(&row[0]) >= passes;
        if is_repeated && row[1] != pass {
            continue;
        }
        if is_repeated {
            "0".clone_into(&mut row[1]);
        }
        rows += &format!("{}\n", row.join(","));
    }
    std::fs::write(shop.path("pass.csv"), rows).unwrap();
    let mut plan: Value =
        serde_json::from_str(&std::fs::read_to_string(shop.path("export/run-1-plan.json")).unwrap()).unwrap();
    plan["settings"]["repeats"] = 1.into();
    std::fs::write(shop.path("plan.json"), plan.to_string()).unwrap();
    let [readings, plan, machine] =
        ["pass.csv", "plan.json", "export/run-1-machine.toml"].map(|name| shop.path_text(name));
    let arguments = ["identify", "self-calibration", "--json", "--readings", &readings, "--plan", &plan];
    parameter_values(&successful_json_output(&shop.run_trued(&[&arguments[..], &["--machine", &machine]].concat())))
}

/// The table of five passes agrees with five identifications of the exported readings.
pub fn passes_of_a_run_give_their_repeatability() {
    let shop = MachineShop::with_machine_file(&simulated_machine_toml());
    let machine = shop.machine_path();
    let run = shop.run_trued(&["run", "self-calibration", "--repeat", "5", "--machine", &machine]);
    let printed = String::from_utf8_lossy(&run.stdout).into_owned();
    assert!(run.status.success(), "{}", stderr(&run));
    assert!(
        printed.contains("repeatability of self-calibration on simulated five-axis machine: 5 passes"),
        "{printed}"
    );
    shop.exported_reading_steps();
    let passes = ["0", "1", "2", "3", "4"].map(|pass| identify_exported_pass(&shop, pass, 5));
    let table = successful_json_output(&shop.run_trued(&["repeatability", "1", "--json"]));
    assert_eq!((&table["repeated"], &table["parameters"][0]["symbol"]), (&Value::from("passes"), &Value::from("EX0C")));
    for row in table["parameters"].as_array().unwrap() {
        let value_in = |pass: &Vec<(String, f64)>| pass.iter().find(|one| row["symbol"] == one.0.as_str()).unwrap().1;
        let values: Vec<f64> = passes.iter().map(value_in).collect();
        let mean = values.iter().sum::<f64>() / 5.0;
        let squares: f64 = values.iter().map(|value| value * value).sum();
        let scatter = ((squares - 5.0 * mean * mean).max(0.0) / 4.0).sqrt();
        let [shown_mean, shown_scatter] = ["mean", "between"].map(|key| row[key].as_f64().unwrap());
        assert!((shown_mean - mean).abs() < 1e-6 && (shown_scatter - scatter).abs() < 1e-4, "{row} {values:?}");
        assert!(shown_scatter > 0.0 && row["repetitions"] == 5, "{row}");
    }
    let row = &table["parameters"][0];
    assert_eq!(row["per_kelvin"][0]["thermometer"], "spindle");
    assert!(row["per_hour"]["U"].as_f64().unwrap() > 0.0, "{row}");
    // The scatter of EX0C is that of the touches, which are 0.5 µm each: smaller than u, which has further sources.
    assert!(row["ratio"].as_f64().unwrap() < 1.5, "{row}");
}

pub fn runs_give_their_repeatability() {
    let shop = MachineShop::with_machine_file(&simulated_machine_toml());
    for _ in 0..2 {
        assert!(shop.run_self_calibration().status.success());
    }
    let table = successful_json_output(&shop.run_trued(&["repeatability", "1", "2", "--json"]));
    assert_eq!((&table["repeated"], &table["parameters"][0]["repetitions"]), (&Value::from("runs"), &Value::from(2)));
    // The same seed gives the same readings, and two runs determine no slope.
    assert_eq!((&table["parameters"][0]["between"], &table["parameters"][0]["per_hour"]), (&0.0.into(), &Value::Null));
    let single = shop.run_trued(&["repeatability", "1"]);
    assert_stderr_has(&single, &["run 1 has fewer than two complete passes", "--repeat 5"]);
    assert_stderr_has(&shop.run_trued(&["repeatability", "1", "1"]), &["run 1 is listed twice"]);
    assert_stderr_has(&shop.run_trued(&["repeatability", "1", "9"]), &["9"]);
    let other = shop.run_trued(&["run", "latch-delay"]);
    assert!(other.status.success(), "{}", stderr(&other));
    assert_stderr_has(&shop.run_trued(&["repeatability", "1", "3"]), &["run 3 has another method or another machine"]);
}
