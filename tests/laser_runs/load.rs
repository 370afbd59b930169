//! A thousand samples a second beside a running cycle, while every core computes: none is lost. The sensor
//! is the script that knows nothing of ours; what it sees it is told.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use trued::record::reading::Flag;
use trued::setup::Pace;
use trued::world::{Sensed, World};

use super::bench::Bench;
use super::shop::{file, read, said};

const PYTHON: &str = "python3";

/// `[sensor.serial]` for the script's frames: 10 nm, counter round at 65536.
fn table(path: &str) -> String {
    format!(
        r#"
[sensor.serial]
serial = "{path}"
[sensor.serial.frame]
sync = [0x7E, 0x81]
length = 5
counter = {{ byte = 0, width = 16, order = "little" }}
checksum = {{ kind = "crc16-xmodem", order = "big" }}
value = {{ byte = 2, width = 24, order = "big", signed = true, scale_mm = 1e-5, codes = [
    {{ is = -8388608, means = "no-echo" }} ] }}
"#
    )
}

const COUNTS_PER_MM: f64 = 1e5;
/// A run of more than a minute.
const SETTINGS: &str = "
[method.laser-r-test]
tilt_deg = [-60.0, 60.0]
turn_deg = [120.0, 240.0]
monte_carlo_trials = 100
";
const LEAST: Duration = Duration::from_secs(60);

/// Threads that go on until dropped.
struct Beside(Arc<AtomicBool>);

impl Beside {
    fn begin() -> Self {
        Self(Arc::new(AtomicBool::new(true)))
    }

    fn each(&self, mut act: impl FnMut() + Send + 'static) {
        let on = self.0.clone();
        std::thread::spawn(move || {
            while on.load(Ordering::Relaxed) {
                act();
            }
        });
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Relaxed);
    }
}

/// The script, in a process of its own.
struct Script {
    child: Child,
    path: String,
}

impl Script {
    fn start() -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/sensor/sender.py");
        let mut command = Command::new(PYTHON);
        command.arg(script).arg("frames").stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut path = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut path).unwrap();
        Self { child, path: path.trim().to_owned() }
    }

    /// It is told each millisecond what it sees.
    fn sees(&mut self, world: Arc<Mutex<World>>, beside: &Beside) {
        let mut stdin = self.child.stdin.take().unwrap();
        writeln!(stdin, "follow").unwrap();
        let mut last = Instant::now();
        beside.each(move || {
            std::thread::sleep(Duration::from_millis(1));
            let passed = last.elapsed();
            last = Instant::now();
            let seen = match world.lock().unwrap().sense("laser", passed.as_secs_f64()) {
                Some(Sensed::Distance(mm)) => format!("{:.0}", mm * COUNTS_PER_MM),
                _ => "none".to_owned(),
            };
            let _ = writeln!(stdin, "{seen}");
        });
    }
}

impl Drop for Script {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// When each frame came from the script, s, and its counter, as the capture of all links has it.
fn frames(capture: &str) -> Vec<(f64, u16)> {
    let name = capture.lines().find(|line| line.contains(" = ") && line.contains("/dev/pts/"));
    let link = name.and_then(|line| line.split(' ').nth(1)).expect("the sensor's link");
    let came = capture.lines().filter_map(|line| {
        let (seconds, rest) = line.split_once(' ')?;
        let bytes = rest.strip_prefix(link)?.strip_prefix(" < ")?;
        Some((seconds.parse::<f64>().ok()?, bytes))
    });
    let stamped: Vec<(f64, u8)> =
        came.flat_map(|(seconds, text)| unescaped(text).map(move |byte| (seconds, byte))).collect();
    let frame = |bytes: &[(f64, u8)]| {
        let [(seconds, 0x7E), (_, 0x81), (_, low), (_, high), ..] = *bytes else { return None };
        Some((seconds, u16::from_le_bytes([low, high])))
    };
    // What came before it was opened may begin within a frame.
    let first = stamped.windows(4).position(|at| frame(at).is_some());
    let whole = stamped[first.expect("a frame")..].chunks_exact(9);
    whole.map(|bytes| frame(bytes).expect("one frame behind the other")).collect()
}

/// The bytes that Rust writes so.
fn unescaped(text: &str) -> impl Iterator<Item = u8> {
    let mut rest = text.bytes();
    std::iter::from_fn(move || {
        Some(match rest.next()? {
            b'\\' => match rest.next()? {
                b'n' => b'\n',
                b'r' => b'\r',
                b't' => b'\t',
                b'x' => {
                    let digits = [rest.next()?, rest.next()?].map(char::from);
                    u8::from_str_radix(&digits.iter().collect::<String>(), 16).unwrap()
                }
                other => other,
            },
            byte => byte,
        })
    })
}

#[test]
#[ignore = "takes two minutes; .ci/long runs it"]
fn nothing_is_lost_at_1_khz_beside_a_running_cycle_and_load() {
    let is_there = Command::new(PYTHON).arg("--version").output().is_ok();
    assert!(is_there, "{PYTHON} is not here");
    let machine = include_str!("../../config/laser.toml").to_owned() + SETTINGS;
    let bench = Bench::at(&machine, Pace::Real);
    let (beside, mut script) = (Beside::begin(), Script::start());
    script.sees(bench.world.clone(), &beside);
    for seed in 0..std::thread::available_parallelism().map_or(2, usize::from) {
        let mut number = seed as u64;
        beside.each(move || {
            for _ in 0..10_000 {
                number = number.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            }
            std::hint::black_box(number);
        });
    }

    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let control = format!("tcp = \"{}\"", bench.address);
    std::fs::write(path("machine.toml"), file(&machine, &control, &table(&script.path))).unwrap();
    let trued = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trued"));
        let output = command.args(arguments).args(["--state", &path("state")]).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    };
    let (file, capture) = (path("machine.toml"), path("capture"));
    trued(&["run", "laser-r-test", "--machine", &file, "--capture", &capture]);
    drop(beside);

    let frames = frames(&std::fs::read_to_string(&capture).unwrap());
    let lost: u32 = frames
        .windows(2)
        .map(|pair| u32::from(pair[1].1.wrapping_sub(pair[0].1).wrapping_sub(1)))
        .sum();
    // What had waited until the port was opened came at once.
    let since = frames[frames.len() / 100].0;
    let (count, seconds) = (frames.len() - frames.len() / 100, frames[frames.len() - 1].0 - since);
    trued(&["export", "1", "--to", &path("")]);
    let readings = read(&folder.path().join("run-1-readings.csv"));
    let flagged = readings.iter().filter(|reading| reading.flag != Flag::None).count();
    println!(
        "{count} samples in {seconds:.1} s came to the program, {lost} lost; {} taken at dwell points, \
         {flagged} flagged",
        readings.len()
    );
    assert!(
        seconds > LEAST.as_secs_f64() && count as f64 > 990.0 * seconds,
        "{count} in {seconds} s"
    );
    assert_eq!((lost, flagged), (0, 0));
    assert_eq!(readings.len() % 20, 0);
}
