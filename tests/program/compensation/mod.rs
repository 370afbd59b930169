//! `trued compensate` with a substitute for `halcmd`.

mod joints;
mod page;
mod shop;
mod verification;

use std::path::Path;

use self::shop::{CALLS_OF_WRITE, CompensationShop, INI_TEXT, PIN_LINES};
use crate::support::harness::{Pool, Trials, trials};
use crate::support::machine_shop::{MachineShop, built_in_machine_text, stderr};
use serde_json::json;
use trued::compensation::{
    CompensationWriteError, CompensationWriter, describe_compensation_values, open_target, propose_for_control,
};
use trued::setup::{self, MachineFile};
use trued::store::{
    CompensationState, CompensationValue, Journal, MachineLock, NewCompensation, NewRun, RunId, RunState,
};

fn approved_values_are_written_and_restored() {
    let shop = CompensationShop::new();
    let proposal = shop.proposal();
    let kept: Vec<bool> = proposal["positions"].as_array().unwrap().iter().map(|own| own["kept"].is_object()).collect();
    assert_eq!(kept, [false, false, true, true], "{proposal}");
    assert!(proposal["predicted"][0]["largest_um"].as_f64().unwrap() > 60.0, "{proposal}");
    assert!(proposal["predicted"][1]["largest_um"].as_f64().unwrap() < 0.2, "{proposal}");
    let hash = shop.hash();
    assert_eq!(proposal["sha256"], hash, "{proposal}");
    shop.assert_refused(&shop.compensate(&["write", "1", "--approve", &hash, "--who", " "]), "name of a person");
    let hal = shop.shop.path_text("values.hal");
    let written = shop.write(&hash);
    assert!(written.status.success() && shop.is_corrected(), "{}", stderr(&written));
    assert!(shop.compensate(&["status", "--hal", &hal]).status.success());
    shop.assert_refused(&shop.compensate(&["status", "--hal", &hal]), "name a new file");
    let lines = std::fs::read_to_string(&hal).unwrap();
    assert_eq!(lines.lines().next(), Some("setp xyzbc-trt-kins.x-rot-point 0.05"), "{lines}");
    assert_eq!(lines.lines().count(), 5, "{lines}");
    let status = String::from_utf8(shop.compensate(&["status"]).stdout).unwrap();
    assert!(status.contains("written by Ada"), "{status}");
    // The same hash again: the control now holds other values.
    shop.assert_refused(&shop.write(&hash), "is not the present proposal");
    let undone = shop.compensate(&["undo", "--who", "Bob"]);
    assert!(undone.status.success() && shop.is_as_before(), "{}", stderr(&undone));
    let trend = String::from_utf8(shop.shop.run_trued(&["trend"]).stdout).unwrap();
    for part in ["compensation 1 (linuxcnc-trunnion) from run 1: written", "from run 1: undone"] {
        assert!(trend.contains(part), "{part}: {trend}");
    }
    shop.assert_refused(&shop.compensate(&["undo", "--who", "Bob"]), "nothing to undo");
    shop.assert_refused(&shop.compensate(&["finish", "--who", "Bob"]), "nothing to finish");
    // The values are as before, and so is the proposal.
    assert!(shop.write(&hash).status.success() && shop.is_corrected());
}

/// The sheet needs no control.
fn sheet_lists_the_measured_positions() {
    let shop = CompensationShop::new();
    let name = shop.shop.path_text("errors");
    let write_sheet = || shop.shop.run_trued(&["compensate", "sheet", "1", "--out", &name]);
    assert!(write_sheet().status.success());
    let table = std::fs::read_to_string(format!("{name}.csv")).unwrap();
    let lines: Vec<&str> = table.lines().collect();
    assert_eq!(lines[0], "quantity,value,U,unit,stated,remark");
    assert_eq!(lines[3..], ["X of C,0.0500,0.0010,mm,0.0000,", "Y of C,-0.0300,0.0010,mm,0.0000,"]);
    assert!(lines[1].starts_with("X of B,,,mm,0.0000,\"the self-calibration run does not determine"), "{table}");
    let page = std::fs::read_to_string(format!("{name}.html")).unwrap();
    assert!(page.contains("Not verified on this control") && page.contains("<svg"), "{page}");
    assert!(!page.contains("simulated machine"), "{page}");
    shop.assert_refused(&write_sheet(), "cannot be written");
    assert_eq!(std::fs::read_to_string(format!("{name}.csv")).unwrap(), table);
}

