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

use super::event_listener::{EventListener, ReceivedProgress};
use super::served_machine::served_machine_toml;
use crate::support::daemon_process::DaemonProcess;
use crate::support::machine_shop::MachineShop;
use crate::support::recording_control::{RecordingControl, WireRecord};

pub fn ten_kills_lose_no_reading_and_cause_no_motion() {
    run_kills(10, 1);
}

pub fn two_hundred_kills_lose_no_reading_and_cause_no_motion() {
    run_kills(200, 2);
}

fn machine_toml_of_control(witness: &RecordingControl) -> String {
    let wire = "kind = \"simulated\"";
    let machine = served_machine_toml("");
    assert!(machine.contains(wire) && machine.contains("\nwire = \"memory\""));
    let tcp = format!("kind = \"grbl\"\ntcp = \"{}\"", witness.address());
    machine.replacen(wire, &tcp, 1).replacen("\nwire = \"memory\"", "", 1)
}

/// Four journals in parallel, each with its share of the kills: most of the time is waiting.
fn run_kills(count: u64, seed: u64) {
    const SHOP_COUNT: u64 = 4;
    let share = |shop: u64| move || kill_in_one_shop((shop..count).step_by(SHOP_COUNT as usize), seed);
    let (known, in_mid_run) = std::thread::scope(|scope| {
        let shops: Vec<_> = (0..SHOP_COUNT).map(|shop| scope.spawn(share(shop))).collect();
        let ended = shops.into_iter().map(|shop| shop.join().unwrap());
        ended.fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1))
    });
    println!("{count} kills, {known} runs, {in_mid_run} of them dead between touches");
    assert!(in_mid_run * 2 > count, "{in_mid_run} of {count} kills met a run");
}

/// All kills in one journal, so that each daemon starts with the state that the killed one left. Returns the number
/// of runs in the journal, and of those killed during a run.
fn kill_in_one_shop(kills: impl Iterator<Item = u64>, seed: u64) -> (usize, u64) {
    let shop = MachineShop::with_machine_file("");
    let (witness, daemon) = start_daemon_with_control(&shop);
    assert_eq!(daemon.http().start_cycle(1), 202);
    daemon.http().wait_for_state("waiting");
    assert_eq!(daemon.terminate(), 0);
    let whole = witness.stop_and_take_record().transferred_byte_count();
    let (mut known, mut in_mid_run) = (1, 0);
    let (mut witness, mut daemon) = start_daemon_with_control(&shop);
    for kill in kills {
        let mut random = random::seeded_stream(seed, &[kill]);
        let bytes = random.random_range(0..=whole);
        let pause = Duration::from_micros(random.random_range(0..5_000));
        let (heard, record) = kill_daemon(witness, daemon, bytes, pause);
        // The daemon waits for an acknowledgement if a run is unfinished.
        (witness, daemon) = start_daemon_with_control(&shop);
        assert_control_receives_nothing(&witness);
        in_mid_run += u64::from(check_after_kill(&shop, &daemon, (heard, &record), &mut known));
        assert_control_receives_nothing(&witness);
    }
    assert_eq!(daemon.terminate(), 0);
    assert_eq!(witness.stop_and_take_record().transferred_byte_count(), 0);
    (known, in_mid_run)
}

/// Asserts that neither the daemon itself nor an acknowledgement causes motion.
fn assert_control_receives_nothing(witness: &RecordingControl) {
    const SILENCE_DURATION: Duration = Duration::from_secs(1);
    let (began, mut silent) = (Instant::now(), false);
    witness.wait_for_transferred_bytes(1, || {
        silent = began.elapsed() >= SILENCE_DURATION;
        silent
    });
    assert!(silent, "the control was spoken to before anybody started a cycle");
}

fn start_daemon_with_control(shop: &MachineShop) -> (RecordingControl, DaemonProcess) {
    let witness = RecordingControl::start();
    shop.replace_machine_file(&machine_toml_of_control(&witness));
    let daemon = shop.start_daemon("fast");
    (witness, daemon)
}

/// One cycle, killed when `bytes` have passed the wire and `pause` has elapsed.
fn kill_daemon(
    witness: RecordingControl,
    mut daemon: DaemonProcess,
    bytes: usize,
    pause: Duration,
) -> (ReceivedProgress, WireRecord) {
    let listener = EventListener::connect(daemon.http());
    assert_eq!(daemon.http().start_cycle(1), 202);
    // All bytes may already have passed the wire: the daemon is then killed while it computes, or while it is idle.
    let (client, began) = (daemon.http(), Instant::now());
    witness.wait_for_transferred_bytes(bytes, || {
        began.elapsed() > Duration::from_secs(1) && client.machine_state()["state"] == "waiting"
    });
    sleep(pause);
    daemon.kill();
    (listener.wait_until_closed(), witness.stop_and_take_record())
}

/// Checks the state that the killed daemon left, as the next daemon finds it; returns whether the kill was during a
/// run.
fn check_after_kill(
    shop: &MachineShop,
    daemon: &DaemonProcess,
    (heard, record): (ReceivedProgress, &WireRecord),
    known_run_count: &mut usize,
) -> bool {
    let journal = Journal::open(&shop.state_folder()).unwrap();
    let database = Connection::open(shop.state_folder().join("journal.sqlite")).unwrap();
    let whole: String = database.query_row("PRAGMA integrity_check", [], |row| row.get(0)).unwrap();
    assert_eq!(whole, "ok");
    let runs = journal.runs().unwrap();
    let new = runs.len() - *known_run_count;
    *known_run_count = runs.len();
    assert!(new <= 1 && runs.iter().all(|run| run.state != RunState::Running), "{runs:?}");
    let state = daemon.http().machine_state()["state"].clone();
    let Some(run) = runs.last().filter(|_| new == 1) else {
        assert_eq!(
            (record.last_started_step(), record.reported_touch_positions().len()),
            (0, 0),
            "moved without a run"
        );
        assert_eq!((heard.measured_step_count, &state), (0, &json!("waiting")));
        return false;
    };
    assert_readings_kept(run.id, &journal.load_run(run.id).unwrap().readings, heard, record);
    // Measured, but perhaps not identified: no acknowledgement is needed.
    if !run.state.is_resumable() {
        assert_eq!(state, "waiting");
        return false;
    }
    assert_eq!((run.state, &state), (RunState::Interrupted, &json!("held")));
    assert_eq!(daemon.http().start_cycle(1), 409);
    assert_eq!(daemon.http().post_action("acknowledge", &json!({"who": "Ada", "why": "looked"})).0, 202);
    daemon.http().wait_for_state("waiting");
    !record.reported_touch_positions().is_empty()
}

/// Asserts that no reading is lost: neither one after which the control got another request, nor one that a client
/// received.
fn assert_readings_kept(run: RunId, readings: &[Reading], heard: ReceivedProgress, record: &WireRecord) {
    let (count, touches) = (readings.len(), record.reported_touch_positions());
    if i64::try_from(heard.run_id) == Ok(run.0) {
        assert!(count as u64 >= heard.measured_step_count, "{count} kept, {heard:?} were shown");
    }
    assert!(count >= record.last_started_step(), "{count} kept, but step {} was begun", record.last_started_step());
    assert!(count <= touches.len() && count + 1 >= touches.len(), "{count}, {}", touches.len());
    for (reading, touch) in readings.iter().zip(touches) {
        let at = reading.position.iter().map(|(axis, value)| axis.to_mm_or_deg(value));
        assert_eq!(at.take(touch.len()).collect::<Vec<_>>(), touch, "step {}", reading.step);
    }
}
