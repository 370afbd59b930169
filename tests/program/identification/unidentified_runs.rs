//! Output of commands, page and interface for a run without an estimate.

use serde_json::{Value, json};
use trued::store::{Journal, MachineLock, RunId};

use super::unidentified_run_copy::copy_run_1_without_estimate;
use crate::support::grbl_control::GrblControl;
use crate::support::http::HTTP_SECTION;
use crate::support::machine_shop::{MachineShop, built_in_machine_text, stderr};

const FEW_POSITIONS_SETTINGS: &str = "[method.self-calibration]\nmonte_carlo_trials = 100\npositions = 5\n";
const MACHINE_PAGE_PATH: &str = "/machines/simulated%20five-axis%20machine";

/// Neither the control, nor the machine's lock, nor an acknowledgement is needed.
pub fn resume_identifies_without_the_machine() {
    let machine = format!("{}\n{FEW_POSITIONS_SETTINGS}", built_in_machine_text());
    let control = GrblControl::start(&machine);
    let (kind, wire) = ("kind = \"simulated\"", "\nwire = \"memory\"");
    assert!(machine.contains(kind) && machine.contains(wire));
    let tcp = format!("kind = \"grbl\"\ntcp = \"{}\"", control.address);
    let shop = MachineShop::with_machine_file(&machine.replacen(kind, &tcp, 1).replacen(wire, "", 1));
    let whole = shop.run_self_calibration();
    assert_eq!(whole.status.code(), Some(0), "{}", stderr(&whole));
    let run = copy_run_1_without_estimate(&shop, usize::MAX);
    assert_eq!((run, shop.run_states()), (RunId(2), vec!["finished".into(), "not identified".into()]));
    let listed = String::from_utf8(shop.run_trued(&["runs"]).stdout).unwrap();
    assert!(listed.contains("not identified") && listed.contains("resume 2` computes the estimate"), "{listed}");
    let told = String::from_utf8(shop.run_trued(&["show", "2"]).stdout).unwrap();
    assert!(told.contains("run 2 is not identified after"), "{told}");

    let journal = Journal::open(&shop.state_folder()).unwrap();
    let (before, heard) = (journal.load_run(run).unwrap(), control.received_text());
    let lock = MachineLock::acquire(&shop.state_folder(), &before.summary.machine).unwrap();
    let resumed = shop.run_trued(&["resume", "2", "--json"]);
    drop(lock);
    assert_eq!(resumed.status.code(), Some(0), "{}", stderr(&resumed));
    assert_eq!(resumed.stdout, whole.stdout, "another estimate of the same readings");
    assert!(control.received_text() == heard, "the control was spoken to");
    let after = journal.load_run(run).unwrap();
    assert_eq!((after.readings, after.events), (before.readings, before.events));
    assert_eq!((after.estimates.len(), shop.run_states()), (1, vec!["finished".into(); 2]));
    let again = shop.run_trued(&["resume", "2"]);
    assert_eq!(again.status.code(), Some(1));
    assert!(stderr(&again).contains("cannot be resumed"), "{}", stderr(&again));
}

/// The built-in machine with a page, and run 1, which is in tolerance.
fn shop_with_page_and_passed_run() -> MachineShop {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    shop.replace_in_machine_file("monte_carlo_trials = 1000", "monte_carlo_trials = 100\npositions = 5");
    let passed = shop.run_self_calibration();
    assert_eq!(passed.status.code(), Some(0), "{}", stderr(&passed));
    shop
}

pub fn daemon_start_identifies_a_run_without_estimate() {
    let shop = shop_with_page_and_passed_run();
    let run = copy_run_1_without_estimate(&shop, usize::MAX);
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    let standing = http.wait_until_machine_state(|standing| standing["result"]["run"] == 2);
    let result = &standing["result"];
    assert_eq!((&result["verdict"], &result["outdated"]), (&json!("pass"), &json!(false)));
    assert_eq!((&standing["not_identified"], &standing["state"]), (&Value::Null, &json!("waiting")));
    assert!(http.get_text(MACHINE_PAGE_PATH).contains("class=\"glance pass\""));
    daemon.wait_for_log("run 2 is identified, verdict pass");
    assert!(!daemon.log().contains("begins"), "{}", daemon.log());
    let stored = Journal::open(&shop.state_folder()).unwrap().load_run(run).unwrap();
    assert_eq!((stored.estimates.len(), shop.run_states()), (1, vec!["finished".into(); 2]));
    assert_eq!(daemon.terminate(), 0);
}