fn write_that_is_not_safe_is_refused() {
    let shop = CompensationShop::new();
    let hash = shop.hash();
    shop.assert_refused(&shop.write(&"0".repeat(64)), "is not the present proposal");
    for (from, to, expected) in [
        (
            "float IN 0 motion.switchkins-type",
            "float IN 1 motion.switchkins-type",
            "the kinematics apply the values now",
        ),
        ("TRUE motion.in-position", "FALSE motion.in-position", "the machine moves"),
        ("0.0123 xyz", "0.0124 xyz", "is not the present proposal"),
        ("rot-point\n10 float IN 0.02", "rot-point <== offset\n10 float IN 0.02", "connected to the signal offset"),
        ("0.0123 xyz", "nan xyz", "not a finite number"),
        ("kins.x-offset", "kins.x_offset", "no pin xyzbc-trt-kins.x-offset"),
        ("kins.z-offset", "kins.z-offset\n10 bit OUT TRUE xyzbc-trt-kins.conventional-directions", "another direction"),
    ] {
        shop.replace_pins(from, to);
        shop.assert_refused(&shop.write(&hash), expected);
        shop.replace_pins(to, from);
    }
    for (from, to, expected) in [
        ("LINEAR_UNITS = mm", "LINEAR_UNITS = inch", "is not mm"),
        ("KINEMATICS = xyzbc-trt-kins", "KINEMATICS = trivkins", "not xyzac-trt-kins or xyzbc-trt-kins"),
        ("KINEMATICS = xyzbc-trt-kins", "KINEMATICS = xyzac-trt-kins", "no pin xyzac-trt-kins"),
    ] {
        std::fs::write(shop.shop.path("rig.ini"), INI_TEXT.replace(from, to)).unwrap();
        shop.assert_refused(&shop.write(&hash), expected);
    }
    std::fs::write(shop.shop.path("rig.ini"), INI_TEXT).unwrap();
    assert!(shop.is_as_before() && shop.state().is_none());
    // The machine file has changed since the run.
    shop.shop.replace_in_machine_file("[0.012, -0.008, 0.0]", "[0.012, -0.009, 0.0]");
    shop.assert_refused(&shop.write(&hash), "differ from those of run 1");
}

/// Another person changes a value after the first one is written.
fn value_changed_during_the_write_is_kept() {
    let shop = CompensationShop::new();
    let hash = shop.hash();
    std::fs::write(shop.shop.path("intruder"), "").unwrap();
    shop.assert_refused(&shop.write(&hash), "y-rot-point is 7 mm, neither 0.02 mm nor -0.03 mm");
    assert_eq!((shop.pin("x-rot-point"), shop.pin("y-rot-point")), (0.05, 7.0));
    assert_eq!(shop.state(), Some(CompensationState::Writing));
}

/// A control that stores a value one step off: the compensation is unfinished, and is undone.
fn false_read_back_is_reported() {
    let shop = CompensationShop::new();
    let hash = shop.hash();
    std::fs::write(shop.shop.path("falsified"), "").unwrap();
    shop.assert_refused(&shop.write(&hash), "reads 0.0501 mm instead of 0.05 mm");
    std::fs::remove_file(shop.shop.path("falsified")).unwrap();
    assert_eq!(shop.state(), Some(CompensationState::Writing));
    shop.assert_refused(&shop.write(&shop.hash()), "is unfinished");
    // Neither the value before nor the one after: a person must decide.
    shop.assert_refused(&shop.compensate(&["undo", "--who", "Ada"]), "neither 0.0123 mm nor 0.05 mm");
    shop.replace_pins("0.0501 xyz", "0.05 xyz");
    assert!(shop.compensate(&["undo", "--who", "Ada"]).status.success() && shop.is_as_before());
    // A control that refuses the second value.
    std::fs::write(shop.shop.path("refused"), "xyzbc-trt-kins.y-rot-point").unwrap();
    shop.assert_refused(&shop.write(&hash), "is refused");
    assert_eq!((shop.pin("x-rot-point"), shop.pin("y-rot-point")), (0.05, 0.02));
    std::fs::remove_file(shop.shop.path("refused")).unwrap();
    assert!(shop.compensate(&["finish", "--who", "Ada"]).status.success() && shop.is_corrected());
}

