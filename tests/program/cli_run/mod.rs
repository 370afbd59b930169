//! The program as a user runs it: one command, its output, its journal.

use std::process::Output;

use serde_json::Value;

mod ball_plate;
mod captures;
mod compare;
mod faults;
mod firmware;
mod multiprobe;
mod probe;
mod probe_qualification;
mod proven;
mod r_test;
mod results;
mod resume;
mod samba;
mod stamps;
mod stops;
mod wires;

use crate::support::harness::{Pool, Trials, trials};
use crate::support::machine_shop::{MachineShop, stderr};

/// The built-in machine, with few Monte Carlo trials.
fn simulated_machine() -> String {
    let file = include_str!("../../../config/simulated.toml");
    format!("{file}\n[method.self-calibration]\nmonte_carlo_trials = 1000\n")
}

/// A simulated machine's file, with another control.
fn machine_with_control(file: &str, control: &str) -> String {
    with_changes(file, &[("kind = \"simulated\"", control), ("wire = \"memory\"", "")])
}

/// Replaces lines; each `from` is the beginning of a line.
fn with_changes(file: &str, changes: &[(&str, &str)]) -> String {
    let mut text = file.to_owned();
    for (from, to) in changes {
        assert!(text.contains(&format!("\n{from}")), "{from}");
        text = text.replacen(&format!("\n{from}"), &format!("\n{to}"), 1);
    }
    text
}

/// Asserts that standard error contains each of the words.
fn assert_output_has(output: &Output, words: &[&str]) {
    for word in words {
        assert!(stderr(output).contains(word), "{word} in {}", stderr(output));
    }
}

/// The estimate of a successful run.
fn estimate_json(output: &Output) -> Value {
    assert_eq!(output.status.code(), Some(0), "{}", stderr(output));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// The estimate without its provenance: without a thermometer, readings and their hash have no temperatures.
fn result_values(output: &Output) -> Value {
    let mut estimate = estimate_json(output);
    estimate.as_object_mut().unwrap().remove("provenance").unwrap();
    estimate
}

pub fn trials() -> Trials {
    trials![Pool::Waiting, 25;
        stops::regress_a_killed_run_is_interrupted_and_its_readings_kept,
        stops::regress_sigterm_holds_and_keeps_the_readings,
        stops::regress_sigint_holds_and_keeps_the_readings,
        wires::regress_memory_pty_and_another_process_give_the_same_result,
        samba::samba_run_survives_kills_and_stops,
        ball_plate::a_run_that_is_killed_and_stopped_goes_on,
        multiprobe::a_run_that_is_killed_and_stopped_goes_on,
        multiprobe::an_artefact_that_stands_off_is_to_be_centred_first,
    ]
    .with(trials![Pool::Waiting, 0;
        stops::regress_a_stop_is_heard_while_the_identification_computes,
        stops::regress_a_run_continues_when_its_output_is_not_read,
        captures::captured_run_replays_to_the_same_result,
        captures::a_capture_that_does_not_fit_is_told_in_words,
        captures::stored_capture_of_linuxcnc_replays_to_its_estimate,
        samba::a_stop_before_the_references_says_that_the_run_is_over,
        samba::a_cycle_that_is_none_cannot_be_repeated,
        faults::regress_a_hold_pressed_at_the_machine_ends_the_run_with_its_reason,
        faults::regress_a_fault_that_is_misspelt_is_told_with_its_line,
        faults::regress_a_wire_that_is_cut_leaves_a_held_run_and_says_what_it_did,
        probe::no_motion_before_the_stylus_was_deflected_by_hand,
        probe::a_stop_is_heard_while_a_person_is_waited_for,
        probe::missing_first_contact_names_a_dead_probe,
        probe::probe_and_clamps_are_switched_as_declared,
        probe::a_word_that_cannot_switch_a_probe_is_refused_before_anything_is_opened,
        proven::regress_plan_states_the_least_clearance_and_program_is_complete,
        proven::regress_what_would_collide_is_refused_with_step_line_and_bodies,
        proven::regress_report_draws_clearances_and_lists_unchecked_bodies,
        probe_qualification::later_run_subtracts_the_map_of_its_own_probe,
        r_test::the_built_in_machine_is_measured_and_compared_with_itself,
        compare::two_runs_are_compared,
        compare::what_is_no_comparison_is_refused_with_the_way_on,
        results::regress_exported_readings_identify_to_the_stored_bytes,
        results::what_nobody_has_declared_is_assumed_and_marked,
        results::regress_two_heights_find_the_tilts_of_the_axis,
        results::regress_what_a_control_cannot_do_is_refused_before_it_moves,
        results::regress_a_stored_run_is_identified_again_and_keeps_its_first_estimate,
        resume::stopped_run_resumes_with_references_and_gives_the_same_estimate,
        resume::run_resumes_after_any_number_of_stops,
        resume::resumed_run_keeps_its_priors,
        resume::a_control_that_is_not_ready_refuses_and_the_run_stays,
        resume::moved_part_closes_the_run_and_keeps_its_readings,
        resume::what_too_few_readings_cannot_tell_is_named,
        resume::without_references_a_run_is_closed,
        resume::another_machine_file_is_another_run,
        resume::run_resumes_in_a_later_pass,
        resume::resume_needs_all_references,
        resume::references_estimate_their_own_repeatability,
        resume::lost_position_requires_homing,
        stamps::a_scan_in_motion_is_refused_before_anything_moves_where_nothing_is_stamped,
        wires::regress_a_busy_port_is_told_and_leaves_no_run,
    ])
}
