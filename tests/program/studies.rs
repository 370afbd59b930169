//! The studies in `docs/studies/`: each page repeats the tables of its command, and the results agree with each other
//! and with the true errors within their uncertainty. The true values are computed here from geometry.

use crate::support::harness::{Pool, Trials, trials};
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use tempfile::TempDir;

/// True axis of C in machine coordinates, X and Y, µm.
const TRUE_AXIS_UM: [f64; 2] = [3.0, 5.1];
/// True error motion of C at C = 0, X and Y, µm.
const TRUE_ERROR_MOTION_AT_0_UM: [f64; 2] = [0.4, 0.0];
/// Rotation of X about Z: the true Y of a point at X is this multiple of X further.
const TRUE_X_ROTATION: f64 = 90e-6;
/// Distance from the centre of the stylus ball to the axis of the part, µm.
const CONTACT_RADIUS_UM: f64 = 48_000.0;
/// Form of the machined part: order, cosine and sine, µm.
const MACHINED_FORM: [[f64; 3]; 1] = [[3.0, 0.4, -0.5]];

pub fn trials() -> Trials {
    trials![Pool::Computing, 4;
        two_workpieces_have_equal_axis_errors_and_their_own_form,
        eccentric_workpieces_have_equal_axis_errors,
        shifted_origins_shift_the_axis_position_only,
    ]
}

/// One run of a study.
struct StudyRun(Value);

/// A result minus the value to which it is compared, with the expanded uncertainty of this difference.
struct Deviation {
    label: String,
    value: f64,
    expanded_u: f64,
}

impl StudyRun {
    /// Value and U of a parameter.
    fn parameter(&self, symbol: &str) -> [f64; 2] {
        let all = self.0["parameters"].as_array().unwrap();
        let found = all.iter().find(|parameter| parameter["symbol"] == symbol).unwrap();
        ["value", "U"].map(|key| found[key].as_f64().unwrap())
    }

    /// Angle (rad), value and U of the points of a function, without those that a convention sets to 0.
    fn points(&self, symbol: &str) -> Vec<[f64; 3]> {
        let all = self.0["functions"].as_array().unwrap();
        let found = all.iter().find(|function| function["symbol"] == symbol).unwrap();
        let column = |key: &str| found[key].as_array().unwrap().iter().map(|number| number.as_f64().unwrap());
        let points = column("x").zip(column("y")).zip(column("u"));
        points.map(|((x, y), u)| [x.to_radians(), y, 2.0 * u]).filter(|point| point[2] > 0.0).collect()
    }

    fn parameter_minus_truth(&self, symbol: &str, truth: f64) -> Deviation {
        let [value, expanded_u] = self.parameter(symbol);
        Deviation { label: symbol.to_owned(), value: value - truth, expanded_u }
    }

    fn function_minus_truth(&self, symbol: &str, truth: impl Fn(f64) -> f64) -> Vec<Deviation> {
        let deviation = |[angle, y, expanded_u]: [f64; 3]| Deviation {
            label: format!("{symbol} at {angle} rad"),
            value: y - truth(angle),
            expanded_u,
        };
        self.points(symbol).into_iter().map(deviation).collect()
    }

    /// Differences from another run, at each angle.
    fn function_minus(&self, other: &StudyRun, symbol: &str) -> Vec<Deviation> {
        let difference = |([angle, a, u_a], [_, b, u_b]): ([f64; 3], [f64; 3])| Deviation {
            label: format!("difference of {symbol} at {angle} rad"),
            value: a - b,
            expanded_u: u_a.hypot(u_b),
        };
        self.points(symbol).into_iter().zip(other.points(symbol)).map(difference).collect()
    }

    fn parameter_minus(&self, other: &StudyRun, symbol: &str) -> Deviation {
        let [[a, u_a], [b, u_b]] = [self, other].map(|run| run.parameter(symbol));
        Deviation { label: format!("difference of {symbol}"), value: a - b, expanded_u: u_a.hypot(u_b) }
    }
}

/// U has a coverage probability of 95 %. Of a few values one, and of many a tenth, may deviate by more than U, but none
/// by more than 2 U.
#[track_caller]
fn assert_deviations_within_u(deviations: &[Deviation]) {
    let beyond = deviations.iter().filter(|deviation| deviation.value.abs() > deviation.expanded_u);
    let beyond: Vec<&Deviation> = beyond.collect();
    let list =
        beyond.iter().map(|Deviation { label, value, expanded_u }| format!("{label}: {value}, U {expanded_u}\n"));
    let list: String = list.collect();
    println!("{} of {} beyond U\n{list}", beyond.len(), deviations.len());
    assert!(beyond.len() <= (deviations.len() / 10).max(1), "{} of {}:\n{list}", beyond.len(), deviations.len());
    assert!(beyond.iter().all(|deviation| deviation.value.abs() <= 2.0 * deviation.expanded_u), "{list}");
}

fn study_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/studies").join(name)
}

