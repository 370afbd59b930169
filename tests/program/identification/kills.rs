//! SIGKILL at random moments from the first touch to the stored estimate. Every remaining run is listed and gets
//! its estimate: by `trued resume`, without motion if all is measured, or by the daemon.

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, ChildStderr, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use estimation::random;
use machine::record::event::RunEvent;
use rand::RngExt;
use trued::store::{Journal, RunId, RunState, StoredRun};

use crate::support::machine_shop::{MachineShop, built_in_machine_text, stderr};

/// The identification takes about as long as the measurement.
const LONG_IDENTIFICATION_SETTINGS: &str = "[method.self-calibration]\nmonte_carlo_trials = 100000\npositions = 5\n";
const SERVE_SECTIONS: &str = "[serve]\n[[serve.cycle]]\nnumber = 1\nmethod = \"self-calibration\"\n\
                     [serve.http]\nlisten = \"127.0.0.1:0\"\n";
/// Progress text at the beginning of the first stage; the first touch follows.
const FIRST_STAGE_TEXT: &str = " steps";
const IDENTIFYING_TEXT: &str = "computing the estimate from ";

pub fn after_6_kills_every_run_is_identified_or_closed() {
    let killed = kill_runs_at_random_moments(6, 1);
    println!("{killed:?}");
}

pub fn after_200_kills_every_run_is_identified_or_closed() {
    let killed = kill_runs_at_random_moments(200, 2);
    println!("{killed:?}");
    assert!(killed.in_measurement >= 50 && killed.in_identification >= 50, "{killed:?}");
}

/// Numbers of killed runs by state.
#[derive(Debug, Default)]
struct KillCounts {
    in_measurement: usize,
    /// Of those killed in the measurement: before the references were measured, so that the run is closed.
    closed_runs: usize,
    in_identification: usize,
    /// Of those killed in the identification: identified by the daemon.
    identified_by_daemon: usize,
    after_the_estimate: usize,
}

/// Kills `count` runs, every second one after its last reading, and checks what becomes of each.
fn kill_runs_at_random_moments(count: u64, seed: u64) -> KillCounts {
    let shop = MachineShop::with_machine_file(&format!(
        "{}\n{LONG_IDENTIFICATION_SETTINGS}{SERVE_SECTIONS}",
        built_in_machine_text()
    ));
    let mut durations = measurement_and_identification_durations(&shop);
    let mut killed = KillCounts::default();
    let mut for_the_daemon = Vec::new();
    for kill in 0..count {
        let mut random = random::seeded_stream(seed, &[kill]);
        let half = (kill % 2) as usize;
        let after = durations[half].mul_f64(random.random_range(0.0..1.1));
        let stored = kill_run_after(&shop, [FIRST_STAGE_TEXT, IDENTIFYING_TEXT][half], after);
        // The computer has other load: a kill that comes too late makes the next kills earlier.
        let in_time = [RunState::Running, RunState::NotIdentified][half];
        let is_late = stored.summary.state != in_time;
        durations[half] = durations[half].mul_f64(if is_late { 0.8 } else { 1.03 });
        match stored.summary.state {
            RunState::Running => {
                killed.in_measurement += 1;
                killed.closed_runs += usize::from(!check_resume_and_has_estimate(&shop, &stored));
            }
            RunState::Finished => killed.after_the_estimate += 1,
            // A third of them is left to the daemon.
            _ if kill % 3 == 0 => for_the_daemon.push(stored),
            _ => {
                killed.in_identification += 1;
                check_identified_without_motion(&shop, &stored, |shop| {
                    let resumed = resume_run(shop, stored.summary.id, &[]);
                    assert_eq!(resumed, (Some(0), String::new()));
                });
            }
        }
    }
    killed.identified_by_daemon = for_the_daemon.len();
    killed.in_identification += for_the_daemon.len();
    check_daemon_identifies(&shop, &for_the_daemon);
    assert_runs_are_identified_or_closed(&shop);
    killed
}

/// Duration from the first stage to the last reading, and from there to the end of the process, of a run that is
/// not killed.
fn measurement_and_identification_durations(shop: &MachineShop) -> [Duration; 2] {
    let (mut run, mut lines) = start_run(shop);
    wait_for_line(&mut lines, FIRST_STAGE_TEXT);
    let first = Instant::now();
    wait_for_line(&mut lines, IDENTIFYING_TEXT);
    let last = Instant::now();
    lines.read_to_string(&mut String::new()).unwrap();
    assert!(run.wait().unwrap().success());
    [last - first, last.elapsed()]
}

fn start_run(shop: &MachineShop) -> (Child, BufReader<ChildStderr>) {
    let mut command: Command = shop.self_calibration_command();
    command.args(["--speed", "fast"]).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut run = command.spawn().unwrap();
    let lines = BufReader::new(run.stderr.take().unwrap());
    (run, lines)
}

