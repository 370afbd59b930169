//! `trued check` names each planted mistake in words that occur for no other mistake.

mod command_line;
mod link_mistakes;
mod machine_mistakes;
mod operator_questions;
mod sensor_mistakes;
mod simulated_machine_checks;
mod stylus_contact;
mod test_sensors;

use crate::support::harness::{Pool, Trials, trials};
use std::sync::Mutex;
use std::thread;

use machine_mistakes::{MACHINE_MISTAKES, PlantedMistake};
use simulated_machine_checks::{
    changed_machine_toml, check_against_other_machine, failure_lines, run_check, toml_with_control_keys,
};
use trued::commissioning::{CheckSummary, CheckVerdict};
use trued::setup::SimulationPace;

/// All mistakes, the longest first: those of the links wait for a timeout.
fn all_mistakes() -> impl Iterator<Item = &'static PlantedMistake> {
    link_mistakes::LINK_MISTAKES.iter().chain(sensor_mistakes::SENSOR_MISTAKES).chain(MACHINE_MISTAKES)
}

/// Number of parallel checks. Most of them wait; more would be late on a small computer, and lateness is itself a
/// finding.
const PARALLEL_CHECK_COUNT: usize = 6;

/// Each mistake with the summary of its check.
fn check_each_mistake() -> Vec<(&'static PlantedMistake, CheckSummary)> {
    let (rows, done) = (Mutex::new(all_mistakes()), Mutex::new(Vec::new()));
    let next = || rows.lock().unwrap().next();
    thread::scope(|scope| {
        for _ in 0..PARALLEL_CHECK_COUNT {
            scope.spawn(|| {
                while let Some(row) = next() {
                    let summary = (row.run_check)();
                    done.lock().unwrap().push((row, summary));
                }
            });
        }
    });
    done.into_inner().unwrap()
}

/// Failures whose text is repeated by another failure of the summary, alone or within a sentence.
fn findings_named_twice(summary: &CheckSummary) -> Vec<&str> {
    let failed = summary.findings.iter().filter(|finding| finding.verdict == CheckVerdict::Failed);
    let whats: Vec<&str> = failed.map(|finding| finding.what.as_str()).collect();
    let is_repeated = |what: &&str| whats.iter().filter(|other| other.contains(*what)).count() > 1;
    whats.iter().copied().filter(is_repeated).collect()
}