/// Stopped by a hold during the computation, and by the end of the daemon: nothing moves then, and no
/// acknowledgement is needed.
pub fn stopped_identification_is_repeated_by_the_daemon() {
    let shop = MachineShop::with_serve(HTTP_SECTION);
    shop.replace_in_machine_file("monte_carlo_trials = 1000", "monte_carlo_trials = 200000\npositions = 5");
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    assert_eq!(http.start_cycle(1), 202);
    daemon.wait_for_log("computing the estimate from 46 readings");
    assert_eq!(http.post_action("hold", &json!({})).0, 202);
    http.wait_until_machine_state(|standing| standing["result"]["run"] == 1);
    let told = "run 1 is measured and stored, but not identified: stopped during the computation of the";
    assert!(daemon.log().contains(told), "the hold came too late: {}", daemon.log());
    assert_eq!(http.machine_state()["state"], "waiting");
    assert_eq!(daemon.terminate(), 0);

    let daemon = shop.start_daemon("fast");
    assert_eq!(daemon.http().start_cycle(1), 202);
    daemon.wait_for_log("computing the estimate from 46 readings");
    assert_eq!(daemon.terminate(), 0);
    assert_eq!(shop.run_states(), ["finished", "not identified"]);
    let daemon = shop.start_daemon("fast");
    daemon.http().wait_until_machine_state(|standing| standing["result"]["run"] == 2);
    assert_eq!(shop.run_states(), ["finished", "finished"]);
    assert_eq!(daemon.terminate(), 0);
}

/// The page must not show "true" for a machine whose last measurement was not identified.
pub fn failed_identification_outdates_the_previous_result() {
    let shop = shop_with_page_and_passed_run();
    copy_run_1_without_estimate(&shop, 12);
    let daemon = shop.start_daemon("fast");
    let http = daemon.http();
    daemon.wait_for_log("run 2 is not identified");
    let standing = http.machine_state();
    let result = &standing["result"];
    assert_eq!((&result["run"], &result["outdated"]), (&json!(1), &json!(true)), "{standing}");
    assert_eq!((&standing["not_identified"], &standing["state"]), (&json!(2), &json!("waiting")));
    let machine = http.get_text(MACHINE_PAGE_PATH);
    for words in ["class=\"glance none\"", "newest run is not identified", "Run 2</a>"] {
        assert!(machine.contains(words), "{words}: {machine}");
    }
    assert!(!machine.contains("Result of run 1"), "{machine}");
    assert_eq!(http.get_json("/api/v1/runs")[0]["state"], "not identified");
    assert!(http.get_text("/runs").contains("<span>not identified</span>"));
    let run = http.get_text("/runs/2");
    assert!(run.contains("run 2 is not identified") && run.contains("has no reading"), "{run}");
    // A restart of the daemon does not try it again; an operator may.
    assert_eq!(daemon.terminate(), 0);
    let faults = || identification_fault_count_of_run_2(&shop);
    assert_eq!(faults(), 1);
    let again = shop.run_trued(&["resume", "2"]);
    assert_eq!(again.status.code(), Some(1));
    assert!(stderr(&again).contains("has no reading"), "{}", stderr(&again));
    assert_eq!((faults(), shop.run_states().pop().unwrap().as_str()), (2, "not identified"));
}

/// Number of identification faults in the history of run 2.
fn identification_fault_count_of_run_2(shop: &MachineShop) -> usize {
    let told = String::from_utf8(shop.run_trued(&["show", "2"]).stdout).unwrap();
    told.lines().filter(|line| line.contains("fault: no estimate")).count()
}