/// Killed before and after each call of `halcmd`: then the control has the values before, those after, or the journal
/// states that it may have both; undo and finish lead out of it.
fn program_killed_at_any_step_leaves_a_known_state() {
    let shop = CompensationShop::new();
    let hash = shop.hash();
    let kill_at = shop.shop.path("kill-at");
    for call in 1..=CALLS_OF_WRITE {
        let ways_out = if call % 2 == 0 { ["undo", "finish"] } else { ["finish", "undo"] };
        for (moment, way_out) in ["", "+"].into_iter().zip(ways_out) {
            std::fs::write(shop.shop.path("calls"), "0").unwrap();
            std::fs::write(&kill_at, format!("{call}{moment}")).unwrap();
            let killed = shop.write(&hash);
            assert_eq!(killed.status.code(), None, "call {call}: {}", stderr(&killed));
            std::fs::remove_file(&kill_at).unwrap();
            match shop.state() {
                None | Some(CompensationState::Undone) => assert!(shop.is_as_before(), "call {call}{moment}"),
                Some(CompensationState::Writing) => {
                    let ended = shop.compensate(&[way_out, "--who", "Ada"]);
                    assert!(ended.status.success(), "{}", stderr(&ended));
                    let is_expected = if way_out == "undo" { shop.is_as_before() } else { shop.is_corrected() };
                    assert!(is_expected, "call {call}{moment}, {way_out}");
                }
                other => panic!("call {call}{moment}: {other:?}"),
            }
            if shop.is_corrected() {
                assert!(shop.compensate(&["undo", "--who", "Ada"]).status.success());
            }
            assert!(shop.is_as_before());
        }
    }
    // Killed within an undo: `undo` restores the rest, `finish` writes the corrected values again.
    assert!(shop.write(&hash).status.success());
    for call in 1..=CALLS_OF_WRITE {
        std::fs::write(shop.shop.path("calls"), "0").unwrap();
        std::fs::write(&kill_at, call.to_string()).unwrap();
        assert_eq!(shop.compensate(&["undo", "--who", "Ada"]).status.code(), None);
        std::fs::remove_file(&kill_at).unwrap();
        if shop.state() == Some(CompensationState::Undoing) && call % 2 == 0 {
            assert!(shop.compensate(&["finish", "--who", "Ada"]).status.success());
        } else if shop.state() == Some(CompensationState::Undoing) {
            assert!(shop.compensate(&["undo", "--who", "Ada"]).status.success());
            assert!(shop.is_as_before() && shop.write(&hash).status.success());
        }
        assert!(shop.is_corrected() && shop.state() == Some(CompensationState::Written), "call {call}");
    }
}

fn expired_proposal_is_refused() {
    let shop = CompensationShop::new();
    let file = MachineFile::read(Path::new(&shop.shop.machine_path())).unwrap();
    let folder = shop.shop.state_folder();
    let (journal, lock) = (Journal::open(&folder).unwrap(), MachineLock::acquire(&folder, "linuxcnc-sim5").unwrap());
    let target = open_target(&file, None).unwrap();
    let options = methods::compensation::ProposalOptions { applies_insignificant_changes: false, max_change_mm: 0.5 };
    let mut proposal = propose_for_control(&journal, RunId(1), &file, &*target, options).unwrap();
    let writer = CompensationWriter { journal: &journal, lock: &lock, target: &*target, who: "Ada" };
    proposal.measured_at -= std::time::Duration::from_secs(25 * 3600);
    let refused = writer.write(&proposal, &proposal.sha256().unwrap()).unwrap_err();
    assert!(matches!(refused, CompensationWriteError::Expired { run: 1 }), "{refused}");
    assert!(shop.is_as_before());
    // Another process holds the machine.
    shop.assert_refused(&shop.write(&shop.hash()), "is in use");
}

/// The readings before and after the write would be of two machines.
fn write_is_refused_while_a_run_can_be_resumed() {
    let shop = CompensationShop::new();
    let hash = shop.hash();
    let file = MachineFile::read(Path::new(&shop.shop.machine_path())).unwrap();
    let journal = Journal::open(&shop.shop.state_folder()).unwrap();
    let plan = setup::plan_without_steps(&file, "self-calibration", json!({}));
    let held = journal.begin_run(&NewRun { machine_file_text: file.text().to_owned(), plan }).wait().unwrap();
    journal.set_state(held, RunState::Held).wait().unwrap();
    shop.assert_refused(&shop.write(&hash), "run 2 of this machine can still be resumed");
    assert!(shop.is_as_before() && shop.state().is_none());
    journal.set_state(held, RunState::NotResumable).wait().unwrap();
    assert!(shop.write(&hash).status.success());
}

