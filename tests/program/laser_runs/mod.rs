//! Whole runs of the laser R-test by the program itself, with a simulated control and a sensor on a wire of this
//! test: the sensor fails during a scan, the program is killed, the sphere is moved meanwhile, and the computer is
//! loaded. Scans in motion: with a control that reports time-stamped positions, also simulated by the test.

use crate::support::harness::{Pool, Trials, trials};
mod commands;
mod kills;
mod laser_shop;
mod memory_use;
mod refused_inputs;
mod samples_under_load;
mod scan_in_motion_events;
mod scripted_scene;
mod sensor_failures;
mod tcp_sensor;

pub fn trials() -> Trials {
    trials![Pool::Waiting, 60;
        sensor_failures::failing_sensor_in_a_scan_holds_the_machine,
        sensor_failures::silent_sensor_in_the_first_move_holds_the_machine,
    ]
    .with_trials(trials![Pool::Computing, 30;
        kills::killed_run_resumes_to_the_estimate_of_an_undisturbed_run,
        kills::resume_is_refused_after_the_sphere_was_moved,
        commands::captured_run_replays_to_the_same_bytes,
        commands::run_is_reproducible_and_near_the_truth,
    ])
    .with_trials(trials![Pool::Waiting, 0;
        sensor_failures::unexpected_distance_at_rest_holds_the_machine,
        sensor_failures::a_real_control_is_not_sent_a_motion_before_a_person_has_confirmed_the_sensor,
        commands::laser_r_test_by_touches_is_near_the_truth,
        commands::closed_probe_input_refuses_a_laser_run_without_advice_on_the_stylus,
        commands::title_of_printed_program_states_samples_per_dwell,
        commands::simulate_removes_the_probe_for_a_method_with_a_spindle_sensor,
        refused_inputs::invalid_frame_layout_is_refused_with_file_and_cause,
        refused_inputs::wrong_baud_rate_and_text_values_are_refused_with_their_cause,
        refused_inputs::unmeasurable_settings_are_refused_for_dwell_and_continuous_scans,
        refused_inputs::insufficient_readings_are_refused_for_dwell_and_continuous_scans,
        scan_in_motion_events::unexpected_distance_in_the_approach_holds_the_machine,
        scan_in_motion_events::failure_in_a_pass_stops_the_run_and_keeps_complete_steps,
        scan_in_motion_events::samples_lost_in_a_pass_are_left_out_and_not_replaced,
    ])
    .with_trials(
        trials![Pool::Alone, 120;
            samples_under_load::no_sample_is_lost_at_1_khz_during_a_cycle_under_load,
            memory_use::half_hour_run_memory_grows_by_at_most_450_bytes_per_reading,
        ]
        .mark_ignored(),
    )
    .with_trials(
        trials![Pool::Waiting, 60;
            sensor_failures::sensor_that_fails_in_five_ways_holds_the_machine,
        ]
        .mark_ignored(),
    )
}
