//! Runs that are measured but have no estimate: how they are shown, and how they are identified.

mod kills;
mod unidentified_run_copy;
mod unidentified_runs;

use crate::support::harness::{Pool, Trials, trials};

pub fn trials() -> Trials {
    trials![Pool::Waiting, 20;
        kills::after_6_kills_every_run_is_identified_or_closed,
        unidentified_runs::stopped_identification_is_repeated_by_the_daemon,
    ]
    .with_trials(trials![Pool::Waiting, 0;
        unidentified_runs::resume_identifies_without_the_machine,
        unidentified_runs::daemon_start_identifies_a_run_without_estimate,
        unidentified_runs::failed_identification_outdates_the_previous_result,
    ])
    .with_trials(
        trials![Pool::Waiting, 0;
            kills::after_200_kills_every_run_is_identified_or_closed,
        ]
        .mark_ignored(),
    )
}
