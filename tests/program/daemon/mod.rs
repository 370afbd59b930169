//! `trued serve` in long-term operation: notifications to systemd, kills at random moments, many runs in sequence,
//! backups during a run; and its systemd units.

mod backup_metrics_retention;
mod event_listener;
mod journald_messages;
mod random_kills;
mod served_machine;
mod soak;
mod systemd_notifications;
mod systemd_units;

use crate::support::harness::{Pool, Trials, trials};

pub fn trials() -> Trials {
    trials![Pool::Waiting, 60;
        random_kills::ten_kills_lose_no_reading_and_cause_no_motion,
        soak::memory_grows_at_most_5_mib_from_run_5_to_50,
    ]
    .with_trials(trials![Pool::Waiting, 30;
        systemd_notifications::systemd_gets_status_and_no_watchdog_from_a_stopped_process,
        journald_messages::hold_and_fault_have_run_and_priority_in_journald,
        backup_metrics_retention::backup_during_a_run_is_a_usable_journal,
    ])
    .with_trials(trials![Pool::Waiting, 0;
        systemd_notifications::watchdog_is_not_notified_while_the_worker_hangs,
        backup_metrics_retention::serve_check_accepts_sound_and_refuses_unsound_config,
        backup_metrics_retention::metrics_count_runs_readings_and_refusals,
        backup_metrics_retention::retention_removes_only_scan_samples_of_old_runs,
        journald_messages::each_step_has_a_journald_entry_of_its_run,
        systemd_units::units_are_valid,
        systemd_units::services_are_hardened,
        systemd_units::service_commands_and_options_exist_in_the_program,
        systemd_units::cycle_unit_starts_nothing_and_service_loads_adapter_modules,
    ])
    .with_trials(
        trials![Pool::Waiting, 0;
            random_kills::two_hundred_kills_lose_no_reading_and_cause_no_motion,
            soak::memory_grows_at_most_5_mib_from_run_50_to_500,
        ]
        .mark_ignored(),
    )
}
