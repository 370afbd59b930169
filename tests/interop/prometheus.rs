//! `/metrics` as prometheus_client reads it (`tests/peers/prometheus/install` puts it below the target directory).
//! Without it the trials are skipped, with the reason; with `TRUED_REQUIRE_PEERS=1` they fail.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use crate::support::daemon_process::DaemonProcess;
use crate::support::harness::{Pool, Trials, trials};
use crate::support::http::{HTTP_SECTION, MACHINE_API_PATH, start_request_body};
use crate::support::journal_checksums;
use crate::support::machine_shop::MachineShop;

const MACHINE_NAME: &str = "simulated five-axis machine";
const METHOD: &str = "self-calibration";

pub fn trials() -> Trials {
    trials![Pool::Waiting, 10;
        metrics_have_the_values_of_the_newest_result,
        outdated_results_have_no_values,
    ]
    .requires_peer(|| {
        let reason = "prometheus_client is missing: tests/peers/prometheus/install";
        python_with_prometheus_client().is_none().then_some(reason)
    })
}

fn python_with_prometheus_client() -> Option<PathBuf> {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent()?;
    let python = target.join("peers/prometheus-client-0.22.1/bin/python");
    python.is_file().then_some(python)
}

/// The metrics of a daemon: `families` and `samples`.
struct ParsedMetrics(Value);

impl ParsedMetrics {
    fn scrape(daemon: &DaemonProcess) -> Self {
        let text = daemon.http().get_text("/metrics");
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/prometheus/parse.py");
        let mut python = Command::new(python_with_prometheus_client().unwrap());
        let mut parser = python.arg(script).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        parser.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
        let parsed = parser.wait_with_output().unwrap();
        assert!(parsed.status.success(), "{text}");
        Self(serde_json::from_slice(&parsed.stdout).unwrap())
    }

    fn families(&self) -> &Vec<Value> {
        self.0["families"].as_array().unwrap()
    }

    fn samples(&self) -> &Vec<Value> {
        self.0["samples"].as_array().unwrap()
    }

    /// Value of the sample with these labels, besides machine and method.
    fn value(&self, name: &str, labels: &[(&str, &str)]) -> Option<f64> {
        let mut all = json!({"machine": MACHINE_NAME, "method": METHOD});
        for (label, value) in labels {
            all[*label] = json!(value);
        }
        let sample = self.samples().iter().find(|sample| sample[0] == name && sample[1] == all);
        sample.map(|sample| sample[2].as_f64().unwrap())
    }

    /// Number of samples whose name has this prefix.
    fn count(&self, prefix: &str) -> usize {
        self.samples().iter().filter(|sample| sample[0].as_str().unwrap().starts_with(prefix)).count()
    }
}

/// Waits for the end of a cycle; `run`: its run.
fn measure(daemon: &DaemonProcess, run: i64) {
    assert_eq!(daemon.http().post_action("start", &start_request_body()).0, 202);
    daemon.http().wait_until_machine_state(|machine| machine["result"]["run"] == run && machine["state"] == "waiting");
}

fn served_shop() -> MachineShop {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    shop.replace_in_machine_file("monte_carlo_trials = 1000", "monte_carlo_trials = 1000\npositions = 5");
    shop.replace_in_machine_file("EY0C_um = 500.0", "EY0C_um = 5.0");
    shop
}

/// Suffix of the metric for a unit of an estimate, and the size of this unit in the unit of the metric.
fn metric_unit(unit: &str) -> (&'static str, f64) {
    match unit {
        "um" => ("meters", 1e-6),
        "mm" => ("meters", 1e-3),
        "urad" => ("radians", 1e-6),
        "um/m" => ("ratios", 1e-6),
        "ms" => ("seconds", 1e-3),
        other => panic!("{other}"),
    }
}

fn assert_close(value: Option<f64>, expected: f64, what: &str) {
    let value = value.unwrap_or_else(|| panic!("{what} is missing"));
    assert!((value - expected).abs() <= 1e-12 * expected.abs(), "{what}: {value}, {expected}");
}