/// Runs the command of a study, compares its tables with the page, and returns its runs.
#[track_caller]
fn run_study(name: &str, run_count: usize) -> Vec<StudyRun> {
    let folder = TempDir::new().unwrap();
    let trued = env!("CARGO_BIN_EXE_trued");
    let mut command = Command::new(study_path("run-study"));
    let output = command.arg(name).arg(folder.path()).env("TRUED", trued).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let tables = String::from_utf8(output.stdout).unwrap();
    let page = std::fs::read_to_string(study_path(&format!("{name}.md"))).unwrap();
    assert!(page.contains(&tables), "replace the tables of docs/studies/{name}.md, and check its text:\n{tables}");
    let estimate = |run: usize| {
        let mut show = Command::new(trued);
        let shown = show.args(["show", &run.to_string(), "--json", "--state"]).arg(folder.path()).output().unwrap();
        StudyRun(serde_json::from_slice(&shown.stdout).unwrap())
    };
    (1..=run_count).map(estimate).collect()
}

/// Errors of the machine in each run, compared with the truth and with the first run.
fn machine_error_deviations(runs: &[StudyRun]) -> Vec<Deviation> {
    let mut deviations = Vec::new();
    for run in runs {
        let [x, y] = TRUE_AXIS_UM;
        for (symbol, truth) in [("X_C", x / 1e3), ("Y_C", y / 1e3), ("EC0Y", -TRUE_X_ROTATION * 1e6)] {
            deviations.push(run.parameter_minus_truth(symbol, truth));
        }
        let e_radial = |phi: f64| TRUE_X_ROTATION * CONTACT_RADIUS_UM * phi.cos() * phi.sin();
        deviations.extend(run.function_minus_truth("E_radial_XY", e_radial));
    }
    for run in &runs[1..] {
        deviations.extend(["X_C", "Y_C", "EC0Y", "EYY1-EXX1"].map(|symbol| run.parameter_minus(&runs[0], symbol)));
        for symbol in ["EXC", "EYC", "E_radial_XY"] {
            deviations.extend(run.function_minus(&runs[0], symbol));
        }
    }
    deviations
}

/// Distance of the stylus ball from the origin when it touches an eccentric circle, µm. `centre`: of the circle, µm.
fn eccentric_circle_radius(centre: [f64; 2], theta: f64) -> f64 {
    let (sin, cos) = theta.sin_cos();
    let across = centre[1] * cos - centre[0] * sin;
    centre[0] * cos + centre[1] * sin + (CONTACT_RADIUS_UM.powi(2) - across.powi(2)).sqrt()
}

/// Deviation of the radius, µm: `harmonics` are order, cosine and sine.
fn form(harmonics: &[[f64; 3]], theta: f64) -> f64 {
    harmonics.iter().map(|[order, cos, sin]| cos * (order * theta).cos() + sin * (order * theta).sin()).sum()
}

fn two_workpieces_have_equal_axis_errors_and_their_own_form() {
    let runs = run_study("two-workpieces", 2);
    assert_deviations_within_u(&machine_error_deviations(&runs));
    let non_machined = [[2.0, 4.0, 11.0], [3.0, -6.0, 7.0], [4.0, -9.0, 3.0]];
    for (run, harmonics) in runs.iter().zip([&non_machined[..], &MACHINED_FORM]) {
        // At eight positions these orders contain neither a mean nor a first harmonic, which W_form does not have.
        assert_deviations_within_u(&run.function_minus_truth("W_form", |theta| form(harmonics, theta)));
    }
}

fn eccentric_workpieces_have_equal_axis_errors() {
    let runs = run_study("eccentric-workpiece", 4);
    assert_deviations_within_u(&machine_error_deviations(&runs));
    let positions = [[-30.0, -24.0], [750.0, 0.0], [-400.0, 620.0], [-300.0, -690.0]];
    for (run, position) in runs.iter().zip(positions) {
        assert_deviations_within_u(&part_position_deviations(run, position, [0.0; 2]));
    }
}

/// W_radial compared with that of the part at `position` (table, µm) about `origin` (machine, µm).
fn part_position_deviations(run: &StudyRun, position: [f64; 2], origin: [f64; 2]) -> Vec<Deviation> {
    // With C at 0° the part is displaced with the table.
    let centre = [0, 1].map(|i| position[i] + TRUE_AXIS_UM[i] + TRUE_ERROR_MOTION_AT_0_UM[i] - origin[i]);
    let radius = |theta: f64| eccentric_circle_radius(centre, theta) + form(&MACHINED_FORM, theta);
    run.function_minus_truth("W_radial", |theta| radius(theta) - radius(0.0))
}

fn shifted_origins_shift_the_axis_position_only() {
    let runs = run_study("shifted-origins", 8);
    assert_deviations_within_u(&machine_error_deviations(&runs));
    let origins = [[0, 20], [0, -20], [20, 0], [-20, 0], [20, 20], [20, -20], [-20, 20], [-20, -20]];
    let mut deviations = Vec::new();
    for (run, origin) in runs.iter().zip(origins) {
        let origin = origin.map(f64::from);
        for (i, symbol) in ["EX0C", "EY0C"].into_iter().enumerate() {
            deviations.push(run.parameter_minus_truth(symbol, TRUE_AXIS_UM[i] - origin[i]));
        }
        deviations.extend(part_position_deviations(run, [-30.0, -24.0], origin));
    }
    assert_deviations_within_u(&deviations);
}
