//! Many runs in sequence while clients read: the use of resources does not grow.

use super::event_listener::EventListener;
use super::served_machine::served_machine_toml;
use crate::support::daemon_process::DaemonProcess;
use crate::support::http::HttpClient;
use crate::support::machine_shop::MachineShop;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Maximum growth of memory after the first tenth of the runs.
const MAX_RESIDENT_GROWTH_KIB: u64 = 5 * 1024;
const MAX_IDLE_RESIDENT_KIB: u64 = 40 * 1024;
const MAX_IDLE_ANONYMOUS_KIB: u64 = 16 * 1024;
/// Maximum load while idle, share of a core.
const MAX_IDLE_LOAD: f64 = 0.01;

pub fn memory_grows_at_most_5_mib_from_run_5_to_50() {
    check_memory_growth(50, 5);
}

pub fn memory_grows_at_most_5_mib_from_run_50_to_500() {
    check_memory_growth(500, 20);
}

fn check_memory_growth(runs: u64, readers: usize) {
    let shop = MachineShop::with_machine_file(&served_machine_toml(""));
    let daemon = shop.start_daemon("fast");
    let listeners: Vec<EventListener> = (0..readers).map(|_| EventListener::connect(daemon.http())).collect();
    let mut resident = Vec::new();
    for run in 1..=runs {
        run_one_cycle(daemon.http(), run);
        resident.push(daemon.memory_kib("VmRSS"));
    }
    for listener in &listeners {
        listener.wait_for_run(runs);
    }
    let (first, rest) = resident.split_at(resident.len() / 10);
    let (before, after) = (first.iter().max().unwrap(), rest.iter().max().unwrap());
    println!("{runs} runs, {readers} readers: at most {before} KiB at first, then {after}");
    assert!(*after <= before + MAX_RESIDENT_GROWTH_KIB, "{resident:?}");
    // Idle load after all runs, with the readers and the journal.
    let load = processor_load(&daemon, Duration::from_secs(10));
    let idle = daemon.memory_kib("VmRSS");
    let allocated = daemon.memory_kib("RssAnon");
    println!("idle for 10 s: {idle} KiB ({allocated} allocated), {:.2} % of a core", load * 100.0);
    assert!(allocated < MAX_IDLE_ANONYMOUS_KIB, "{allocated} KiB allocated while it waits");
    // The code of a development build alone is larger than the release program.
    assert!(cfg!(debug_assertions) || idle < MAX_IDLE_RESIDENT_KIB, "{idle} KiB while it waits");
    assert!(load < MAX_IDLE_LOAD, "{load}");
    assert_eq!(daemon.http().machine_state()["state"], "waiting");
}

/// Runs one cycle to its end, and requests the same data as a page.
fn run_one_cycle(client: HttpClient, run: u64) {
    let cycle = if run % 5 == 1 { 1 } else { 2 };
    // Repeats the start as long as the answer is 429 (too many requests).
    while client.start_cycle(cycle) == 429 {
        sleep(Duration::from_millis(100));
    }
    let ended = client.wait_until_machine_state(|standing| standing["state"] != "running");
    assert_eq!((&ended["state"], ended["run"].as_u64()), (&"waiting".into(), Some(run)));
    client.get_json(&format!("/api/v1/runs/{run}/readings?limit=10"));
    client.get_text("/machines/simulated%20five-axis%20machine");
    client.get_text("/metrics");
}

/// User and system time of the process during `time`, from /proc/PID/stat, as a share of a core.
fn processor_load(daemon: &DaemonProcess, time: Duration) -> f64 {
    /// `sysconf(_SC_CLK_TCK)` on every Linux that this runs on.
    const CLOCK_TICKS_PER_S: f64 = 100.0;
    let ticks = || -> f64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", daemon.child.id())).unwrap();
        let after_name = stat.rsplit_once(')').unwrap().1;
        let fields: Vec<&str> = after_name.split_whitespace().collect();
        fields[11..13].iter().map(|field| field.parse::<f64>().unwrap()).sum()
    };
    let (before, began) = (ticks(), Instant::now());
    sleep(time);
    (ticks() - before) / CLOCK_TICKS_PER_S / began.elapsed().as_secs_f64()
}
