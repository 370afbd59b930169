//! Tests against the real grblHAL firmware with simulated motion (`tests/peers/grblhal/build` puts it below the
//! target directory). Its source is not part of this repository: without it the trials are skipped, with the
//! reason, also with `TRUED_REQUIRE_PEERS=1`. `.ci/run` runs the readiness of the control and one short cycle;
//! `.ci/long` runs all.

mod commissioning;
mod cycle;
mod faults;
mod readiness;
mod recording_proxy;
mod rig;
mod work_offset;

use crate::support::harness::{Pool, Trials, trials};

fn missing_firmware() -> Option<&'static str> {
    (!rig::firmware_path().is_file()).then_some("grblHAL is not built: tests/peers/grblhal/build")
}

pub fn trials() -> Trials {
    trials![Pool::GrblHal, 60;
        readiness::a_control_that_is_not_ready_is_sent_no_motion,
        cycle::short_cycle_finds_the_true_axis,
        work_offset::rotary_centre_is_written_and_restored,
    ]
    .with_trials(
        trials![Pool::GrblHal, 0;
            commissioning::init_check_and_run_give_a_result,
            cycle::latch_delay_of_zero_is_found_within_u,
            cycle::two_true_axis_positions_are_found_in_the_planned_time,
            cycle::true_axis_is_found_with_a_reversed_c_axis,
            faults::run_held_and_reset_at_the_machine_resumes_only_after_homing,
            faults::run_resumes_only_after_homing_if_the_firmware_was_killed,
            work_offset::program_killed_at_any_line_of_a_write_leaves_a_known_state,
        ]
        .mark_ignored(),
    )
    .skipped_without_peer(missing_firmware)
}
