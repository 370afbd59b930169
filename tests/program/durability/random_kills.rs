//! SIGKILL at random moments of a run.

use std::time::Duration;

use estimation::random;
use rand::RngExt;

use super::{DurabilityBench, assert_journal_is_valid, assert_readings_kept};
use crate::support::recording_control::RecordingControl;

pub fn ten_kills_lose_no_acknowledged_reading() {
    run_kills(10, 1);
}

pub fn two_hundred_kills_lose_no_acknowledged_reading() {
    run_kills(200, 2);
}

/// All kills in one journal, so that each run starts with the state that the killed one left.
fn run_kills(count: usize, seed: u64) {
    let (whole, record) = DurabilityBench::new().run_to_end(|_| {});
    assert_eq!(whole.status.code(), Some(0), "{}", super::stderr_text(&whole));
    let bench = DurabilityBench::new();
    let (mut begun, mut in_mid_run) = (0, 0);
    for kill in 0..count {
        let mut random = random::seeded_stream(seed, &[kill as u64]);
        let bytes = random.random_range(0..=record.transferred_byte_count());
        let pause = Duration::from_micros(random.random_range(0..5_000));
        let (ended, touches) = run_until_killed(&bench, bytes, pause, &mut begun);
        in_mid_run += usize::from(ended == "interrupted" && touches > 0);
    }
    println!("{count} kills, {begun} runs begun, {in_mid_run} of them dead between touches");
    assert!(in_mid_run * 2 > count, "{in_mid_run} of {count} kills met a run");
}

/// One run, killed when `bytes` have passed the wire and `pause` has elapsed; returns its state and the number of
/// its touches.
fn run_until_killed(bench: &DurabilityBench, bytes: usize, pause: Duration, begun: &mut usize) -> (String, usize) {
    let witness = RecordingControl::start();
    let mut run = bench.trued_run_command(&witness.address()).spawn().unwrap();
    witness.wait_for_transferred_bytes(bytes, || run.try_wait().unwrap().is_some());
    std::thread::sleep(pause);
    run.kill().unwrap();
    run.wait().unwrap();
    let record = witness.stop_and_take_record();
    if bench.state_folder().join("journal.sqlite").exists() {
        assert_journal_is_valid(&bench.state_folder());
    }

    bench.mark_interrupted_runs_by_next_command();
    let states = bench.run_states();
    let new = states.len() - *begun;
    *begun = states.len();
    assert!(new <= 1 && states.iter().all(|state| state != "running"), "{states:?}");
    let touches = record.reported_touch_positions().len();
    match states.last().filter(|_| new == 1) {
        None => {
            assert_eq!((record.last_started_step(), touches), (0, 0), "moved without a run in the journal");
            ("none".to_owned(), 0)
        }
        Some(state) => {
            assert!(["interrupted", "not identified", "finished"].contains(&state.as_str()), "{state}");
            assert_readings_kept(&bench.exported_readings(*begun), &record);
            (state.clone(), touches)
        }
    }
}
