//! Residuals of a run on a machine with a drift that the model does not contain.

use std::collections::BTreeMap;

use serde_json::Value;

use crate::support::harness::{Pool, Trials, trials};
use crate::support::machine_shop::{MachineShop, built_in_machine_text};

pub fn trials() -> Trials {
    trials![Pool::Computing, 0; figure_shows_a_drift_without_model]
}

/// A reference touch in +X at C 0°.
struct ReferenceTouch {
    t_min: f64,
    x_mm: f64,
    residual_um: f64,
}

/// Positions (x, y) of the marks of the figure: points of a path with round ends, such as `M218,53h0`.
fn mark_positions(figure: &str) -> Vec<[f64; 2]> {
    let path = figure.split("stroke-linecap=\"round\" d=\"").nth(1).unwrap().split('"').next().unwrap();
    let position = |mark: &str| -> [f64; 2] {
        let (x, y) = mark.strip_suffix("h0").unwrap().split_once(',').unwrap();
        [x, y].map(|number| number.parse().unwrap())
    };
    path.split('M').skip(1).map(position).collect()
}

/// Touches of one run in the same direction differ by the drift alone, because the model without drift is the same for
/// all of them: the differences of their residuals are those of the positions in the readings file.
pub fn figure_shows_a_drift_without_model() {
    let drifting = built_in_machine_text().replace("drift_um_per_h = 5.0", "drift_um_per_h = 200.0");
    let settings = "\n[method.self-calibration]\ndrift_order = 0\nmonte_carlo_trials = 100\n";
    let shop = MachineShop::with_machine_file(&format!("{drifting}{settings}"));
    let output = shop.run_self_calibration();
    let estimate: Value = serde_json::from_slice(&output.stdout).unwrap();
    let checks = estimate["smallest_found"].as_array().unwrap();
    let residuals: BTreeMap<&str, f64> =
        checks.iter().map(|check| (check["label"].as_str().unwrap(), check["residual_um"].as_f64().unwrap())).collect();
    assert!(shop.run_trued(&["export", "1", "--to", &shop.path_text("out")]).status.success());
    let read = |name: &str| std::fs::read_to_string(shop.path("out").join(name)).unwrap();
    let plan: Value = serde_json::from_str(&read("run-1-plan.json")).unwrap();
    let labels: Vec<&str> = plan["steps"].as_array().unwrap().iter().map(|s| s["label"].as_str().unwrap()).collect();
    let csv = read("run-1-readings.csv");
    let rows: Vec<Vec<&str>> = csv.lines().skip(3).map(|line| line.split(',').collect()).collect();
    let number = |row: &[&str], column: usize| row[column].parse::<f64>().unwrap();
    let begin_s = number(&rows[0], 11);
    let touch = |row: &Vec<&str>| {
        let label = labels[number(row, 0) as usize];
        let t_min = (number(row, 11) - begin_s) / 60.0;
        Some((label, ReferenceTouch { t_min, x_mm: number(row, 2), residual_um: *residuals.get(label)? }))
    };
    let touches: Vec<(&str, ReferenceTouch)> = rows.iter().filter_map(touch).collect();
    assert_eq!(touches.len(), residuals.len());
    let is_reference = |label: &str| label.starts_with('R') && label.ends_with("/P000");
    let references: Vec<&ReferenceTouch> =
        touches.iter().filter(|(label, _)| is_reference(label)).map(|(_, touch)| touch).collect();
    assert!(references.len() > 4);
    for pair in references.windows(2) {
        let (by_residual, by_x) = (pair[1].residual_um - pair[0].residual_um, 1e3 * (pair[1].x_mm - pair[0].x_mm));
        assert!((by_residual - by_x).abs() < 0.01, "{by_residual} {by_x}");
    }
    let (first, last) = (references[0], references[references.len() - 1]);
    assert!((last.residual_um - first.residual_um).abs() > 4.0, "{} {}", first.residual_um, last.residual_um);
    let report = read("run-1-report.html");
    let figure = report.split("over the time since the first reading").nth(1).unwrap();
    let figure = figure.split("</figure>").next().unwrap();
    let times: Vec<f64> = touches.iter().map(|(_, touch)| touch.t_min).collect();
    let residuals: Vec<f64> = touches.iter().map(|(_, touch)| touch.residual_um).collect();
    let marks = mark_positions(figure);
    assert_is_linear(&times, &marks.iter().map(|[x, _]| *x).collect::<Vec<_>>());
    assert_is_linear(&residuals, &marks.iter().map(|[_, y]| *y).collect::<Vec<_>>());
}

/// The positions of the marks are whole numbers, linear in the values.
fn assert_is_linear(values: &[f64], marks: &[f64]) {
    assert_eq!(values.len(), marks.len());
    let by_value = |a: &usize, b: &usize| values[*a].total_cmp(&values[*b]);
    let least = (0..values.len()).min_by(by_value).unwrap();
    let most = (0..values.len()).max_by(by_value).unwrap();
    let scale = (marks[most] - marks[least]) / (values[most] - values[least]);
    assert!(scale.abs() > 1.0, "{scale}");
    for (value, mark) in values.iter().zip(marks) {
        let expected = marks[least] + scale * (value - values[least]);
        assert!((mark - expected).abs() <= 2.0, "{value}: {mark}, expected {expected}");
    }
}