/// The second result replaces the first.
fn metrics_have_the_values_of_the_newest_result() {
    let shop = served_shop();
    let daemon = shop.start_daemon("fast");
    let before = ParsedMetrics::scrape(&daemon);
    assert_eq!(before.count("trued_parameter_") + before.count("trued_result_"), 0);
    for run in 1..=2 {
        measure(&daemon, run);
        let metrics = ParsedMetrics::scrape(&daemon);
        assert_values_of_run(&daemon, &metrics, run);
    }
    let described = |family: &Value| !family["help"].as_str().unwrap().is_empty() && family["type"] != "unknown";
    assert!(before.families().iter().all(described), "{:?}", before.families());
}

/// Compares the metrics with the estimate, the run and its temperatures, as the API returns them.
fn assert_values_of_run(daemon: &DaemonProcess, metrics: &ParsedMetrics, run: i64) {
    let http = daemon.http();
    let estimate = http.get_json(&format!("/api/v1/runs/{run}/estimate"));
    let parameters = estimate["parameters"].as_array().unwrap();
    for parameter in parameters {
        let symbol = parameter["symbol"].as_str().unwrap();
        let (suffix, size) = metric_unit(parameter["unit"].as_str().unwrap());
        let gauge =
            |quantity: &str| metrics.value(&format!("trued_parameter_{quantity}_{suffix}"), &[("symbol", symbol)]);
        assert_close(gauge("value"), parameter["value"].as_f64().unwrap() * size, symbol);
        assert_close(gauge("expanded_uncertainty"), parameter["U"].as_f64().unwrap() * size, symbol);
        let judged = &parameter["judged"];
        assert_eq!(gauge("limit").is_some(), judged.is_object(), "{symbol}");
        if judged.is_object() {
            assert_close(gauge("limit"), judged["limit"].as_f64().unwrap() * size, symbol);
            for verdict in ["pass", "fail", "undecided", "undecided_model"] {
                let flag = metrics.value("trued_parameter_verdict", &[("symbol", symbol), ("verdict", verdict)]);
                assert_eq!(flag == Some(1.0), judged["verdict"] == verdict, "{symbol} {verdict}");
            }
        }
    }
    // Of all runs, only this one has values.
    assert_eq!(metrics.count("trued_parameter_value_"), parameters.len());
    assert_eq!((metrics.count("trued_parameter_limit_"), metrics.count("trued_parameter_verdict")), (2, 8));
    assert_eq!(metrics.value("trued_result_verdict", &[("verdict", "fail")]), Some(1.0));
    assert_eq!(metrics.value("trued_result_verdict", &[("verdict", "pass")]), Some(0.0));
    let ended: jiff::Timestamp =
        http.get_json(&format!("/api/v1/runs/{run}"))["ended"].as_str().unwrap().parse().unwrap();
    let ended_s = ended.as_millisecond() as f64 / 1e3;
    let measured_s = metrics.value("trued_result_timestamp_seconds", &[]).unwrap();
    assert!((measured_s - ended_s).abs() < 0.002, "{measured_s}, {ended_s}");
    let trends = http.get_json(&format!("{MACHINE_API_PATH}/trends"));
    let celsius = trends[0]["values"].as_array().unwrap().last().unwrap()["temperatures_c"]["spindle"].as_f64();
    assert_eq!(metrics.value("trued_result_temperature_celsius", &[("thermometer", "spindle")]), celsius);
    assert!(celsius.is_some());
}

/// After the end of its validity, and while a newer run of the method is not identified, only the time of a result
/// remains.
fn outdated_results_have_no_values() {
    let unidentified_run = "INSERT INTO runs (id, started, ended, method, machine, state, program_version, config,
                                              config_sha256, plan_head, plan_sha256)
        SELECT 2, started, ended, method, machine, 'finished', program_version, config, config_sha256, plan_head,
               plan_sha256 FROM runs WHERE id = 1";
    let old_run = "UPDATE runs SET ended = '2026-01-10T05:30:00Z', started = '2026-01-10T05:00:00Z'";
    for change in [unidentified_run, old_run] {
        let shop = served_shop();
        let daemon = shop.start_daemon("fast");
        measure(&daemon, 1);
        assert!(ParsedMetrics::scrape(&daemon).count("trued_parameter_value_") > 0);
        journal_checksums::execute_sql_and_update_checksums(&shop.state_folder(), change);
        let metrics = ParsedMetrics::scrape(&daemon);
        assert_eq!((metrics.count("trued_parameter_"), metrics.count("trued_result_")), (0, 1));
        assert!(metrics.value("trued_result_timestamp_seconds", &[]).is_some());
    }
}
