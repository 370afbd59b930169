//! SIGKILL at random moments of a cycle that the daemon measures. The simulated control lives in this process and
//! receives every line: the tests check durability, and that nothing moves before an operator has acknowledged.

use std::thread::sleep;
use std::time::{Duration, Instant};

use estimation::random;
use machine::record::reading::Reading;
use rand::RngExt;
use rusqlite::Connection;
use serde_json::json;
use trued::store::{Journal, RunId, RunState};

use super::event_listener::{Heard, Listener};
use super::served_machine::served_machine;
use crate::support::daemon_process::DaemonProcess;
use crate::support::machine_shop::MachineShop;
use crate::support::recording_control::{Record, RecordingControl};

pub fn twenty_kills_lose_nothing_and_move_nothing() {
    kills(20, 1);
}

pub fn two_hundred_kills_lose_nothing_and_move_nothing() {
    kills(200, 2);
}

fn machine(witness: &RecordingControl) -> String {
    let wire = "kind = \"simulated\"";
    let machine = served_machine("");
    assert!(machine.contains(wire) && machine.contains("\nwire = \"memory\""));
    let tcp = format!("kind = \"grbl\"\ntcp = \"{}\"", witness.address());
    machine.replacen(wire, &tcp, 1).replacen("\nwire = \"memory\"", "", 1)
}

/// Four journals in parallel, each with its share of the kills: most of the time is waiting.
fn kills(count: u64, seed: u64) {
    const SHOPS: u64 = 4;
    let share = |shop: u64| move || in_one_shop((shop..count).step_by(SHOPS as usize), seed);
    let (known, in_mid_run) = std::thread::scope(|scope| {
        let shops: Vec<_> = (0..SHOPS).map(|shop| scope.spawn(share(shop))).collect();
        let ended = shops.into_iter().map(|shop| shop.join().unwrap());
        ended.fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1))
    });
    println!("{count} kills, {known} runs, {in_mid_run} of them dead between touches");
    assert!(in_mid_run * 2 > count, "{in_mid_run} of {count} kills met a run");
}

/// All kills in one journal, so that each daemon starts with the state that the killed one left. Returns the number
/// of runs in the journal, and of those killed during a run.
fn in_one_shop(kills: impl Iterator<Item = u64>, seed: u64) -> (usize, u64) {
    let shop = MachineShop::new("");
    let (witness, daemon) = serve(&shop);
    assert_eq!(daemon.http().start(1), 202);
    daemon.http().wait_for_state("waiting");
    assert_eq!(daemon.terminate(), 0);
    let whole = witness.end().bytes();
    let (mut known, mut in_mid_run) = (1, 0);
    let (mut witness, mut daemon) = serve(&shop);
    for kill in kills {
        let mut random = random::seeded_stream(seed, &[kill]);
        let bytes = random.random_range(0..=whole);
        let pause = Duration::from_micros(random.random_range(0..5_000));
        let (heard, record) = killed(witness, daemon, bytes, pause);
        // The daemon waits for an acknowledgement if a run is unfinished.
        (witness, daemon) = serve(&shop);
        stays_silent(&witness);
        in_mid_run += u64::from(examine(&shop, &daemon, (heard, &record), &mut known));
        stays_silent(&witness);
    }
    assert_eq!(daemon.terminate(), 0);
    assert_eq!(witness.end().bytes(), 0);
    (known, in_mid_run)
}

/// Asserts that neither the daemon itself nor an acknowledgement causes motion.
fn stays_silent(witness: &RecordingControl) {
    const LONG: Duration = Duration::from_secs(1);
    let (began, mut silent) = (Instant::now(), false);
    witness.wait_for(1, || {
        silent = began.elapsed() >= LONG;
        silent
    });
    assert!(silent, "the control was spoken to before anybody started a cycle");
}

fn serve(shop: &MachineShop) -> (RecordingControl, DaemonProcess) {
    let witness = RecordingControl::start();
    shop.replace_machine(&machine(&witness));
    let daemon = shop.serve("fast");
    (witness, daemon)
}

/// One cycle, killed when `bytes` have passed the wire and `pause` has elapsed.
fn killed(witness: RecordingControl, mut daemon: DaemonProcess, bytes: usize, pause: Duration) -> (Heard, Record) {
    let listener = Listener::connect(daemon.http());
    assert_eq!(daemon.http().start(1), 202);
    // All bytes may already have passed the wire: the daemon is then killed while it computes, or while it is idle.
    let (client, began) = (daemon.http(), Instant::now());
    witness.wait_for(bytes, || began.elapsed() > Duration::from_secs(1) && client.machine()["state"] == "waiting");
    sleep(pause);
    daemon.kill();
    (listener.end(), witness.end())
}

/// Checks the state that the killed daemon left, as the next daemon finds it; returns whether the kill was during a
/// run.
fn examine(shop: &MachineShop, daemon: &DaemonProcess, (heard, record): (Heard, &Record), known: &mut usize) -> bool {
    let journal = Journal::open(&shop.state()).unwrap();
    let database = Connection::open(shop.state().join("journal.sqlite")).unwrap();
    let whole: String = database.query_row("PRAGMA integrity_check", [], |row| row.get(0)).unwrap();
    assert_eq!(whole, "ok");
    let runs = journal.runs().unwrap();
    let new = runs.len() - *known;
    *known = runs.len();
    assert!(new <= 1 && runs.iter().all(|run| run.state != RunState::Running), "{runs:?}");
    let state = daemon.http().machine()["state"].clone();
    let Some(run) = runs.last().filter(|_| new == 1) else {
        assert_eq!((record.begun(), record.touches().len()), (0, 0), "moved without a run");
        assert_eq!((heard.measured, &state), (0, &json!("waiting")));
        return false;
    };
    assert_kept(run.id, &journal.load_run(run.id).unwrap().readings, heard, record);
    // Measured, but perhaps not identified: no acknowledgement is needed.
    if !run.state.is_resumable() {
        assert_eq!(state, "waiting");
        return false;
    }
    assert_eq!((run.state, &state), (RunState::Interrupted, &json!("held")));
    assert_eq!(daemon.http().start(1), 409);
    assert_eq!(daemon.http().post("acknowledge", &json!({"who": "Ada", "why": "looked"})).0, 202);
    daemon.http().wait_for_state("waiting");
    !record.touches().is_empty()
}

/// Asserts that no reading is lost: neither one after which the control got another request, nor one that a client
/// received.
fn assert_kept(run: RunId, readings: &[Reading], heard: Heard, record: &Record) {
    let (count, touches) = (readings.len(), record.touches());
    if i64::try_from(heard.run) == Ok(run.0) {
        assert!(count as u64 >= heard.measured, "{count} kept, {heard:?} were shown");
    }
    assert!(count >= record.begun(), "{count} kept, but step {} was begun", record.begun());
    assert!(count <= touches.len() && count + 1 >= touches.len(), "{count}, {}", touches.len());
    for (reading, touch) in readings.iter().zip(touches) {
        let at = reading.position.iter().map(|(axis, value)| axis.to_mm_or_deg(value));
        assert_eq!(at.take(touch.len()).collect::<Vec<_>>(), touch, "step {}", reading.step);
    }
}
