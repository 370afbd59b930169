//! Runs of the four methods on simulated machines in memory: plan, readings, estimate, capture, report.

use std::sync::OnceLock;

use serde_json::Value;

use super::capture::normalise_capture;
use super::compare::{check_json, check_text};
use super::digest::check_digest;
use super::machines::{CASES, Case};
use super::normalise::{remove_lines, replace_hashes, replace_timestamps};
use super::workspace::{Workspace, stderr};

/// Output of one run: of its commands and of its export.
pub struct RunOutput {
    /// Standard output of `trued run --json`.
    estimate: Value,
    /// Standard error of `trued run --json`.
    progress: String,
    plan: Value,
    readings: String,
    capture: String,
    report: String,
    /// Output of `trued show`.
    summary: String,
}

impl RunOutput {
    pub fn run_method(method: &str, machine: &str) -> Self {
        let workspace = Workspace::with_machine(machine);
        let (file, capture) = (workspace.path("machine.toml"), workspace.path("run.capture"));
        let arguments = ["run", method, "--machine", &file, "--json", "--capture", &capture];
        let output = workspace.output(&arguments);
        assert!(output.status.success(), "{}", stderr(&output));
        workspace.stdout(&["export", "1", "--to", &workspace.path("export")]);
        Self {
            estimate: serde_json::from_slice(&output.stdout).unwrap(),
            progress: remove_lines(&stderr(&output), &["capture written: "]),
            plan: serde_json::from_str(&workspace.read("export/run-1-plan.json")).unwrap(),
            readings: workspace.read("export/run-1-readings.csv"),
            capture: normalise_capture(&workspace.read("run.capture")),
            report: replace_hashes(&replace_timestamps(&workspace.read("export/run-1-report.html"))),
            summary: replace_timestamps(&workspace.stdout(&["show", "1"])),
        }
    }

    /// Compares estimate, readings and reduced capture in full.
    pub fn compare_with_stored(&self, folder: &str, name: &str) {
        check_json(&format!("{folder}/{name}-estimate.json"), &self.estimate);
        check_text(&format!("{folder}/{name}-readings.csv"), &self.readings);
        check_text(&format!("{folder}/{name}-capture.txt"), &self.capture);
    }
}

/// The run on the built-in machine, once for all tests of this process.
fn cached_run(case: &Case) -> &'static RunOutput {
    static CACHED_RUNS: [OnceLock<RunOutput>; CASES.len()] = [const { OnceLock::new() }; CASES.len()];
    let index = CASES.iter().position(|other| other.method == case.method).unwrap();
    CACHED_RUNS[index].get_or_init(|| RunOutput::run_method(case.method, &case.run_machine()))
}

/// The plan of the run: it differs from the nominal plan by the positions that the run measured.
pub fn plan(case: &Case) {
    let plan = serde_json::to_string_pretty(&cached_run(case).plan).unwrap();
    check_digest(&format!("runs/{}-plan.digest", case.method), &plan);
}

pub fn readings(case: &Case) {
    let readings = &cached_run(case).readings;
    match case.is_large {
        true => check_digest(&format!("runs/{}-readings.digest", case.method), readings),
        false => check_text(&format!("runs/{}-readings.csv", case.method), readings),
    }
}

pub fn estimate(case: &Case) {
    let run = cached_run(case);
    check_json(&format!("runs/{}-estimate.json", case.method), &run.estimate);
    check_text(&format!("runs/{}-summary.txt", case.method), &run.summary);
    check_text(&format!("runs/{}-progress.txt", case.method), &run.progress);
}

pub fn capture(case: &Case) {
    check_digest(&format!("runs/{}-capture.digest", case.method), &cached_run(case).capture);
}

pub fn report(case: &Case) {
    let report = &cached_run(case).report;
    check_text(&format!("runs/{}-report.txt", case.method), &visible_text(report));
    check_digest(&format!("runs/{}-report.digest", case.method), report);
}

/// Plan, readings, estimate and capture of a short run; and the estimate from the stored plan and readings.
pub fn short(case: &Case) {
    let method = case.method;
    let run = RunOutput::run_method(method, &case.short_machine());
    check_json(&format!("short/{method}-plan.json"), &run.plan);
    run.compare_with_stored("short", method);
    let workspace = Workspace::with_machine(&case.short_machine());
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/baseline/short/");
    let (plan, readings) = (format!("{data}{method}-plan.json"), format!("{data}{method}-readings.csv"));
    let machine = workspace.path("machine.toml");
    let arguments = ["identify", method, "--machine", &machine, "--plan", &plan, "--readings", &readings];
    let estimate = workspace.json(&[&arguments[..], &["--json"]].concat());
    check_json(&format!("short/{method}-estimate.json"), &estimate);
}

/// The estimate with the built-in number of Monte Carlo trials.
pub fn default_estimate(case: &Case) {
    let workspace = Workspace::new();
    let estimate = workspace.json(&["run", case.method, "--json"]);
    check_json(&format!("runs/{}-default-estimate.json", case.method), &estimate);
}

/// The text between the tags of a page, one piece per line, without style sheets and scripts.
fn visible_text(html: &str) -> String {
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
