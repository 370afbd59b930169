//! `trued serve` in long-term operation: notifications to systemd, kills at random moments, many runs in sequence,
//! backups during a run; and its systemd units.

mod event_listener;
mod keeping;
mod kills;
mod logged;
mod served_machine;
mod soak;
mod supervised;
mod units;

use crate::support::harness::{Pool, Trials, trials};

pub fn trials() -> Trials {
    trials![Pool::Waiting, 60;
        kills::twenty_kills_lose_no_reading_and_cause_no_motion,
        soak::memory_of_fifty_runs_is_that_of_five,
    ]
    .with(trials![Pool::Waiting, 30;
        supervised::systemd_is_told_how_it_goes_and_misses_a_daemon_that_stands_still,
        logged::a_hold_is_found_by_its_run_and_a_fault_by_its_priority,
        keeping::a_copy_is_taken_in_mid_run,
    ])
    .with(trials![Pool::Waiting, 0;
        supervised::a_worker_that_hangs_is_fed_for_by_nobody,
        keeping::a_configuration_is_checked_before_it_serves,
        keeping::what_happens_is_counted,
        keeping::samples_go_when_their_time_is_over_and_nothing_else,
        logged::each_step_is_found_by_its_run,
        units::units_are_valid,
        units::services_are_hardened,
        units::unit_starts_an_existing_command,
        units::units_require_only_their_dependencies,
    ])
    .with(
        trials![Pool::Waiting, 0;
            kills::two_hundred_kills_lose_no_reading_and_cause_no_motion,
            soak::memory_of_five_hundred_runs_is_that_of_fifty,
        ]
        .ignored(),
    )
}
