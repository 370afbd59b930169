//! `trued combine`: several runs of the simulated machine become one estimate of the newest of them.

use serde_json::Value;

use crate::support::harness::{Pool, Trials, trials};
use crate::support::machine_shop::{MachineShop, built_in_machine_text, stderr};

fn stdout(output: &std::process::Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// A shop with two runs of a self-calibration of the same machine; the part is at another place in the second.
fn shop_with_two_runs() -> MachineShop {
    let shop = MachineShop::with_machine_file(&built_in_machine_text());
    assert_eq!(shop.run_self_calibration().status.code(), Some(0));
    shop.replace_in_machine_file("centre_offset_mm = [0.8, -0.5]", "centre_offset_mm = [-0.7, 0.9]");
    assert_eq!(shop.run_self_calibration().status.code(), Some(0));
    shop
}

fn parameter<'a>(estimate: &'a Value, symbol: &str) -> &'a Value {
    let parameters = estimate["parameters"].as_array().unwrap();
    parameters.iter().find(|own| own["symbol"] == symbol).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

fn combination_is_the_estimate_of_the_newest_run() {
    let shop = shop_with_two_runs();
    let own = [1, 2].map(|run: i32| shop.run_json(&["show", &run.to_string(), "--json"]));
    let output = shop.run_trued(&["combine", "2", "1"]);
    let text = stdout(&output);
    assert_eq!(output.status.code(), Some(0), "{text}{}", stderr(&output));
    assert!(text.contains("shared source of uncertainty: stylus offset (runs 1, 2; same value in each run)"), "{text}");
    assert!(text.contains("the runs agree") && text.contains("stored as the estimate of run 2"), "{text}");
    let combined = shop.run_json(&["show", "2", "--json"]);
    assert_eq!(combined["provenance"]["combined_runs"], serde_json::json!([1, 2]));
    let [first, second, both] = [&own[0], &own[1], &combined].map(|estimate| parameter(estimate, "EX0C"));
    assert!((number(&both["value"]) - 50.0).abs() <= number(&both["U"]), "{both}");
    // The stylus offset of about 0.3 µm is common, the touches are not.
    let least = first["u"].as_f64().unwrap().min(number(&second["u"])) / 2f64.sqrt();
    assert!(number(&both["u"]) > least && number(&both["u"]) < number(&first["u"]), "{both} {first}");
    let shown = shop.run_trued(&["show", "2", "--report", &shop.path_text("report.html")]);
    assert_eq!(shown.status.code(), Some(0), "{}", stderr(&shown));
    assert!(stdout(&shown).contains("combination of the runs 1, 2"));
    std::fs::write(shop.path("combined.json"), combined.to_string()).unwrap();
    let predicted = shop.run_trued(&["predict", &shop.path_text("combined.json"), "--machine", &shop.machine_path()]);
    assert_eq!(predicted.status.code(), Some(0), "{}", stderr(&predicted));
    let compared = shop.run_trued(&["compare", "1", "2"]);
    assert!(stdout(&compared).contains("the estimate of run 2 combines the runs 1, 2"), "{}", stdout(&compared));
    // The trend has the values of the runs, and a new identification gives the run its own estimate back.
    let trend = shop.run_json(&["trend", "--json"]);
    let series = trend.as_array().unwrap().iter().find(|series| series["symbol"] == "EX0C").unwrap();
    assert_eq!(series["values"][1]["value"], second["value"]);
    shop.run_json(&["identify", "self-calibration", "--run", "2", "--json"]);
    assert_eq!(shop.run_json(&["show", "2", "--json"])["parameters"], own[1]["parameters"]);
}

fn contradicting_runs_are_named_and_unusable_runs_refused() {
    let shop = shop_with_two_runs();
    shop.replace_in_machine_file("EX0C_um = 50.0", "EX0C_um = 70.0");
    assert_eq!(shop.run_self_calibration().status.code(), Some(0));
    let output = shop.run_trued(&["combine", "1", "2", "3", "--json"]);
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    let combination: Value = serde_json::from_slice(&output.stdout).unwrap();
    let disagreeing = combination["consistency"]["disagreeing_runs"].as_array().unwrap();
    assert_eq!((disagreeing.len(), &disagreeing[0]["deviation"]["run"]), (1, &Value::from(3)));
    assert_eq!(disagreeing[0]["deviation"]["symbol"], "EX0C");
    assert_eq!(combination["estimate"]["verdict"], "undecided (model)");
    // The run keeps its own estimate.
    let kept = shop.run_json(&["show", "3", "--json"]);
    assert!(kept["verdict"] != "undecided (model)" && kept["provenance"]["combined_runs"].is_null(), "{kept}");
    let warning = combination["estimate"]["warnings"][0].as_str().unwrap();
    assert!(warning.starts_with("run 3 contradicts the combination of the runs 1, 2: EX0C deviates by"), "{warning}");
    shop.replace_in_machine_file("# point_mm = [0.0, 0.0, 0.0]", "point_mm = [0.05, 0.0, 0.0]");
    assert_eq!(shop.run_self_calibration().status.code(), Some(0));
    let refused = |runs: &[&str], words: &str| {
        let output = shop.run_trued(&[&["combine"], runs].concat());
        assert!(matches!(output.status.code(), Some(1 | 2)) && output.stdout.is_empty(), "{words}");
        assert!(stderr(&output).contains(words), "{}", stderr(&output));
    };
    refused(&["1"], "RUN");
    refused(&["1", "1"], "run 1 is listed twice");
    refused(&["1", "9"], "run 9");
    refused(&["1", "4"], "run 4 and run 1 state the position, direction or sense of an axis differently");
}

pub fn trials() -> Trials {
    trials![Pool::Waiting, 0;
        combination_is_the_estimate_of_the_newest_run,
        contradicting_runs_are_named_and_unusable_runs_refused,
    ]
}
