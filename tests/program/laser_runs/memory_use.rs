//! Memory use of a whole run, measured on the program during the run.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use trued::store::{Journal, RunId};

/// Enough samples at each point of each scan that the run is longer than half an hour of machine time.
const LONG_SCAN_SETTINGS: &str = "
[method.laser-r-test]
samples = 1300
monte_carlo_trials = 100
";
const MIN_MACHINE_TIME_S: f64 = 1800.0;
/// Maximum growth of the memory for each reading: its position, sensor and time. More would be a leak.
const MAX_BYTES_PER_READING: f64 = 450.0;

/// `VmRSS` or `VmHWM`, kB.
fn process_memory_kb(process: u32, key: &str) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find(|line| line.starts_with(key))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

pub fn half_hour_run_memory_grows_by_at_most_450_bytes_per_reading() {
    let folder = tempfile::tempdir().unwrap();
    let machine = folder.path().join("laser.toml");
    let text = include_str!("../../../config/laser.toml").to_owned() + LONG_SCAN_SETTINGS;
    std::fs::write(&machine, text).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
    command.args(["run", "laser-r-test", "--json", "--machine"]).arg(machine);
    command.arg("--state").arg(folder.path()).stdin(Stdio::null());
    let mut run = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let process = run.id();
    let stderr = run.stderr.take().unwrap();
    let (tell, identifying) = mpsc::channel();
    std::thread::spawn(move || {
        for line in BufReader::new(stderr).lines().map_while(Result::ok) {
            if line.contains("computing the estimate from") {
                let _ = tell.send(process_memory_kb(process, "VmRSS").unwrap());
            }
        }
    });
    let begun = Instant::now();
    let mut seen = Vec::new();
    let (measured, took) = loop {
        seen.extend(process_memory_kb(process, "VmRSS").map(|kb| (begun.elapsed(), kb)));
        if let Ok(kb) = identifying.recv_timeout(Duration::from_millis(20)) {
            break (kb, begun.elapsed());
        }
        assert!(run.try_wait().unwrap().is_none(), "it ended before it had measured");
    };
    let mut most = 0;
    while run.try_wait().unwrap().is_none() {
        most = process_memory_kb(process, "VmHWM").unwrap_or(most).max(most);
        std::thread::sleep(Duration::from_millis(5));
    }

    let readings = Journal::open(folder.path()).unwrap().load_run(RunId(1)).unwrap().readings;
    let lasted_s = readings.last().unwrap().t_s - readings[0].t_s;
    let tenth = seen.iter().find(|(at, _)| *at >= took / 10).unwrap().1;
    let kept = 0.9 * readings.len() as f64;
    let bytes = measured.saturating_sub(tenth) as f64 * 1024.0 / kept;
    println!(
        "{lasted_s:.0} s of the machine's time, {took:.1?} of this computer's, {} readings: {tenth} kB after a \
         tenth, {measured} kB at the end, {bytes:.0} bytes a reading; at most {most} kB with the identification",
        readings.len()
    );
    assert!(lasted_s > MIN_MACHINE_TIME_S, "{lasted_s}");
    assert!(bytes < MAX_BYTES_PER_READING, "{bytes}");
}
