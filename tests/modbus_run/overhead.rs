//! What the daemon adds to a touch: from the start of a step to the start of the next, on a simulated
//! control that moves in no time, over a wire without delay, with the journal in memory. It holds
//! rendering, proof of the text, the conversation, the journal without its disk, and what the simulated
//! machine computes.

use std::time::{Duration, Instant};

use trued::methods;
use trued::record::event::Event;
use trued::run::Run;
use trued::setup::{self, MachineFile, Pace, Past};
use trued::store::{Journal, NewRun};

use super::bench::{folder, machine};

const MOST: Duration = Duration::from_millis(5);

/// Sorted.
fn touches(controller: &str) -> Vec<Duration> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let text = machine(controller) + "\n[method.self-calibration]\nrepeats = 4\n";
        let file = MachineFile::parse("machine.toml", text).unwrap();
        let devices = setup::devices(&file, Pace::Fast, Past::default()).await.unwrap();
        let folder = folder();
        let journal = Journal::open(folder.path()).unwrap();
        let (method, plan) = setup::header(&file, methods::NAMES[0], None).unwrap();
        let new = NewRun { config: file.text().to_owned(), plan: plan.clone() };
        let id = journal.begin(&new).await.unwrap();
        let (mut begun, mut times) = (None, Vec::new());
        let mut tell = |event: &Event| match event {
            Event::StepStarted { .. } => begun = Some(Instant::now()),
            // Told once it is stored.
            Event::ReadingStored { .. } => {
                times.extend(begun.take().map(|begun: Instant| begun.elapsed()));
            }
            _ => {}
        };
        let mut run = Run::new(id, method.as_ref(), &devices, &journal, plan, &mut tell);
        run.execute().await.unwrap();
        times.sort();
        times
    })
}

/// Alone on the computer: `cargo test --release --test modbus_run overhead -- --ignored --nocapture`.
#[test]
#[ignore = "a measured time, not met yet: run by hand, alone on the computer"]
fn the_daemon_adds_at_most_5_ms_to_a_touch() {
    let mut slow = Vec::new();
    for (name, controller) in [("grbl in memory", ""), ("Modbus TCP", super::CONTROLS[0].1)] {
        let times = touches(controller);
        let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize];
        let (median, p99) = (at(0.5), at(0.99));
        println!("{name}: {} touches, median {median:?}, 99 % below {p99:?}", times.len());
        slow.extend((p99 > MOST).then_some((name, p99)));
    }
    assert!(slow.is_empty(), "{slow:?}");
}
