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
        fails::a_sensor_that_fails_in_mid_scan_holds_the_machine,
        fails::a_sensor_that_falls_silent_on_its_first_way_holds_the_machine,
    ]
    .and(trials![Pool::Computing, 30;
        kills::a_killed_run_goes_on_and_says_what_an_undisturbed_one_says,
        kills::a_sphere_that_was_moved_meanwhile_is_found_out,
        commands::a_captured_run_replays_to_the_same_bytes,
        commands::a_run_says_the_same_twice_and_is_near_the_truth,
    ])
    .and(trials![Pool::Waiting, 0;
        fails::an_early_distance_at_rest_holds_the_machine,
        fails::a_real_control_is_not_sent_a_motion_before_a_person_has_confirmed_the_sensor,
        commands::the_same_machine_may_be_touched_instead,
        commands::a_probe_input_that_is_closed_while_a_laser_looks_is_told_so,
        commands::a_printed_program_says_what_happens_where_it_rests,
        commands::simulate_goes_without_the_probe_where_a_sensor_is_in_the_spindle,
        refused::a_layout_that_cannot_be_is_refused_with_its_line,
        refused::what_comes_at_a_wrong_bit_rate_and_text_for_numbers_are_told_before_anything_moves,
        refused::what_cannot_be_measured_is_refused_by_dwell_points_and_on_the_way_alike,
        refused::readings_that_do_not_tell_are_refused_of_dwell_points_and_on_the_way_alike,
        sweeps::an_early_distance_holds_the_machine_on_its_way_down,
        sweeps::what_fails_in_mid_pass_holds_the_machine_and_keeps_what_is_true,
        sweeps::what_is_lost_in_mid_pass_is_left_out_and_nothing_put_in_its_place,
    ])
    .and(
        trials![Pool::Alone, 120;
            load::nothing_is_lost_at_1_khz_beside_a_running_cycle_and_load,
            memory::a_run_of_half_an_hour_keeps_its_readings_and_nothing_else,
        ]
        .ignored(),
    )
}