/// After a restart the control has the values of its HAL files again.
fn run_records_values_of_the_control_and_their_differences() {
    let shop = CompensationShop::new();
    let file = MachineFile::read(Path::new(&shop.shop.machine_path())).unwrap();
    let describe = || {
        let journal = Journal::open(&shop.shop.state_folder()).unwrap();
        describe_compensation_values(&file, &journal.compensations("linuxcnc-sim5").unwrap())
    };
    assert!(shop.write(&shop.hash()).status.success());
    let [values, demand] = &describe()[..] else { panic!("{:?}", describe()) };
    assert!(demand.starts_with("compensation 1 is not verified"), "{demand}");
    assert!(values.contains("xyzbc-trt-kins.x-rot-point 0.05 mm, xyzbc-trt-kins.y-rot-point -0.03 mm"), "{values}");
    std::fs::write(shop.shop.path("pins"), PIN_LINES).unwrap();
    let [_, difference] = &describe()[..] else { panic!("{:?}", describe()) };
    assert!(
        difference.contains("compensation 1, which is written: xyzbc-trt-kins.x-rot-point is 0.0123 mm, not 0.05 mm")
    );
    std::fs::remove_file(shop.shop.path("pins")).unwrap();
    let [unknown] = &describe()[..] else { panic!("{:?}", describe()) };
    assert!(unknown.starts_with("the compensation values of the control (linuxcnc-trunnion) are unknown"), "{unknown}");
}

fn no_run_starts_while_a_compensation_is_unfinished() {
    let shop = MachineShop::with_machine_file(&built_in_machine_text());
    let file = MachineFile::read(Path::new(&shop.machine_path())).unwrap();
    {
        let journal = Journal::open(&shop.state_folder()).unwrap();
        let plan = setup::plan_without_steps(&file, "self-calibration", json!({}));
        let run = journal.begin_run(&NewRun { machine_file_text: String::new(), plan }).wait().unwrap();
        journal.set_state(run, RunState::NotResumable).wait().unwrap();
        let (name, before_text) = ("x".to_owned(), "0".to_owned());
        let changes = vec![CompensationValue { name, before_mm: 0.0, before_text, after_mm: 0.1 }];
        let (machine, who) = (file.machine.name.clone(), "Ada".to_owned());
        let target = "linuxcnc-trunnion".to_owned();
        let new = NewCompensation { machine, target, run, who, proposal_sha256: String::new(), changes };
        journal.begin_compensation(&new).wait().unwrap();
    }
    let refused = shop.run_self_calibration();
    let text = stderr(&refused);
    assert!(
        text.contains("compensation 1 is unfinished") && text.contains("compensate undo --target linuxcnc-trunnion"),
        "{text}"
    );
    assert_eq!(shop.run_states(), ["closed", "failed"]);
    let refused = shop.run_trued(&["check", "--machine", &shop.machine_path()]);
    assert!(stderr(&refused).contains("compensation 1 is unfinished"), "{}", stderr(&refused));
    let journal = Journal::open(&shop.state_folder()).unwrap();
    journal.set_compensation_state(1, CompensationState::Undone, "Ada").wait().unwrap();
    assert!(shop.run_self_calibration().status.success());
}

pub fn trials() -> Trials {
    trials![Pool::Computing, 0;
        joints::corrections_of_travel_are_written_confirmed_and_restored,
        joints::interrupted_write_leaves_whole_files,
        joints::files_of_the_control_are_found_and_kept,
        joints::run_with_a_file_that_is_not_in_effect_gives_no_proposal,
        sheet_lists_the_measured_positions,
        page::metrologist_approves_values_on_the_page,
        page::daemon_killed_during_a_write_shows_and_finishes_it,
        page::metrologist_stores_a_verification,
        page::page_without_tokens_writes_nothing,
        page::values_over_the_link_are_read_by_the_worker,
        approved_values_are_written_and_restored,
        write_that_is_not_safe_is_refused,
        value_changed_during_the_write_is_kept,
        false_read_back_is_reported,
        program_killed_at_any_step_leaves_a_known_state,
        expired_proposal_is_refused,
        write_is_refused_while_a_run_can_be_resumed,
        verification::second_run_verifies_a_compensation,
        verification::contradicting_run_leaves_the_values_to_a_person,
        verification::verification_without_evidence_is_refused,
        verification::verification_by_another_state_of_the_machine_is_refused,
        run_records_values_of_the_control_and_their_differences,
        no_run_starts_while_a_compensation_is_unfinished,
    ]
}
