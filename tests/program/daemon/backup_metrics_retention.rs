//! A backup while the daemon measures, a configuration check before it starts, metrics, and retention.

use std::process::Output;

use super::served_machine::served_machine_toml;
use crate::support::journal_checksums;
use crate::support::machine_shop::MachineShop;
use serde_json::json;
use trued::store::{Journal, RunId};

fn stderr_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A backup during a run is complete up to the readings of that time, and is a usable journal.
pub fn backup_during_a_run_is_a_usable_journal() {
    let shop = MachineShop::with_machine_file(&served_machine_toml(""));
    let daemon = shop.start_daemon("real");
    assert_eq!(daemon.http().start_cycle(1), 202);
    let before = daemon.http().wait_until_machine_state(|standing| standing["measured"].as_u64() > Some(0));
    let elsewhere = shop.path("elsewhere");
    std::fs::create_dir(&elsewhere).unwrap();
    let copy = elsewhere.join("journal.sqlite");
    let copied = shop.run_trued(&["backup", copy.to_str().unwrap()]);
    assert_eq!(copied.status.code(), Some(0), "{}", stderr_text(&copied));
    assert_eq!(daemon.http().machine_state()["state"], "running");
    let again = shop.run_trued(&["backup", copy.to_str().unwrap()]);
    assert_eq!(again.status.code(), Some(1));
    assert!(stderr_text(&again).contains("choose another file name"), "{}", stderr_text(&again));
    assert_eq!(daemon.terminate(), 5);
    let journal = Journal::open(&elsewhere).unwrap();
    let run = journal.load_run(journal.runs().unwrap()[0].id).unwrap();
    assert!(run.readings.len() as u64 >= before["measured"].as_u64().unwrap());
    let now = Journal::open(&shop.state_folder()).unwrap().load_run(run.summary.id).unwrap();
    assert_eq!(now.readings[..run.readings.len()], run.readings[..]);
    let missing = shop.path("no-journal");
    let nothing = std::process::Command::new(env!("CARGO_BIN_EXE_trued"))
        .args(["backup", "copy.sqlite", "--state", missing.to_str().unwrap()])
        .output()
        .unwrap();
    assert_eq!(nothing.status.code(), Some(1));
    assert!(stderr_text(&nothing).contains("the file does not exist"), "{}", stderr_text(&nothing));
}

/// `trued serve --check` opens and creates nothing, and a daemon may run meanwhile.
pub fn serve_check_accepts_sound_and_refuses_unsound_config() {
    let shop = MachineShop::with_machine_file(&served_machine_toml(""));
    let machine = shop.path("machine.toml").display().to_string();
    let check = || shop.run_trued(&["serve", "--machine", &machine, "--check"]);
    let sound = check();
    assert_eq!(sound.status.code(), Some(0), "{}", stderr_text(&sound));
    assert!(stderr_text(&sound).contains("cycle 1: machine time about"), "{}", stderr_text(&sound));
    assert!(!shop.state_folder().exists());
    let daemon = shop.start_daemon("fast");
    assert_eq!(check().status.code(), Some(0));
    assert_eq!(daemon.terminate(), 0);
    shop.replace_machine_file(&served_machine_toml("").replace("positions = 5", "positions = 2"));
    let unsound = check();
    assert_eq!(unsound.status.code(), Some(1));
    assert!(stderr_text(&unsound).contains("cycle 1 cannot be measured"), "{}", stderr_text(&unsound));
}

fn metric_value(metrics: &str, name: &str) -> f64 {
    let line = metrics.lines().find_map(|line| line.strip_prefix(name));
    line.unwrap_or_else(|| panic!("no {name} in {metrics}")).trim().parse().unwrap()
}

