//! Sensors on a serial line, simulated by an independent script (`tests/peers/sensor/sender.py`, python3 on a
//! pseudo-terminal). Without python3 the trials are skipped, with the reason; with `TRUED_REQUIRE_PEERS=1` they
//! fail.

mod damaged_samples;
mod memory_use;
mod processor_load;
mod python_sensor;

use crate::support::harness::{Pool, Trials, is_command_in_path, trials};

/// Runs a trial on a separate runtime.
fn block_on<T>(trial: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    runtime.block_on(trial)
}

fn missing_python() -> Option<&'static str> {
    (!is_command_in_path(python_sensor::PYTHON_COMMAND)).then_some("python3 is missing")
}

pub fn trials() -> Trials {
    trials![Pool::Waiting, 0;
        damaged_samples::losses_of_damaged_text_lines_are_counted,
        damaged_samples::losses_of_damaged_byte_frames_are_counted,
        damaged_samples::polled_lines_lose_no_sample,
    ]
    .with_trials(trials![Pool::Alone, 12; processor_load::no_sample_is_lost_in_10_s_under_load])
    .with_trials(trials![Pool::Alone, 62; processor_load::no_sample_is_lost_in_60_s_under_load].mark_ignored())
    .requires_peer(missing_python)
    .with_trials(trials![Pool::Alone, 5; memory_use::memory_use_does_not_grow_with_samples])
}
