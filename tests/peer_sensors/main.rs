//! Sensors on a serial line against a script that knows nothing of ours (`tests/peers/sensor/sender.py`,
//! python3 on a pseudo-terminal). Without python3 the trials are skipped, with the reason; with
//! `TRUED_REQUIRE_PEERS=1` they fail.

mod harmed;
mod load;
mod memory;
mod peer;

use libtest_mimic::{Arguments, Completion, Failed, Trial};

const MISSING: &str = "python3 is not here";

fn trial(name: &str, run: fn() -> Result<(), Failed>) -> Trial {
    Trial::ignorable_test(name, move || match peer::is_there() {
        true => run().map(|()| Completion::Completed),
        false if std::env::var("TRUED_REQUIRE_PEERS").is_ok_and(|value| value == "1") => {
            Err(MISSING.into())
        }
        false => Ok(Completion::ignored_with(MISSING)),
    })
}

/// Run a trial on a runtime of its own.
fn on_a_runtime<T>(trial: impl Future<Output = T>) -> T {
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    runtime.block_on(trial)
}

fn main() {
    let trials = vec![
        trial("script_lines_are_counted_as_it_says", harmed::lines),
        trial("script_frames_are_counted_as_it_says", harmed::frames),
        trial("script_answers_when_it_is_asked", harmed::asked),
        trial("nothing_is_lost_beside_load_for_10_s", || load::nothing_is_lost(10)),
        trial("nothing_is_lost_beside_load_for_60_s", || load::nothing_is_lost(60))
            .with_ignored_flag(true),
        Trial::test("thirty_minutes_of_samples_leave_memory_flat", memory::is_flat),
    ];
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}
