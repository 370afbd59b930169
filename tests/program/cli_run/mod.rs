//! The program as a user runs it: one command, its output, its journal.

use std::process::Output;

use serde_json::Value;

mod ball_plate;
mod capture_replay;
mod collision_check;
mod compare;
mod multiprobe;
mod probe;
mod probe_qualification;
mod r_test;
mod recorded_grbl;
mod repeatability;
mod results;
mod resume;
mod samba;
mod simulated_faults;
mod stop_signals;
mod time_stamps;
mod wires;

use crate::support::harness::{Pool, Trials, trials};
use crate::support::machine_shop::{MachineShop, stderr};

/// The built-in machine, with few Monte Carlo trials.
fn simulated_machine_toml() -> String {
    let file = include_str!("../../../config/simulated.toml");
    format!("{file}\n[method.self-calibration]\nmonte_carlo_trials = 1000\n")
}

/// A simulated machine's file, with another control.
fn machine_toml_with_control(file: &str, control: &str) -> String {
    toml_with_text_replacements(file, &[("kind = \"simulated\"", control), ("wire = \"memory\"", "")])
}

/// Replaces lines; each `from` is the beginning of a line.
fn toml_with_text_replacements(file: &str, changes: &[(&str, &str)]) -> String {
    let mut text = file.to_owned();
    for (from, to) in changes {
        assert!(text.contains(&format!("\n{from}")), "{from}");
        text = text.replacen(&format!("\n{from}"), &format!("\n{to}"), 1);
    }
    text
}

/// Asserts that standard error contains each of the words.
fn assert_stderr_has(output: &Output, words: &[&str]) {
    for word in words {
        assert!(stderr(output).contains(word), "{word} in {}", stderr(output));
    }
}

/// The JSON output of a successful command.
fn successful_json_output(output: &Output) -> Value {
    assert_eq!(output.status.code(), Some(0), "{}", stderr(output));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// The estimate without its provenance, whose hash of the readings depends on whether they have temperatures.
fn estimate_without_provenance(output: &Output) -> Value {
    let mut estimate = successful_json_output(output);
    estimate.as_object_mut().unwrap().remove("provenance").unwrap();
    estimate
}

pub fn trials() -> Trials {
    trials![Pool::Waiting, 25;
        stop_signals::a_killed_run_is_interrupted_and_its_readings_kept,
        stop_signals::sigterm_holds_and_keeps_the_readings,
        stop_signals::sigint_holds_and_keeps_the_readings,
        wires::memory_pty_and_another_process_give_the_same_result,
        samba::samba_run_survives_kills_and_stops,
        ball_plate::killed_and_stopped_ball_plate_run_finds_true_values,
        multiprobe::killed_and_stopped_multiprobe_run_finds_true_values,
        multiprobe::off_centre_artefact_must_be_centred_first,
    ]
    .with_trials(trials![Pool::Waiting, 0;
        stop_signals::sigterm_stops_the_identification_and_keeps_readings,
        stop_signals::a_run_continues_when_its_output_is_not_read,
        repeatability::passes_of_a_run_give_their_repeatability,
        repeatability::runs_give_their_repeatability,
        capture_replay::captured_run_replays_to_the_same_result,
        capture_replay::changed_or_damaged_capture_is_refused_with_reason,
        capture_replay::stored_capture_of_linuxcnc_replays_to_its_estimate,
        samba::samba_run_stopped_before_references_cannot_be_resumed,
        samba::samba_run_with_repeat_option_is_refused,
        simulated_faults::a_hold_pressed_at_the_machine_ends_the_run_with_its_reason,
        simulated_faults::misspelt_fault_is_refused_with_its_line,
        simulated_faults::cut_wire_leaves_a_held_run_and_is_logged,
        probe::no_motion_before_the_stylus_was_deflected_by_hand,
        probe::stop_while_waiting_for_stylus_deflection_holds_the_run,
        probe::missing_first_contact_names_a_dead_probe,
        probe::probe_and_clamps_are_switched_as_declared,
        probe::invalid_probe_switch_command_is_refused_before_a_run_exists,
        collision_check::plan_states_the_least_clearance_and_program_is_complete,
        collision_check::colliding_program_is_refused_with_step_line_and_bodies,
        collision_check::report_draws_clearances_and_lists_unchecked_bodies,
        probe_qualification::later_run_requires_and_subtracts_the_map_of_its_own_probe,
        r_test::two_r_test_runs_find_the_true_axis_and_are_compared,
        compare::two_runs_are_compared,
        compare::incomparable_runs_are_refused_with_advice,
        results::exported_readings_give_the_stored_estimate,
        results::undeclared_sources_are_assumed_and_marked,
        results::self_calibration_at_two_heights_finds_axis_tilts,
        results::spindle_orientation_without_template_is_refused,
        results::a_stored_run_is_identified_again_and_keeps_its_first_estimate,
        resume::stopped_run_resumes_with_references_and_gives_the_same_estimate,
        resume::run_resumes_after_any_number_of_stops,
        resume::resumed_run_keeps_its_priors,
        resume::resume_on_held_control_is_refused_and_run_stays_resumable,
        resume::moved_part_closes_the_run_and_keeps_its_readings,
        resume::unknowns_without_enough_readings_are_named,
        resume::resume_closes_a_run_stopped_before_its_references,
        resume::resume_with_another_machine_file_is_refused,
        resume::run_resumes_in_a_later_pass,
        resume::resume_needs_all_references,
        resume::references_estimate_their_own_repeatability,
        resume::lost_position_requires_homing,
        time_stamps::scan_in_motion_without_time_stamped_positions_is_refused,
        wires::a_busy_port_is_reported_and_leaves_no_run,
    ])
}