fn wait_for_line(lines: &mut BufReader<ChildStderr>, text: &str) {
    let mut line = String::new();
    while !line.contains(text) {
        line.clear();
        assert_ne!(lines.read_line(&mut line).unwrap(), 0, "ended before `{text}`");
    }
}

/// Starts a run, kills it `delay` after it has printed `line`, and returns its journal entry.
fn kill_run_after(shop: &MachineShop, line: &str, delay: Duration) -> StoredRun {
    let (mut run, mut lines) = start_run(shop);
    wait_for_line(&mut lines, line);
    sleep(delay);
    run.kill().unwrap();
    run.wait().unwrap();
    let journal = Journal::open(&shop.state_folder()).unwrap();
    let id = journal.runs().unwrap().last().unwrap().id;
    let stored = journal.load_run(id).unwrap();
    let is_finished = stored.summary.state == RunState::Finished;
    assert_eq!(is_finished, !stored.estimates.is_empty(), "{:?}", stored.summary);
    stored
}

/// Resumes `run` without a terminal. Returns the exit code and, unless it is 0, the error output.
fn resume_run(shop: &MachineShop, run: RunId, acknowledge_arguments: &[&str]) -> (Option<i32>, String) {
    let run = run.to_string();
    let arguments = [&["resume", &run, "--json"], acknowledge_arguments].concat();
    let ended = shop.trued_command(&arguments).stdin(Stdio::null()).output().unwrap();
    let code = ended.status.code();
    (code, if code == Some(0) { String::new() } else { stderr(&ended) })
}

/// The run was killed during the measurement: nothing moves before an acknowledgement. Returns whether it now has
/// its estimate; otherwise its references were not measured, and it is closed.
fn check_resume_and_has_estimate(shop: &MachineShop, stored: &StoredRun) -> bool {
    let run = stored.summary.id;
    let listed = String::from_utf8(shop.run_trued(&["runs"]).stdout).unwrap();
    let ways = [format!(" resume {run}`"), format!("run {run} cannot be resumed")];
    assert!(ways.iter().any(|way| listed.contains(way)), "{listed}");
    assert_eq!(shop.run_states().last().map(String::as_str), Some("interrupted"));
    let (code, told) = resume_run(shop, run, &[]);
    assert!(
        code == Some(2)
            && told.contains(
                "the name of the operator who has checked the machine is \
        missing"
            ),
        "{told}"
    );
    let (code, told) = resume_run(shop, run, &["--acknowledge", "Ada", "--homed"]);
    let after = Journal::open(&shop.state_folder()).unwrap().load_run(run).unwrap();
    let kept = after.readings.get(..stored.readings.len()) == Some(&stored.readings[..]);
    assert!(kept, "run {run}: a reading is lost");
    match code {
        Some(0) => assert_eq!(after.summary.state, RunState::Finished, "run {run}"),
        _ => assert!(told.contains("not all references were measured"), "run {run}: {told}"),
    }
    code == Some(0)
}

/// The run is listed as not identified, and gets its estimate from its readings alone.
fn check_identified_without_motion(shop: &MachineShop, stored: &StoredRun, identify: impl FnOnce(&MachineShop)) {
    let listed = String::from_utf8(shop.run_trued(&["runs"]).stdout).unwrap();
    let run = stored.summary.id;
    assert!(listed.contains(&format!("resume {run}` computes the estimate")), "{listed}");
    identify(shop);
    let after = Journal::open(&shop.state_folder()).unwrap().load_run(run).unwrap();
    let is_whole = after.readings == stored.readings && after.estimates.len() == 1;
    assert!(is_whole, "run {run}: {} estimates", after.estimates.len());
    let moved = |event: &RunEvent| matches!(event, RunEvent::Resumed { .. } | RunEvent::Acknowledged { .. });
    assert!(!after.events.iter().any(|(_, event)| moved(event)), "run {run}");
}

/// A start of the daemon identifies all of `runs`, whatever the state of the newest run.
fn check_daemon_identifies(shop: &MachineShop, runs: &[StoredRun]) {
    let Some(newest) = runs.last() else { return };
    check_identified_without_motion(shop, newest, |shop| {
        let daemon = shop.start_daemon("fast");
        for stored in runs {
            daemon.wait_for_log(&format!("run {} is identified", stored.summary.id));
        }
        assert!(!daemon.log().contains("begins"), "{}", daemon.log());
    });
}

fn assert_runs_are_identified_or_closed(shop: &MachineShop) {
    let journal = Journal::open(&shop.state_folder()).unwrap();
    for run in journal.runs().unwrap() {
        let stored = journal.load_run(run.id).unwrap();
        let settled = match run.state {
            RunState::Finished => !stored.estimates.is_empty(),
            RunState::NotResumable => stored.estimates.is_empty(),
            _ => false,
        };
        assert!(settled, "{run:?}");
    }
}
