//! Whole runs of the laser R-test by the program itself, with a simulated control and a sensor on a wire of this
//! test: the sensor fails during a scan, the program is killed, the sphere is moved meanwhile, and the computer is
//! loaded. Scans in motion: with a control that reports time-stamped positions, also simulated by the test.

use crate::support::harness::{Pool, Trials, trials};
mod commands;
mod fails;
mod kills;
mod laser_shop;
mod load;
mod memory;
mod played;
mod refused;
mod sender;
mod sweeps;

pub fn trials() -> Trials {
    trials![Pool::Waiting, 60;
        fails::failing_sensor_in_a_scan_holds_the_machine,
        fails::silent_sensor_in_the_first_move_holds_the_machine,
    ]
    .with(trials![Pool::Computing, 30;
        kills::killed_run_resumes_to_the_estimate_of_an_undisturbed_run,
        kills::a_sphere_that_was_moved_meanwhile_is_found_out,
        commands::captured_run_replays_to_the_same_bytes,
        commands::a_run_says_the_same_twice_and_is_near_the_truth,
    ])
    .with(trials![Pool::Waiting, 0;
        fails::early_distance_at_rest_holds_the_machine,
        fails::a_real_control_is_not_sent_a_motion_before_a_person_has_confirmed_the_sensor,
        commands::same_machine_can_be_measured_by_touches,
        commands::closed_probe_input_refuses_a_laser_run_without_advice_on_the_stylus,
        commands::printed_program_states_the_samples_of_a_dwell,
        commands::simulate_goes_without_the_probe_where_a_sensor_is_in_the_spindle,
        refused::a_layout_that_cannot_be_is_refused_with_its_line,
        refused::wrong_bit_rate_and_text_values_are_reported_before_motion,
        refused::what_cannot_be_measured_is_refused_by_dwell_points_and_on_the_way_alike,
        refused::insufficient_readings_are_refused_for_dwell_and_continuous_scans,
        sweeps::early_distance_holds_the_machine_in_the_approach,
        sweeps::what_fails_in_mid_pass_holds_the_machine_and_keeps_what_is_true,
        sweeps::what_is_lost_in_mid_pass_is_left_out_and_nothing_put_in_its_place,
    ])
    .with(
        trials![Pool::Alone, 120;
            load::nothing_is_lost_at_1_khz_beside_a_running_cycle_and_load,
            memory::half_hour_run_keeps_only_its_readings,
        ]
        .ignored(),
    )
}
