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
        kills::twenty_kills_lose_nothing_and_move_nothing,
        soak::fifty_runs_need_no_more_than_five,
    ]
    .and(trials![Pool::Waiting, 30;
        supervised::systemd_is_told_how_it_goes_and_misses_a_daemon_that_stands_still,
        logged::a_hold_is_found_by_its_run_and_a_fault_by_its_priority,
        keeping::a_copy_is_taken_in_mid_run,
    ])
    .and(trials![Pool::Waiting, 0;
        supervised::a_worker_that_hangs_is_fed_for_by_nobody,
        keeping::a_configuration_is_checked_before_it_serves,
        keeping::what_happens_is_counted,
        keeping::samples_go_when_their_time_is_over_and_nothing_else,
        logged::each_step_is_found_by_its_run,
        units::the_units_are_understood,
        units::the_services_are_hardened,
        units::the_unit_calls_what_there_is,
        units::the_units_need_what_they_need_and_start_nothing_else,
    ])
    .and(
        trials![Pool::Waiting, 0;
            kills::two_hundred_kills_lose_nothing_and_move_nothing,
            soak::five_hundred_runs_need_no_more_than_fifty,
        ]
        .ignored(),
    )
}
