//! Time that the daemon adds to a touch: planning, proof, rendering, sending, checking the answer and journalling,
//! with controls that answer at once, compute nothing and move in no time. Not included: the delay, up to 20 ms,
//! until the end of a real move is detected, because a waiting driver polls at that interval.
//!
//! `cargo bench --bench overhead`, alone on the computer. The journal is in memory (`/dev/shm`): the time of the
//! disk's sync is reported separately. The benchmark repeats the run; the median run must meet the limit, over the
//! in-memory wire and over Modbus TCP. The times over a pseudo-terminal are reported without a limit.

mod replay_controls;
mod tape;
mod touch_timing;

use std::error::Error;
use std::path::Path;
use std::time::{Duration, Instant};

use machine::record::reading::Reading;
use methods::METHOD_DESCRIPTIONS;
use touch_timing::{ControlWire, RecordedControl, TimedRun, memory_folder, quantile};
use trued::setup;
use trued::store::{Journal, NewRun};

const RUN_COUNT: usize = 8;
/// Maximum time that the daemon adds to a touch, at the 99th percentile.
const MAX_TOUCH_OVERHEAD: Duration = Duration::from_millis(5);

fn main() -> Result<(), Box<dyn Error>> {
    let mut slow = Vec::new();
    for wire in ControlWire::ALL {
        let prepared = RecordedControl::record(wire);
        let rounds: Vec<_> = (0..RUN_COUNT).map(|_| prepared.time_run(&memory_folder())).collect();
        let p99 = print_and_return_touch_p99(wire, &rounds);
        let late = wire.has_time_limit() && p99 > MAX_TOUCH_OVERHEAD;
        slow.extend(late.then(|| format!("{}: {:.2} ms", wire.name(), ms(p99))));
        if wire == ControlWire::GrblMemory {
            print_journal_times(&rounds[0].readings)?;
        }
    }
    if slow.is_empty() { Ok(()) } else { Err(format!("above {MAX_TOUCH_OVERHEAD:?}: {slow:?}").into()) }
}

/// Prints the times of the touches; returns the 99th percentile of the median run.
fn print_and_return_touch_p99(wire: ControlWire, rounds: &[TimedRun]) -> Duration {
    let touches: Vec<_> = rounds.iter().flat_map(|round| round.touch_times.clone()).collect();
    let stages: Vec<_> = rounds.iter().flat_map(|round| round.pauses_between_stages.clone()).collect();
    let each: Vec<_> = rounds.iter().map(|round| quantile(&round.touch_times, 0.99)).collect();
    let p99 = quantile(&each, 0.5);
    println!(
        "{}: {} touches, median {:.2} ms, 99 % within {:.2} ms (the middle of {RUN_COUNT} rounds; {}), \
         longest {:.2} ms; between two stages {:.1} ms",
        wire.name(),
        touches.len(),
        ms(quantile(&touches, 0.5)),
        ms(p99),
        if wire.has_time_limit() { format!("at most {MAX_TOUCH_OVERHEAD:?}") } else { "no limit".to_owned() },
        ms(quantile(&touches, 1.0)),
        ms(quantile(&stages, 0.5)),
    );
    p99
}

fn print_journal_times(readings: &[Reading]) -> Result<(), Box<dyn Error>> {
    let disk = Path::new(env!("CARGO_TARGET_TMPDIR"));
    for (name, folder) in [("memory", &*memory_folder()), ("the target folder's disk", disk)] {
        let times = time_journal_writes(readings, folder)?;
        println!(
            "  of it the journal in {name}: median {:.2} ms, 99 % within {:.2} ms",
            ms(quantile(&times, 0.5)),
            ms(quantile(&times, 0.99))
        );
    }
    Ok(())
}

/// Time to store a reading in the journal, measured alone.
fn time_journal_writes(readings: &[Reading], folder: &Path) -> Result<Vec<Duration>, Box<dyn Error>> {
    let folder = tempfile::tempdir_in(folder)?;
    let journal = Journal::open(folder.path())?;
    let method = METHOD_DESCRIPTIONS[0].name;
    let (_, plan) =
        setup::configure_method_and_plan_without_steps(&setup::load_machine_file(None, method)?, method, None)?;
    let id = journal.begin_run(&NewRun { machine_file_text: String::new(), plan }).wait()?;
    let mut times = Vec::new();
    for reading in readings {
        let begun = Instant::now();
        journal.add_reading(id, reading).wait()?;
        times.push(begun.elapsed());
    }
    Ok(times)
}

fn ms(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}
