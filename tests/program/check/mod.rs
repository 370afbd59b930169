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

use bench::{against, checked, failures, machine, with_control};
use mistakes::{MISTAKES, Mistake};
use trued::commissioning::{Summary, Verdict};
use trued::setup::Pace;

/// All mistakes, the longest first: those of the links wait for a timeout.
fn all() -> impl Iterator<Item = &'static Mistake> {
    links::MISTAKES.iter().chain(sensor_mistakes::MISTAKES).chain(MISTAKES)
}

/// Number of parallel checks. Most of them wait; more would be late on a small computer, and lateness is itself a
/// finding.
const WORKERS: usize = 6;

/// Each mistake with the summary of its check.
fn each() -> Vec<(&'static Mistake, Summary)> {
    let (rows, done) = (Mutex::new(all()), Mutex::new(Vec::new()));
    let next = || rows.lock().unwrap().next();
    thread::scope(|scope| {
        for _ in 0..WORKERS {
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
fn named_twice(summary: &Summary) -> Vec<&str> {
    let failed = summary.findings.iter().filter(|finding| finding.verdict == Verdict::Failed);
    let whats: Vec<&str> = failed.map(|finding| finding.what.as_str()).collect();
    let is_repeated = |what: &&str| whats.iter().filter(|other| other.contains(*what)).count() > 1;
    whats.iter().copied().filter(is_repeated).collect()
}

fn each_planted_mistake_is_named_and_no_other() {
    let mut wrong = Vec::new();
    for (row, summary) in each() {
        let failed = failures(&summary);
        println!("--- {}\n{failed}", row.name);
        if !failed.contains(row.phrase) {
            wrong.push(format!("{}: not named (`{}`):\n{summary}", row.name, row.phrase));
        }
        for what in named_twice(&summary) {
            wrong.push(format!("{}: `{what}` is named twice:\n{summary}", row.name));
        }
        for other in all().filter(|other| other.phrase != row.phrase) {
            if failed.contains(other.phrase) {
                wrong.push(format!("{}: `{}` is said:\n{summary}", row.name, other.phrase));
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n\n"));
}

/// A jog beyond the travel limits of the control would end in an alarm.
fn regress_an_axis_beyond_the_controls_limits_is_not_jogged() {
    let summary = links::short_travel();
    let jogged = |axis: &str| {
        let mut findings = summary.findings.iter();
        findings.any(|finding| finding.what.starts_with(&format!("{axis} +1 mm")))
    };
    assert!(!jogged("X") && jogged("Y"), "{summary}");
    let text = summary.to_string();
    assert!(text.contains("X: the limits differ from the limits of the control"), "{text}");
}

fn a_sound_machine_passes_whatever_it_speaks() {
    let controls = [
        "wire = \"memory\"",
        "wire = \"pty\"",
        "speaks = \"modbus\"\nwire = \"tcp\"",
        "speaks = \"modbus\"\nwire = \"pty\"",
        "speaks = \"modbus-program\"",
    ];
    thread::scope(|scope| {
        let check = |keys| scope.spawn(move || (keys, checked(&with_control(keys, &machine(&[])))));
        let all: Vec<_> = controls.into_iter().map(check).collect();
        for one in all {
            let (keys, summary) = one.join().unwrap();
            assert_eq!(summary.count(Verdict::Failed), 0, "{keys}\n{summary}");
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
fn a_sound_control_elsewhere_passes() {
    for keys in ["wire = \"pty\"", "speaks = \"modbus\""] {
        let truth = with_control(keys, &machine(&[]));
        let dialect = |keys| keys + "\ndialect = \"grbl-m19\"";
        let summary = against(&machine(&[]), &truth, Pace::Fast, dialect);
        assert_eq!(summary.count(Verdict::Failed), 0, "{keys}\n{summary}");
    }
}

/// The scan of a PLC scatters touches by 14.4 µm at 300 mm/min. A probe with the same scatter at every feed,
/// declared in the file, is not reported as a PLC.
fn a_probe_that_scatters_as_a_scan_does_is_no_scan() {
    let poor = machine(&[("repeatability_um = 0.5", "repeatability_um = 14.4")]);
    let summary = checked(&poor);
    assert_eq!(summary.count(Verdict::Failed), 0, "{summary}");
    assert!(summary.to_string().contains("the control latches contacts itself"), "{summary}");
}

/// Twelve touches at each feed scatter by more than the declared value, but within the bound for so few touches.
fn scatter_that_few_touches_may_show_is_told_with_its_bound() {
    let poorer = machine(&[("repeatability_um = 0.5", "repeatability_um = 0.6")]);
    let truth = with_control("wire = \"pty\"", &poorer);
    let dialect = |keys| keys + "\ndialect = \"grbl-m19\"";
    let summary = against(&machine(&[]), &truth, Pace::Fast, dialect);
    assert_eq!(summary.count(Verdict::Failed), 0, "{summary}");
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
fn its_touches_stand_in_the_journal_as_a_run_of_latch_delay() {
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
    .and(trials![Pool::Waiting, 0;
        a_sound_machine_passes_whatever_it_speaks,
        a_sound_control_elsewhere_passes,
        a_probe_that_scatters_as_a_scan_does_is_no_scan,
        scatter_that_few_touches_may_show_is_told_with_its_bound,
        its_touches_stand_in_the_journal_as_a_run_of_latch_delay,
        people::without_anybody_nothing_moves_and_it_says_what_it_cannot_look_at,
        people::whoever_says_no_sees_nothing_move,
        people::with_a_probe_that_nobody_deflects_nothing_may_move,
        people::where_a_sensor_sits_in_the_probes_place_the_probe_is_asked_for,
        people::whoever_leaves_while_an_axis_is_away_does_not_see_it_go_back,
        people::regress_a_stop_while_nothing_moves_leaves_no_hold,
        people::a_machine_that_was_moved_by_hand_is_not_jogged,
        contact::a_stylus_in_contact_is_led_out_step_by_step_and_the_check_ends,
        contact::a_stylus_in_contact_is_led_out_whatever_the_control_speaks,
        contact::a_person_who_leaves_the_stylus_in_contact_sees_nothing_move,
        contact::without_a_person_a_stylus_stays_in_contact_and_the_remedy_is_named,
        contact::a_stop_while_the_direction_is_asked_for_moves_nothing,
        contact::a_retract_towards_a_declared_body_is_refused_and_asked_for_again,
        program::without_a_machine_file_the_simulated_machine_is_checked_by_itself,
        program::a_mistake_ends_it_with_1_and_json_tells_it_as_data,
        program::with_a_real_control_and_no_terminal_nothing_moves_and_it_does_not_hang,
        program::regress_a_control_that_refuses_its_settings_is_a_failure,
        program::ctrl_c_holds_the_machine_and_ends_it_with_5,
        sensors::sound_sensors_are_called_sound,
        sensors::a_thermometer_that_answers_passes,
    ])
}
