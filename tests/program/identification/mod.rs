//! Runs that are measured but have no estimate: how they are shown, and how they are identified.

mod kills;
mod measured_run;
mod shown;

use crate::support::harness::{Pool, Trials, trials};

pub fn trials() -> Trials {
    trials![Pool::Waiting, 20;
        kills::few_kills_leave_no_unnoticed_run_without_estimate,
        shown::a_stopped_identification_is_made_up_for,
    ]
    .with(trials![Pool::Waiting, 0;
        shown::resume_identifies_without_the_machine,
        shown::daemon_identifies_a_measured_run,
        shown::failed_identification_outdates_the_previous_result,
    ])
    .with(
        trials![Pool::Waiting, 0;
            kills::two_hundred_kills_leave_no_unnoticed_run_without_estimate,
        ]
        .ignored(),
    )
}
