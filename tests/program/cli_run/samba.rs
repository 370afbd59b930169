//! Balls instead of a round part: a run of `samba` that is killed, stopped and resumed, checked by the program's
//! own output. It has the stages of a design, not one cycle.

use std::collections::BTreeMap;
use std::process::{Command, Output};

use serde_json::Value;

use super::resume::{
    resume_command, resume_run, signal_run_and_take_sent_text, touched_steps, value_and_expanded_uncertainty,
};
use super::{MachineShop, assert_stderr_has, machine_toml_with_control, stderr, successful_json_output};
use crate::support::grbl_control::GrblControl;

/// The built-in machine of the method with a small budget.
fn small_samba_machine_toml() -> String {
    let file = include_str!("../../../config/samba.toml");
    let budget = "balls = 30\nindexations = 10\nmonte_carlo_trials = 1000\n";
    format!("{file}\n[method.samba]\n{budget}")
}

fn shop_with_control(bench: &GrblControl) -> MachineShop {
    let control = format!("kind = \"grbl\"\ndialect = \"grbl-m19\"\ntcp = \"{}\"", bench.address);
    MachineShop::with_machine_file(&machine_toml_with_control(&small_samba_machine_toml(), &control))
}

fn samba_run_command(shop: &MachineShop) -> Command {
    shop.trued_command(&["run", "samba", "--json", "--machine", &shop.path_text("machine.toml")])
}

/// Number and label of each step of the printed plan, identical to those of a run.
fn steps_with_labels(shop: &MachineShop) -> Vec<(u32, String)> {
    let machine = shop.path_text("machine.toml");
    let plan: Value =
        serde_json::from_slice(&shop.run_trued(&["plan", "samba", "--json", "--machine", &machine]).stdout).unwrap();
    let step = |step: &Value| (step["id"].as_u64().unwrap() as u32, step["label"].as_str().unwrap().to_owned());
    plan["steps"].as_array().unwrap().iter().map(step).collect()
}

/// The steps from `first` on whose labels start with `begin`.
fn steps_with_label_prefix(steps: &[(u32, String)], begin: &str, first: u32) -> Vec<u32> {
    let ours = steps.iter().filter(|(id, label)| *id >= first && label.starts_with(begin));
    ours.map(|(id, _)| *id).collect()
}

/// Sends the signal to the run when it begins the touch of `step`; returns its output and the touched steps.
fn signal_run_at_step(bench: &GrblControl, command: Command, step: u32, signal: &str) -> (Output, Vec<u32>) {
    let (output, heard) = signal_run_and_take_sent_text(bench, command, &format!("N{step} G38.3"), signal);
    (output, touched_steps(&heard))
}

/// Killed in a search and in a slow measurement, stopped by Ctrl-C between the touches of a ball.
pub fn samba_run_survives_kills_and_stops() {
    let bench = GrblControl::start(&small_samba_machine_toml());
    let shop = shop_with_control(&bench);
    let steps = steps_with_labels(&shop);
    let references = steps_with_label_prefix(&steps, "reference/001/", 0);
    let (all, middle) = (steps.len() as u32, steps_with_label_prefix(&steps, "reference/002/", 0)[0]);
    // In the middle of a ball, each time in a different stage.
    let search = steps_with_label_prefix(&steps, "find/", references[4])[7];
    let slow = steps_with_label_prefix(&steps, "slow/", search)[6];
    let last = steps_with_label_prefix(&steps, "slow/", slow)[18];
    assert!(references.len() == 5 && last < middle, "{steps:?}");

    let (_, touched) = signal_run_at_step(&bench, samba_run_command(&shop), search, "KILL");
    assert_eq!(touched, (0..=search).collect::<Vec<_>>());
    assert_eq!(shop.exported_reading_steps(), (0..search).collect::<Vec<_>>());
    // The references, and then the touch that was not recorded.
    let goes_on = |from: u32, to: u32| [references.clone(), (from..=to).collect()].concat();
    let (_, touched) = signal_run_at_step(&bench, resume_command(&shop), slow, "KILL");
    assert_eq!(touched, goes_on(search, slow));
    let (held, touched) = signal_run_at_step(&bench, resume_command(&shop), last, "INT");
    assert_eq!(held.status.code(), Some(5), "{}", stderr(&held));
    assert_stderr_has(&held, &["the run was halted on request", " resume 1`"]);
    assert_eq!((touched, shop.run_states()), (goes_on(slow, last), vec!["held".to_owned()]));
    let resumed = resume_run(&shop);
    assert_eq!(super::resume::touched_steps(&bench.received_text()), goes_on(last, all - 1));

    let mut count: BTreeMap<u32, usize> = BTreeMap::new();
    shop.exported_reading_steps().into_iter().for_each(|step| *count.entry(step).or_default() += 1);
    let once = |step: &u32| if references.contains(step) { 4 } else { 1 };
    assert!((0..all).all(|step| count.get(&step) == Some(&once(&step))), "{count:?}");
    assert_near_uninterrupted_run(&successful_json_output(&resumed));
    assert_stored_run_gives_same_estimate(&shop, &resumed);
}

