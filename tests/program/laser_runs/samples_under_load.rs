//! A sensor sends a thousand samples a second during a cycle, while every core computes: the program loses none. The
//! sensor is the independent script `sender.py`, which gets its distances from this test.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use machine::record::reading::ReadingFlag;
use simulator::{SensorOutput, SimulatedWorld};
use trued::setup::SimulationPace;
use trued::store::{Journal, RunId};

use super::laser_shop::replace_control_and_sensor;
use crate::support::grbl_control::GrblControl;
use crate::support::terminal_operator;

const PYTHON: &str = "python3";

/// The script's frames: 10 nm, counter modulo 65536. Under full load the kernel may deliver bytes of a
/// pseudo-terminal late: this is not a silence of the sensor.
const BYTE_FRAME_KEYS: &str = r#"
timeout_s = 10.0
[sensor.serial.frame]
sync = [0x7E, 0x81]
length = 5
counter = { byte = 0, width = 16, order = "little" }
checksum = { kind = "crc16-xmodem", order = "big" }
value = { byte = 2, width = 24, order = "big", signed = true, scale_mm = 1e-5, codes = [
    { is = -8388608, means = "no-echo" } ] }
"#;

const COUNTS_PER_MM: f64 = 1e5;
/// Settings of a run of more than a minute.
const LONG_RUN_SETTINGS: &str = "
[method.laser-r-test]
tilt_deg = [-60.0, 60.0]
turn_deg = [120.0, 240.0]
monte_carlo_trials = 100
";
const MIN_RUN_DURATION: Duration = Duration::from_secs(60);

/// Threads that run until dropped.
struct BackgroundThreads(Arc<AtomicBool>);

impl BackgroundThreads {
    fn start() -> Self {
        Self(Arc::new(AtomicBool::new(true)))
    }

    fn repeat_in_thread(&self, mut act: impl FnMut() + Send + 'static) {
        let on = self.0.clone();
        std::thread::spawn(move || {
            while on.load(Ordering::Relaxed) {
                act();
            }
        });
    }
}

impl Drop for BackgroundThreads {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Relaxed);
    }
}

/// The script, in a separate process.
struct SensorScript {
    child: Child,
    stdin: Arc<Mutex<ChildStdin>>,
    stdout: BufReader<ChildStdout>,
    pty_path: String,
}

impl SensorScript {
    fn start() -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/sensor/sender.py");
        let mut command = Command::new(PYTHON);
        command.arg(script).arg("frames").stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut stdout = BufReader::new(child.stdout.take().unwrap());
        let stdin = Arc::new(Mutex::new(child.stdin.take().unwrap()));
        let mut path = String::new();
        stdout.read_line(&mut path).unwrap();
        Self { child, stdin, stdout, pty_path: path.trim().to_owned() }
    }

    /// Sends the current distance to the script every millisecond.
    fn send_distances_every_ms(&self, world: Arc<Mutex<SimulatedWorld>>, beside: &BackgroundThreads) {
        let stdin = self.stdin.clone();
        writeln!(stdin.lock().unwrap(), "follow").unwrap();
        let mut last = Instant::now();
        beside.repeat_in_thread(move || {
            std::thread::sleep(Duration::from_millis(1));
            let passed = last.elapsed();
            last = Instant::now();
            let seen = match world.lock().unwrap().sample_after("laser", passed.as_secs_f64()) {
                Some(SensorOutput::Distance(mm)) => format!("{:.0}", mm * COUNTS_PER_MM),
                _ => "none".to_owned(),
            };
            let _ = writeln!(stdin.lock().unwrap(), "{seen}");
        });
    }

    /// Number of samples that the script has sent so far.
    fn sent_sample_count(&mut self) -> u64 {
        writeln!(self.stdin.lock().unwrap(), "count").unwrap();
        let mut line = String::new();
        self.stdout.read_line(&mut line).unwrap();
        line.trim().parse().unwrap()
    }
}

