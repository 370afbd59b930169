//! Runs of the four methods on simulated machines in memory: plan, readings, estimate, capture, report.

use std::sync::OnceLock;

use serde_json::Value;

use super::capture::normalise_capture;
use super::compare::{check_json_against_baseline, check_text_against_baseline};
use super::digest::check_digest;
use super::method_cases::{METHOD_CASES, MethodCase};
use super::normalise::{remove_lines_with_prefixes, replace_hashes, replace_timestamps};
use super::workspace::{Workspace, stderr_text};

/// Maximum size of a report, which opens without delay on a phone.
const MAX_REPORT_BYTES: usize = 200_000;

/// Output of one run: of its commands and of its export.
pub struct RunOutput {
    /// Standard output of `trued run --json`.
    estimate: Value,
    /// Standard error of `trued run --json`.
    progress_text: String,
    plan: Value,
    readings_csv: String,
    normalised_capture: String,
    report_html: String,
    /// Output of `trued show`.
    show_text: String,
}

impl RunOutput {
    pub fn run_method(method: &str, machine: &str) -> Self {
        let workspace = Workspace::with_machine_file(machine);
        let (file, capture) = (workspace.file_path("machine.toml"), workspace.file_path("run.capture"));
        let arguments = ["run", method, "--machine", &file, "--json", "--capture", &capture];
        let output = workspace.run_trued(&arguments);
        assert!(output.status.success(), "{}", stderr_text(&output));
        workspace.run_stdout(&["export", "1", "--to", &workspace.file_path("export")]);
        Self {
            estimate: serde_json::from_slice(&output.stdout).unwrap(),
            progress_text: remove_lines_with_prefixes(&stderr_text(&output), &["capture written: "]),
            plan: serde_json::from_str(&workspace.read_file("export/run-1-plan.json")).unwrap(),
            readings_csv: workspace.read_file("export/run-1-readings.csv"),
            normalised_capture: normalise_capture(&workspace.read_file("run.capture")),
            report_html: replace_hashes(&replace_timestamps(&workspace.read_file("export/run-1-report.html"))),
            show_text: replace_timestamps(&workspace.run_stdout(&["show", "1"])),
        }
    }

    /// Compares estimate, readings and normalised capture in full; not plan, report and summary.
    pub fn check_estimate_readings_and_capture(&self, folder: &str, name: &str) {
        check_json_against_baseline(&format!("{folder}/{name}-estimate.json"), &self.estimate);
        check_text_against_baseline(&format!("{folder}/{name}-readings.csv"), &self.readings_csv);
        check_text_against_baseline(&format!("{folder}/{name}-capture.txt"), &self.normalised_capture);
    }
}

/// Output of the full run on the built-in machine, which runs once for all tests of this process.
fn cached_full_run(case: &MethodCase) -> &'static RunOutput {
    static CACHED_RUNS: [OnceLock<RunOutput>; METHOD_CASES.len()] = [const { OnceLock::new() }; METHOD_CASES.len()];
    let index = METHOD_CASES.iter().position(|other| other.method == case.method).unwrap();
    CACHED_RUNS[index].get_or_init(|| RunOutput::run_method(case.method, &case.full_run_machine_file()))
}

/// The plan of the run: it differs from the nominal plan by the positions that the run measured.
pub fn check_run_plan(case: &MethodCase) {
    let plan = serde_json::to_string_pretty(&cached_full_run(case).plan).unwrap();
    check_digest(&format!("runs/{}-plan.digest", case.method), &plan);
}

pub fn check_run_readings(case: &MethodCase) {
    let readings = &cached_full_run(case).readings_csv;
    match case.has_large_output {
        true => check_digest(&format!("runs/{}-readings.digest", case.method), readings),
        false => check_text_against_baseline(&format!("runs/{}-readings.csv", case.method), readings),
    }
}

pub fn check_run_estimate(case: &MethodCase) {
    let run = cached_full_run(case);
    check_json_against_baseline(&format!("runs/{}-estimate.json", case.method), &run.estimate);
    check_text_against_baseline(&format!("runs/{}-summary.txt", case.method), &run.show_text);
    check_text_against_baseline(&format!("runs/{}-progress.txt", case.method), &run.progress_text);
}

pub fn check_run_capture(case: &MethodCase) {
    check_digest(&format!("runs/{}-capture.digest", case.method), &cached_full_run(case).normalised_capture);
}

pub fn check_run_report(case: &MethodCase) {
    let report = &cached_full_run(case).report_html;
    assert!(report.len() <= MAX_REPORT_BYTES, "{} bytes", report.len());
    check_text_against_baseline(&format!("runs/{}-report.txt", case.method), &visible_html_text(report));
    check_digest(&format!("runs/{}-report.digest", case.method), report);
}

/// Plan, readings, estimate and capture of a short run; and the estimate from the stored plan and readings.
pub fn check_short_run(case: &MethodCase) {
    let method = case.method;
    let run = RunOutput::run_method(method, &case.short_run_machine_file());
    check_json_against_baseline(&format!("short/{method}-plan.json"), &run.plan);
    run.check_estimate_readings_and_capture("short", method);
    let workspace = Workspace::with_machine_file(&case.short_run_machine_file());
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/baseline/short/");
    let (plan, readings) = (format!("{data}{method}-plan.json"), format!("{data}{method}-readings.csv"));
    let machine = workspace.file_path("machine.toml");
    let arguments = ["identify", method, "--machine", &machine, "--plan", &plan, "--readings", &readings];
    let estimate = workspace.run_json(&[&arguments[..], &["--json"]].concat());
    check_json_against_baseline(&format!("short/{method}-estimate.json"), &estimate);
}

/// The estimate with the built-in number of Monte Carlo trials.
pub fn check_estimate_with_default_trials(case: &MethodCase) {
    let workspace = Workspace::new();
    let estimate = workspace.run_json(&["run", case.method, "--json"]);
    check_json_against_baseline(&format!("runs/{}-default-estimate.json", case.method), &estimate);
}

/// The text between the tags of a page, one piece per line, without style sheets and scripts.
fn visible_html_text(html: &str) -> String {
    let (mut text, mut rest) = (String::new(), html);
    while let Some((before, tag)) = rest.split_once('<') {
        let line = before.split_whitespace().collect::<Vec<_>>().join(" ");
        if !line.is_empty() {
            text += &line;
            text.push('\n');
        }
        let hidden = ["style", "script"].into_iter().find(|name| tag.starts_with(name));
        let end = hidden.map_or(">".to_owned(), |name| format!("</{name}>"));
        rest = tag.split_once(&end).map_or("", |(_, rest)| rest);
    }
    text
}
