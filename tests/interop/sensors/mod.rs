//! Sensors on a serial line, simulated by an independent script (`tests/peers/sensor/sender.py`, python3 on a
//! pseudo-terminal). Without python3 the trials are skipped, with the reason; with `TRUED_REQUIRE_PEERS=1` they
//! fail.

mod harmed;
mod load;
mod memory;
mod peer;

use crate::support::harness::{Pool, Trials, is_command, trials};

/// Runs a trial on a separate runtime.
fn block_on<T>(trial: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    runtime.block_on(trial)
}

fn missing_python() -> Option<&'static str> {
    (!is_command(peer::PYTHON)).then_some("python3 is missing")
}

pub fn trials() -> Trials {
    trials![Pool::Waiting, 0;
        harmed::damaged_text_lines,
        harmed::damaged_byte_frames,
        harmed::polled_lines_lose_no_sample,
    ]
    .with(trials![Pool::Alone, 12; load::nothing_is_lost_for_10_s])
    .with(trials![Pool::Alone, 62; load::nothing_is_lost_for_60_s].ignored())
    .requires(missing_python)
    .with(trials![Pool::Alone, 5; memory::is_flat])
}