impl Drop for SensorScript {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Sample counts in the program's output at the end of a run.
#[derive(Debug)]
struct ReceptionCounts {
    received_count: u64,
    missing: u64,
    silences: u64,
    unrequested_count: u64,
}

impl ReceptionCounts {
    fn parse(line: &str) -> Option<Self> {
        let numbers = line.trim().strip_prefix("laser: ")?.split(", ");
        let numbers = numbers.map(|part| part.split(' ').next()?.parse().ok());
        let numbers: Vec<u64> = numbers.collect::<Option<_>>()?;
        let [came, missing, silences, passed_over] = numbers[..] else { return None };
        Some(Self { received_count: came, missing, silences, unrequested_count: passed_over })
    }
}

/// Loads every core.
fn load_every_core(beside: &BackgroundThreads) {
    for seed in 0..std::thread::available_parallelism().map_or(2, usize::from) {
        let mut number = seed as u64;
        beside.repeat_in_thread(move || {
            for _ in 0..10_000 {
                number = number.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            }
            std::hint::black_box(number);
        });
    }
}

/// Number of samples that may be in transit when the script's count is requested.
const MAX_SAMPLES_IN_TRANSIT: u64 = 5000;

pub fn no_sample_is_lost_at_1_khz_during_a_cycle_under_load() {
    let is_there = Command::new(PYTHON).arg("--version").output().is_ok();
    assert!(is_there, "{PYTHON} is not here");
    let text = include_str!("../../../config/laser.toml").to_owned() + LONG_RUN_SETTINGS;
    let bench = GrblControl::start_at_pace(&text, SimulationPace::RealTime);
    let (beside, mut script) = (BackgroundThreads::start(), SensorScript::start());
    script.send_distances_every_ms(bench.world.clone(), &beside);
    load_every_core(&beside);

    let control = format!("tcp = \"{}\"", bench.address);
    let sensor = format!("[sensor.serial]\nserial = \"{}\"\n{BYTE_FRAME_KEYS}", script.pty_path);
    let folder = tempfile::tempdir().unwrap();
    let machine = folder.path().join("machine.toml");
    std::fs::write(&machine, replace_control_and_sensor(&text, &control, &sensor)).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
    command.args(["run", "laser-r-test", "--json", "--machine"]).arg(machine);
    terminal_operator::confirm_prompts_with_enter(command.arg("--state").arg(folder.path()));
    let begun = Instant::now();
    let mut run = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let (mut said, mut told, mut sent) = (String::new(), None, Vec::new());
    for line in BufReader::new(run.stderr.take().unwrap()).lines().map(Result::unwrap) {
        // The sensor is ready; later, the measurement is complete.
        if line.contains("laser: serial sensor") || told.is_none() && ReceptionCounts::parse(&line).is_some() {
            sent.push(script.sent_sample_count());
            told = told.or(ReceptionCounts::parse(&line));
        }
        said += &(line + "\n");
    }
    let ended = run.wait_with_output().unwrap();
    let seconds = begun.elapsed();
    drop(beside);

    assert_eq!(ended.status.code(), Some(0), "{said}");
    let told = told.unwrap_or_else(|| panic!("it says nothing of its samples: {said}"));
    let readings = Journal::open(folder.path()).unwrap().load_run(RunId(1)).unwrap().readings;
    let flagged = readings.iter().filter(|reading| reading.flag != ReadingFlag::None).count();
    println!("{seconds:.1?}: sent up to then {sent:?}; {told:?}; {} kept, {flagged} flagged", readings.len());
    assert!(seconds > MIN_RUN_DURATION, "{seconds:?}");
    assert_eq!((told.missing, told.silences, flagged), (0, 0, 0), "{said}");
    assert_eq!(readings.len() % 20, 0);
    // The program reads the sensor while the machine moves or takes samples, which is most of the time. It does not
    // while a stage is proven; at nice 10 under this load the duration of that is not tested. Both counts together
    // are all samples that were sent.
    assert!(told.received_count > told.unrequested_count, "{told:?}");
    let [ready, measured] = sent[..] else { panic!("{sent:?} {said}") };
    let accounted = told.received_count + told.unrequested_count;
    assert!(accounted.abs_diff(measured - ready) < MAX_SAMPLES_IN_TRANSIT, "{accounted} {sent:?}");
}
