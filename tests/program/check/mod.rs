//! `trued check` names each planted mistake in words that occur for no other mistake.

mod bench;
mod contact;
mod links;
mod mistakes;
mod people;
mod program;
mod sensor_mistakes;
mod sensors;

use crate::support::harness::{Pool, Trials, trials};
use std::sync::Mutex;
use std::thread;

use bench::{changed_machine, check_against_other_machine, failure_lines, machine_with_control, run_check};
use mistakes::{MACHINE_MISTAKES, Mistake};
use trued::commissioning::{CheckSummary, Verdict};
use trued::setup::SimulationPace;

/// All mistakes, the longest first: those of the links wait for a timeout.
fn all_mistakes() -> impl Iterator<Item = &'static Mistake> {
    links::LINK_MISTAKES.iter().chain(sensor_mistakes::SENSOR_MISTAKES).chain(MACHINE_MISTAKES)
}

/// Number of parallel checks. Most of them wait; more would be late on a small computer, and lateness is itself a
/// finding.
const WORKER_COUNT: usize = 6;

/// Each mistake with the summary of its check.
fn check_each_mistake() -> Vec<(&'static Mistake, CheckSummary)> {
    let (rows, done) = (Mutex::new(all_mistakes()), Mutex::new(Vec::new()));
    let next = || rows.lock().unwrap().next();
    thread::scope(|scope| {
        for _ in 0..WORKER_COUNT {
            scope.spawn(|| {
                while let Some(row) = next() {
                    let summary = (row.check)();
                    done.lock().unwrap().push((row, summary));
                }
            });
        }
    });
    done.into_inner().unwrap()
}

/// Failures whose text is repeated by another failure of the summary, alone or within a sentence.
fn findings_named_twice(summary: &CheckSummary) -> Vec<&str> {
    let failed = summary.findings.iter().filter(|finding| finding.verdict == Verdict::Failed);
    let whats: Vec<&str> = failed.map(|finding| finding.what.as_str()).collect();
    let is_repeated = |what: &&str| whats.iter().filter(|other| other.contains(*what)).count() > 1;
    whats.iter().copied().filter(is_repeated).collect()
}

fn each_planted_mistake_is_named_and_no_other() {
    let mut wrong = Vec::new();
    for (row, summary) in check_each_mistake() {
        let failed = failure_lines(&summary);
        println!("--- {}\n{failed}", row.name);
        if !failed.contains(row.phrase) {
            wrong.push(format!("{}: not named (`{}`):\n{summary}", row.name, row.phrase));
        }
        for what in findings_named_twice(&summary) {
            wrong.push(format!("{}: `{what}` is named twice:\n{summary}", row.name));
        }
        for other in all_mistakes().filter(|other| other.phrase != row.phrase) {
            if failed.contains(other.phrase) {
                wrong.push(format!("{}: `{}` is said:\n{summary}", row.name, other.phrase));
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n\n"));
}

/// A jog beyond the travel limits of the control would end in an alarm.
fn regress_an_axis_beyond_the_controls_limits_is_not_jogged() {
    let summary = links::check_short_travel();
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
        let check = |keys| scope.spawn(move || (keys, run_check(&machine_with_control(keys, &changed_machine(&[])))));
        let all: Vec<_> = controls.into_iter().map(check).collect();
        for one in all {
            let (keys, summary) = one.join().unwrap();
            assert_eq!(summary.finding_count(Verdict::Failed), 0, "{keys}\n{summary}");
            let told = summary.to_string();
            for words in [
                "open at rest, closed while deflected",
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
            let open = open.filter(|finding| finding.verdict == Verdict::NotLookedAt);
            let open: Vec<_> = open.map(|finding| finding.what.as_str()).collect();
            assert!(matches!(open[..], [what] if what.starts_with("S: ")), "{keys}\n{summary}");
        }
    });
}

/// As in an operator's machine file: the program itself simulates nothing.
fn sound_control_in_another_process_passes() {
    for keys in ["wire = \"pty\"", "speaks = \"modbus\""] {
        let truth = machine_with_control(keys, &changed_machine(&[]));
        let dialect = |keys| keys + "\ndialect = \"grbl-m19\"";
        let summary = check_against_other_machine(&changed_machine(&[]), &truth, SimulationPace::Fast, dialect);
        assert_eq!(summary.finding_count(Verdict::Failed), 0, "{keys}\n{summary}");
    }
}

/// The scan of a PLC scatters touches by 14.4 µm at 300 mm/min. A probe whose declared repeatability is
/// as large has this scatter at every feed and is not reported as a PLC.
fn scatter_of_the_probe_is_not_reported_as_a_plc_cycle() {
    let poor = changed_machine(&[("repeatability_um = 0.5", "repeatability_um = 14.4")]);
    let summary = run_check(&poor);
    assert_eq!(summary.finding_count(Verdict::Failed), 0, "{summary}");
    assert!(summary.to_string().contains("the control latches contacts itself"), "{summary}");
}

/// Twelve touches at each feed scatter by more than the declared value, but within the bound for so few touches.
fn scatter_that_few_touches_may_show_is_told_with_its_bound() {
    let poorer = changed_machine(&[("repeatability_um = 0.5", "repeatability_um = 0.6")]);
    let truth = machine_with_control("wire = \"pty\"", &poorer);
    let dialect = |keys| keys + "\ndialect = \"grbl-m19\"";
    let summary = check_against_other_machine(&changed_machine(&[]), &truth, SimulationPace::Fast, dialect);
    assert_eq!(summary.finding_count(Verdict::Failed), 0, "{summary}");
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
        regress_an_axis_beyond_the_controls_limits_is_not_jogged,
    ]
    .with(trials![Pool::Waiting, 0;
        sound_machine_passes_with_each_control,
        sound_control_in_another_process_passes,
        scatter_of_the_probe_is_not_reported_as_a_plc_cycle,
        scatter_that_few_touches_may_show_is_told_with_its_bound,
        touches_of_check_are_stored_as_a_latch_delay_run,
        people::without_operator_nothing_moves_and_unchecked_parts_are_listed,
        people::a_refusal_by_the_operator_prevents_motion,
        people::no_motion_before_the_probe_was_deflected,
        people::where_a_sensor_sits_in_the_probes_place_the_probe_is_asked_for,
        people::whoever_leaves_while_an_axis_is_away_does_not_see_it_go_back,
        people::regress_a_stop_at_rest_leaves_no_hold,
        people::a_machine_that_was_moved_by_hand_is_not_jogged,
        contact::a_stylus_in_contact_is_led_out_step_by_step_and_the_check_ends,
        contact::a_stylus_in_contact_is_led_out_whatever_the_control_speaks,
        contact::nothing_moves_while_the_stylus_stays_in_contact,
        contact::without_a_person_a_stylus_stays_in_contact_and_the_remedy_is_named,
        contact::a_stop_while_the_direction_is_asked_for_moves_nothing,
        contact::a_retract_towards_a_declared_body_is_refused_and_asked_for_again,
        program::without_a_machine_file_the_simulated_machine_is_checked_by_itself,
        program::a_mistake_exits_with_1_and_is_in_the_json_output,
        program::real_control_without_terminal_neither_moves_nor_hangs,
        program::regress_a_control_that_refuses_its_settings_is_a_failure,
        program::ctrl_c_holds_the_machine_and_exits_with_5,
        sensors::sound_sensors_pass,
        sensors::answering_thermometer_passes,
    ])
}