fn each_planted_mistake_is_named_and_no_other() {
    let mut wrong = Vec::new();
    for (row, summary) in check_each_mistake() {
        let failed = failure_lines(&summary);
        println!("--- {}\n{failed}", row.name);
        if !failed.contains(row.expected_phrase) {
            wrong.push(format!("{}: not named (`{}`):\n{summary}", row.name, row.expected_phrase));
        }
        for what in findings_named_twice(&summary) {
            wrong.push(format!("{}: `{what}` is named twice:\n{summary}", row.name));
        }
        for other in all_mistakes().filter(|other| other.expected_phrase != row.expected_phrase) {
            if failed.contains(other.expected_phrase) {
                wrong.push(format!("{}: `{}` is said:\n{summary}", row.name, other.expected_phrase));
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n\n"));
}

/// A jog beyond the travel limits of the control would end in an alarm.
fn an_axis_beyond_the_controls_limits_is_not_jogged() {
    let summary = link_mistakes::check_short_travel();
    let jogged = |axis: &str| {
        let mut findings = summary.findings.iter();
        findings.any(|finding| finding.what.starts_with(&format!("{axis} +1 mm")))
    };
    assert!(!jogged("X") && jogged("Y"), "{summary}");
    let text = summary.to_string();
    assert!(text.contains("X: the limits differ from the limits of the control"), "{text}");
}

fn sound_machine_passes_with_each_control() {
    let controls = [
        "wire = \"memory\"",
        "wire = \"pty\"",
        "speaks = \"modbus\"\nwire = \"tcp\"",
        "speaks = \"modbus\"\nwire = \"pty\"",
        "speaks = \"modbus-program\"",
    ];
    thread::scope(|scope| {
        let check =
            |keys| scope.spawn(move || (keys, run_check(&toml_with_control_keys(keys, &changed_machine_toml(&[])))));
        let all: Vec<_> = controls.into_iter().map(check).collect();
        for one in all {
            let (keys, summary) = one.join().unwrap();
            assert_eq!(summary.finding_count(CheckVerdict::Failed), 0, "{keys}\n{summary}");
            let told = summary.to_string();
            for words in [
                "open at rest, closed while the stylus is deflected",
                "the hold stopped the jog",
                "the control latches contacts itself",
            ] {
                assert!(told.contains(words), "{keys}: {words}\n{summary}");
            }
            for axis in ["X ", "Y ", "Z ", "B ", "C "] {
                let seen =
                    |line: &str| line.starts_with("axes    ok") && line.contains(axis) && line.contains("as expected");
                assert!(told.lines().any(seen), "{keys}: {axis}\n{summary}");
            }
            let open = summary.findings.iter();
            let open = open.filter(|finding| finding.verdict == CheckVerdict::NotChecked);
            let open: Vec<_> = open.map(|finding| finding.what.as_str()).collect();
            assert!(matches!(open[..], [what] if what.starts_with("S: ")), "{keys}\n{summary}");
        }
    });
}

/// As in an operator's machine file: the program itself simulates nothing.
fn sound_control_in_another_process_passes() {
    for keys in ["wire = \"pty\"", "speaks = \"modbus\""] {
        let truth = toml_with_control_keys(keys, &changed_machine_toml(&[]));
        let dialect = |keys| keys + "\ndialect = \"grbl-m19\"";
        let summary =
            check_against_other_machine(&changed_machine_toml(&[]), &truth, SimulationPace::Immediate, dialect);
        assert_eq!(summary.finding_count(CheckVerdict::Failed), 0, "{keys}\n{summary}");
    }
}

/// The scan of a PLC scatters touches by 14.4 µm at 300 mm/min. A probe whose declared repeatability is
/// as large has this scatter at every feed and is not reported as a PLC.
fn scatter_of_the_probe_is_not_reported_as_a_plc_cycle() {
    let poor = changed_machine_toml(&[("repeatability_um = 0.5", "repeatability_um = 14.4")]);
    let summary = run_check(&poor);
    assert_eq!(summary.finding_count(CheckVerdict::Failed), 0, "{summary}");
    assert!(summary.to_string().contains("the control latches contacts itself"), "{summary}");
}

/// Twelve touches at each feed scatter by more than the declared value, but within the bound for so few touches.
fn scatter_within_the_bound_for_few_touches_is_reported() {
    let poorer = changed_machine_toml(&[("repeatability_um = 0.5", "repeatability_um = 0.6")]);
    let truth = toml_with_control_keys("wire = \"pty\"", &poorer);
    let dialect = |keys| keys + "\ndialect = \"grbl-m19\"";
    let summary = check_against_other_machine(&changed_machine_toml(&[]), &truth, SimulationPace::Immediate, dialect);
    assert_eq!(summary.finding_count(CheckVerdict::Failed), 0, "{summary}");
    let told = summary.to_string();
    let line = told.lines().find(|line| line.contains("the touches have a standard deviation of")).unwrap();
    let number = |before: &str| -> f64 {
        let (_, rest) = line.split_once(before).unwrap_or_else(|| panic!("{before}: {line}"));
        rest.split(' ').next().unwrap().parse().unwrap()
    };
    let (seen, bound) = (number("standard deviation of "), number("detectable only above "));
    // 0.5 µm and steps of 1 µm give 0.58 µm; χ² with 10 degrees of freedom is below 29.6 in 99.9 % of cases.
    assert!(0.5 < seen && seen < bound && (0.9..1.1).contains(&bound), "{line}");
}

/// The touches of a check are stored as a run of latch-delay.
fn touches_of_check_are_stored_as_a_latch_delay_run() {
    let folder = tempfile::tempdir().unwrap();
    let trued = |arguments: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_trued"));
        let ran = command.arg("--state").arg(folder.path()).args(arguments).output().unwrap();
        (ran.status.code(), String::from_utf8(ran.stdout).unwrap())
    };
    let (code, told) = trued(&["check"]);
    assert_eq!(code, Some(0), "{told}");
    let (_, runs) = trued(&["runs"]);
    assert_eq!(runs.lines().filter(|line| line.contains("latch-delay")).count(), 1, "{runs}");
    let (_, shown) = trued(&["show", "1"]);
    assert!(shown.contains("t_latch"), "{shown}");
}

pub fn trials() -> Trials {
    trials![Pool::Computing, 40;
        each_planted_mistake_is_named_and_no_other,
        an_axis_beyond_the_controls_limits_is_not_jogged,
    ]
    .with_trials(trials![Pool::Waiting, 0;
        sound_machine_passes_with_each_control,
        sound_control_in_another_process_passes,
        scatter_of_the_probe_is_not_reported_as_a_plc_cycle,
        scatter_within_the_bound_for_few_touches_is_reported,
        touches_of_check_are_stored_as_a_latch_delay_run,
        operator_questions::without_operator_probe_axes_and_hold_are_unchecked,
        operator_questions::a_refusal_by_the_operator_prevents_motion,
        operator_questions::no_motion_is_requested_before_the_probe_was_deflected,
        operator_questions::laser_machine_check_asks_whether_the_probe_is_mounted,
        operator_questions::axis_is_not_moved_back_after_the_operator_leaves,
        operator_questions::a_stop_at_rest_leaves_no_hold,
        operator_questions::a_machine_that_was_moved_by_hand_is_not_jogged,
        stylus_contact::stylus_in_contact_is_retracted_in_steps_and_the_check_ends,
        stylus_contact::stylus_in_contact_is_retracted_with_each_control_protocol,
        stylus_contact::nothing_moves_if_the_operator_refuses_the_retract,
        stylus_contact::without_a_person_a_stylus_stays_in_contact_and_the_remedy_is_named,
        stylus_contact::stop_at_the_retract_direction_question_moves_nothing,
        stylus_contact::a_retract_towards_a_declared_body_is_refused_and_asked_for_again,
        command_line::without_a_machine_file_the_simulated_machine_is_checked,
        command_line::a_mistake_exits_with_1_and_is_in_the_json_output,
        command_line::real_control_without_terminal_neither_moves_nor_hangs,
        command_line::a_control_that_refuses_its_settings_is_a_failure,
        command_line::ctrl_c_holds_the_machine_and_exits_with_5,
        test_sensors::sound_sensors_pass,
        test_sensors::answering_thermometer_passes,
    ])
}