pub fn metrics_count_runs_readings_and_refusals() {
    const MACHINE_LABEL: &str = "machine=\"simulated five-axis machine\"";
    let shop = MachineShop::with_machine_file(&served_machine_toml(""));
    let daemon = shop.start_daemon("fast");
    let metrics = daemon.http().get_text("/metrics");
    assert_eq!(metric_value(&metrics, &format!("trued_runs_total{{{MACHINE_LABEL},outcome=\"none\"}}")), 0.0);
    // The metrics of results are tested with a parser of Prometheus.
    let count_lines = |metrics: &str| {
        let is_of_result = |line: &&str| line.contains("trued_parameter_") || line.contains("trued_result_");
        metrics.lines().filter(|line| !is_of_result(line)).count()
    };
    let lines = count_lines(&metrics);
    assert_eq!(daemon.http().start_cycle(1), 202);
    let ended = daemon.http().wait_for_state("waiting");
    assert_eq!(daemon.http().start_cycle(7), 409);
    assert_eq!(daemon.http().post_action("acknowledge", &json!({"who": "Ada"})).0, 409);
    let metrics = daemon.http().get_text("/metrics");
    let told = |name: &str, more: &str| metric_value(&metrics, &format!("trued_{name}{{{MACHINE_LABEL}{more}}}"));
    assert_eq!(told("runs_total", ",outcome=\"none\""), 1.0);
    assert_eq!(told("runs_total", ",outcome=\"held\""), 0.0);
    assert_eq!(Some(told("readings_total", "")), ended["measured"].as_f64());
    assert_eq!(told("refusals_total", ",reason=\"NoSuchCycle\""), 1.0);
    assert_eq!(told("refusals_total", ",reason=\"NothingToAcknowledge\""), 1.0);
    assert_eq!(told("link_errors_total", ""), 0.0);
    assert_eq!(told("state", ",state=\"waiting\""), 1.0);
    assert_eq!(told("state", ",state=\"running\""), 0.0);
    assert!(told("progress_age_seconds", "") < 60.0);
    // Each reading is at least one job of the writer.
    let jobs = metric_value(&metrics, "trued_journal_write_seconds_count");
    assert!(jobs > told("readings_total", ""), "{jobs}");
    let version = format!("trued_build_info{{version=\"{}\"}}", env!("CARGO_PKG_VERSION"));
    assert_eq!(metric_value(&metrics, &version), 1.0);
    // Two additional outcomes with their heading, and nothing else, independent of the number of runs.
    assert_eq!(count_lines(&metrics), lines + 4);
    assert!(metrics.ends_with("# EOF\n"));
}

/// By the dates in the journal: the samples of an old run are deleted while the daemon is idle.
pub fn retention_removes_only_scan_samples_of_old_runs() {
    let shop = MachineShop::with_machine_file(served_machine_toml("").split("[serve.http]").next().unwrap());
    let file = shop.path("trued.toml");
    let page = "[http]\nlisten = \"127.0.0.1:0\"\n[[machine]]\nfile = \"machine.toml\"\n";
    std::fs::write(&file, page).unwrap();
    let arguments = ["--config", file.to_str().unwrap()];
    let daemon = shop.start_prepared_daemon(&arguments, |_| {});
    for run in 1..=2 {
        assert_eq!(daemon.http().start_cycle(2), 202);
        daemon.http().wait_until_machine_state(|now| now["state"] == "waiting" && now["run"] == run);
    }
    assert_eq!(daemon.terminate(), 0);
    let journal = Journal::open(&shop.state_folder()).unwrap();
    let runs = [RunId(1), RunId(2)];
    for run in runs {
        let mut sample = journal.load_run(run).unwrap().readings[0].clone();
        (sample.step, sample.value_mm) = (10_000, Some(0.1));
        journal.add_scan(run, &[sample.clone(), sample]).wait().unwrap();
    }
    let [old, young] = runs.map(|run| journal.load_run(run).unwrap());
    let long_ago = "UPDATE runs SET ended = '2020-02-02T02:02:02Z' WHERE id = 1";
    journal_checksums::execute_sql_and_update_checksums(&shop.state_folder(), long_ago);
    std::fs::write(&file, format!("{page}[retention]\nkeep_days = 100\n")).unwrap();
    let daemon = shop.start_prepared_daemon(&arguments, |_| {});
    daemon.wait_for_log("run 1: the samples of 1 scans are removed");
    assert_eq!(daemon.terminate(), 0);
    let [now, still] = runs.map(|run| journal.load_run(run).unwrap());
    assert_eq!(now.readings[..], old.readings[..old.readings.len() - 2]);
    assert_eq!((&now.estimates, &now.plan), (&old.estimates, &old.plan));
    assert_eq!(still, young);
}
