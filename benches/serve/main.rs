//! Cost of the page for a run: how fast a hold reaches the wire, and how much later the next line of a run comes
//! while tablets are connected. `trued serve` runs in its own process; its control runs here, at the other end of a
//! TCP wire.
//!
//! `cargo bench --bench serve`, alone on the computer.

mod daemon;
#[path = "../../tests/support/daemon_process.rs"]
#[allow(dead_code, reason = "shared with trials that use the rest of it")]
mod daemon_process;
#[path = "../../tests/support/http.rs"]
#[allow(dead_code, reason = "shared with trials that use the rest of it")]
mod http;
mod replay_control;
mod tablet_clients;
#[allow(dead_code)]
#[path = "../overhead/tape.rs"]
mod tape;

use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::json;

use daemon::Daemon;
use replay_control::ReplayControlServer;
use tablet_clients::TabletProcess;
use tape::GrblExchange;

const HOLD_COUNT: usize = 50;
/// Maximum time from the request to the wire, at the 99th percentile: of fifty, the slowest.
const MAX_HOLD_DELAY: Duration = Duration::from_millis(20);
const TABLET_COUNT: usize = 50;
/// Maximum time from a touch's result to the next line, at the 99th percentile.
const MAX_LINE_DELAY: Duration = Duration::from_millis(5);
/// Number of runs: enough touches for a 99th percentile.
const RUN_COUNT: usize = 4;
/// Duration of a touch. On a machine it is some seconds; here it is long enough that each touch has its events.
const TOUCH_DURATION: Duration = Duration::from_millis(150);

fn main() {
    if let Some((address, count)) = tablet_clients::tablet_task_from_environment() {
        return tablet_clients::run_tablets(&address, count);
    }
    let tape = daemon::record_exchanges();
    let memory = Path::new("/dev/shm");
    let disk = Path::new(env!("CARGO_TARGET_TMPDIR"));
    println!("{:<44}{:>10}{:>10}{:>10}", "", "median", "99 %", "longest");
    let mut late = Vec::new();
    for tablets in [0, TABLET_COUNT] {
        let name = format!("hold to wire, {tablets} tablets");
        late.extend(print_and_check_times(&name, &hold_delays(&tape, tablets, memory), Some(MAX_HOLD_DELAY)));
    }
    for tablets in [0, TABLET_COUNT] {
        let [within, stage] = line_delays_within_and_between_stages(&tape, tablets, memory);
        let name = format!("result to next line, {tablets} tablets");
        late.extend(print_and_check_times(&name, &within, Some(MAX_LINE_DELAY)));
        late.extend(print_and_check_times("  where a stage is planned and proven", &stage, None));
    }
    let [with_disk, _] = line_delays_within_and_between_stages(&tape, TABLET_COUNT, disk);
    late.extend(print_and_check_times("  the same, journal on the target's disk", &with_disk, None));
    assert!(late.is_empty(), "too late: {late:?}");
}

/// Prints the percentiles of `times`; returns a message if the 99th percentile exceeds `max_p99`.
fn print_and_check_times(name: &str, times: &[Duration], max_p99: Option<Duration>) -> Option<String> {
    let [median, p99, longest] = [0.5, 0.99, 1.0].map(|share| quantile(times, share));
    let ms = |time: Duration| format!("{:.2} ms", time.as_secs_f64() * 1e3);
    let limit = max_p99.map(|max| format!("  (at most {})", ms(max))).unwrap_or_default();
    println!("{name:<44}{:>10}{:>10}{:>10}{limit}", ms(median), ms(p99), ms(longest));
    max_p99.is_some_and(|max| p99 > max).then(|| format!("{name}: {}", ms(p99)))
}

/// Times from a hold request to the hold on the wire. Each hold comes at a different moment of a cycle.
fn hold_delays(tape: &[GrblExchange], tablets: usize, folder: &Path) -> Vec<Duration> {
    let wire = ReplayControlServer::new(tape.to_vec(), Duration::from_millis(20));
    let daemon = Daemon::new(wire.port, folder);
    let _readers = TabletProcess::new(&daemon.address(), tablets);
    let mut times = Vec::new();
    for number in 0..HOLD_COUNT {
        daemon.wait_until(|now| now["state"] == "waiting");
        daemon.start_cycle();
        daemon.wait_until(|now| now["measured"].as_u64().is_some_and(|count| count > 2));
        std::thread::sleep(Duration::from_micros(3_700 * (number as u64 % 16)));
        let asked = Instant::now();
        assert_eq!(daemon.send_machine_request("POST", "/hold", &json!({})).0, 202);
        daemon.wait_until(|now| now["state"] == "held");
        let seen = wire.reception_times.lock().unwrap();
        assert!(seen.hold_times.len() > number, "no hold came");
        // The first hold counts: a driver that gives up may send it again.
        let first = seen.hold_times.iter().find(|at| **at > asked).expect("a hold");
        times.push(*first - asked);
        drop(seen);
        daemon.post_until_accepted("/acknowledge", &json!({"who": "a"}));
    }
    times
}

/// Times from a touch's result to the next line, in whole runs: within a stage, and between stages.
fn line_delays_within_and_between_stages(tape: &[GrblExchange], tablets: usize, folder: &Path) -> [Vec<Duration>; 2] {
    let wire = ReplayControlServer::new(tape.to_vec(), TOUCH_DURATION);
    let daemon = Daemon::new(wire.port, folder);
    let _readers = TabletProcess::new(&daemon.address(), tablets);
    let (begun, before) = (Instant::now(), daemon.processor_time_s());
    for run in 1..=RUN_COUNT {
        daemon.start_cycle();
        daemon.wait_until(|now| now["state"] == "waiting" && now["run"] == run);
    }
    let used = (daemon.processor_time_s() - before) / begun.elapsed().as_secs_f64();
    println!("  ({tablets} tablets: {:.0} % of a core)", 100.0 * used);
    let begins = daemon.first_steps_of_stages();
    let seen = wire.reception_times.lock().unwrap();
    assert!(seen.delays_before_steps.len() > 50 * RUN_COUNT, "{} steps", seen.delays_before_steps.len());
    let (stage, within) = seen.delays_before_steps.iter().partition(|(step, _)| begins.contains(step));
    let times = |all: Vec<(u32, Duration)>| all.into_iter().map(|(_, time)| time).collect();
    [times(within), times(stage)]
}

fn quantile(times: &[Duration], share: f64) -> Duration {
    let mut sorted = times.to_vec();
    sorted.sort();
    sorted[((sorted.len() - 1) as f64 * share).ceil() as usize]
}