/// Compares with an uninterrupted run on the same machine.
fn assert_near_uninterrupted_run(resumed: &Value) {
    let whole = successful_json_output(
        &samba_run_command(&MachineShop::with_machine_file(&small_samba_machine_toml())).output().unwrap(),
    );
    for parameter in whole["parameters"].as_array().unwrap() {
        let symbol = parameter["symbol"].as_str().unwrap();
        let ((value, expanded), (one_go, _)) =
            (value_and_expanded_uncertainty(resumed, symbol), value_and_expanded_uncertainty(&whole, symbol));
        assert!((value - one_go).abs() < expanded, "{symbol}: {value} and {one_go} ± {expanded}");
    }
}

fn assert_stored_run_gives_same_estimate(shop: &MachineShop, resumed: &Output) {
    let again = shop.run_trued(&["identify", "samba", "--run", "1", "--json"]);
    assert_eq!(again.stdout, resumed.stdout, "{}", stderr(&again));
    let report = shop.path_text("report.html");
    let shown = shop.run_trued(&["show", "1", "--report", &report]);
    assert_eq!(shown.status.code(), Some(0), "{}", stderr(&shown));
    let told = String::from_utf8(shown.stdout).unwrap();
    assert_eq!(told.matches("resumed after an interruption at t = ").count(), 3, "{told}");
    let report = std::fs::read_to_string(report).unwrap();
    assert!(report.contains("EX0C") && report.contains("<svg"), "a report without its figures");
}

/// The first searches come before the references: the message agrees with the later behaviour.
pub fn samba_run_stopped_before_references_cannot_be_resumed() {
    let bench = GrblControl::start(&small_samba_machine_toml());
    let shop = shop_with_control(&bench);
    let (held, _) = signal_run_at_step(&bench, samba_run_command(&shop), 3, "INT");
    assert_eq!(held.status.code(), Some(5), "{}", stderr(&held));
    let over = ["run 1 cannot be resumed", "start a new run"];
    assert_stderr_has(&held, &over);
    for listed in [&["runs"][..], &["show", "1"]] {
        let told = String::from_utf8(shop.run_trued(listed).stdout).unwrap();
        assert!(over.iter().all(|words| told.contains(words)), "{told}");
        assert!(!told.contains(" resume 1`"), "{told}");
    }
    let refused = resume_run(&shop);
    assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
    assert_eq!(shop.run_states(), ["closed"]);
}

pub fn samba_run_with_repeat_option_is_refused() {
    let shop = MachineShop::with_machine_file(&small_samba_machine_toml());
    let refused = shop.run_trued(&["run", "samba", "--repeat", "2"]);
    assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
    assert_stderr_has(&refused, &["does not support repetitions", "omit --repeat", "balls"]);
}
