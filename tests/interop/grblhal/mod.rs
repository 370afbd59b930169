//! Tests against the real grblHAL firmware with simulated motion (`tests/peers/grblhal/build` puts it below the
//! target directory). Its source is not part of this repository: without it the trials are skipped, with the
//! reason, also with `TRUED_REQUIRE_PEERS=1`. `.ci/run` runs the readiness of the control and one short cycle;
//! `.ci/long` runs all.

mod commissioning;
mod cycle;
mod faults;
mod readiness;
mod rig;
mod wire;

use crate::support::harness::{Pool, Trials, trials};

fn missing_firmware() -> Option<&'static str> {
    (!rig::firmware_path().is_file()).then_some("grblHAL is not built: tests/peers/grblhal/build")
}

pub fn trials() -> Trials {
    trials![Pool::GrblHal, 60;
        readiness::a_control_that_is_not_ready_is_sent_no_motion,
        cycle::short_cycle_finds_the_true_axis,
    ]
    .with(
        trials![Pool::GrblHal, 0;
            commissioning::init_check_and_run_give_a_result,
            cycle::the_latch_delay_is_found,
            cycle::two_true_axes_are_found,
            cycle::a_reversed_axis_is_found,
            faults::run_held_at_the_machine_resumes,
            faults::run_resumes_after_the_firmware_was_killed,
        ]
        .ignored(),
    )
    .skipped_without(missing_firmware)
}
