//! A thousand samples a second beside a running cycle, while every core computes: none is lost while the
//! run listens. The sensor is the script that knows nothing of ours; what it sees it is told.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use trued::base::Clock;
use trued::record::reading::Flag;
use trued::record::sensor;
use trued::run::Cycle;
use trued::sensors::serial::{Config, Serial};
use trued::sensors::{Driver, Named, Opening, Prepared, Reached, Sample, Sensor, SensorError};
use trued::setup::{self, MachineFile, Pace, Past};
use trued::store::Journal;
use trued::world::{Sensed, World};

use super::bench::Bench;
use super::shop::file;

const PYTHON: &str = "python3";

/// The script's frames: 10 nm, counter round at 65536. The kernel may be late with what stands in a
/// pseudo-terminal when all cores compute: that is no silence of the sensor.
const FRAMES: &str = r#"
timeout_s = 10.0
[frame]
sync = [0x7E, 0x81]
length = 5
counter = { byte = 0, width = 16, order = "little" }
checksum = { kind = "crc16-xmodem", order = "big" }
value = { byte = 2, width = 24, order = "big", signed = true, scale_mm = 1e-5, codes = [
    { is = -8388608, means = "no-echo" } ] }
"#;

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

/// What came to the run, sample by sample.
#[derive(Debug, Default)]
struct Tally {
    taken: u64,
    /// As the sensor's counter says.
    missing: u64,
    silences: u64,
    /// The longest that a sample was late to the one before, s.
    longest_s: f64,
    last_s: Option<f64>,
}

/// The sensor on its port; each sample that the run is given is counted.
#[derive(Debug)]
struct Counted {
    config: Config,
    tally: Arc<Mutex<Tally>>,
}

impl Named for Counted {
    fn at(&self) -> String {
        self.config.at()
    }

    fn open<'a>(&'a self, sensor: &'a sensor::Sensor, clock: Arc<dyn Clock>) -> Opening<'a> {
        Box::pin(async move {
            let serial = Serial::open(self.config.clone(), sensor, clock).await?;
            let counting = Counting { serial, tally: self.tally.clone() };
            Ok(Sensor::spawn(sensor.name.as_str(), counting))
        })
    }
}

struct Counting {
    serial: Serial,
    tally: Arc<Mutex<Tally>>,
}

impl Driver for Counting {
    async fn prepare(&mut self) -> Result<Prepared, SensorError> {
        self.serial.prepare().await
    }

    async fn forget(&mut self) -> Result<(), SensorError> {
        self.tally.lock().unwrap().last_s = None;
        self.serial.forget().await
    }

    async fn next(&mut self) -> Result<Sample, SensorError> {
        let sample = self.serial.next().await?;
        let mut tally = self.tally.lock().unwrap();
        tally.taken += 1;
        tally.missing += u64::from(sample.missing);
        tally.silences += u64::from(sample.flag == Flag::Stale);
        let late_s = tally.last_s.map_or(0.0, |last_s| sample.t_s - last_s);
        tally.longest_s = tally.longest_s.max(late_s);
        tally.last_s = Some(sample.t_s);
        Ok(sample)
    }

    fn on_demand(&self) -> bool {
        self.serial.on_demand()
    }
}

#[test]
#[ignore = "takes two minutes; .ci/long runs it"]
fn nothing_is_lost_at_1_khz_beside_a_running_cycle_and_load() {
    let is_there = Command::new(PYTHON).arg("--version").output().is_ok();
    assert!(is_there, "{PYTHON} is not here");
    let text = include_str!("../../config/laser.toml").to_owned() + SETTINGS;
    let bench = Bench::at(&text, Pace::Real);
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

    let control = format!("tcp = \"{}\"", bench.address);
    let text = file(&text, &control, "[sensor.simulated]\n");
    let mut machine = MachineFile::parse("machine.toml", text).unwrap();
    let config = toml::from_str(&format!("serial = \"{}\"\n{FRAMES}", script.path)).unwrap();
    let tally = Arc::new(Mutex::new(Tally::default()));
    machine.sensors[0].reached = Reached::Real(Arc::new(Counted { config, tally: tally.clone() }));
    let (method, plan) = setup::header(&machine, "laser-r-test", None).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let journal = Journal::open(folder.path()).unwrap();
    let begun = Instant::now();
    // One thread for everything that waits, as the program has it.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let run = runtime.block_on(async {
        let devices = setup::devices(&machine, Pace::Real, Past::default()).await.unwrap();
        let cycle = Cycle { machine: &machine, method: method.into(), plan, priors: Vec::new() };
        let ended = cycle.run(&devices, &journal, |_| (), &mut |_| ()).await;
        ended.unwrap_or_else(|error| panic!("{error}")).0
    });
    let seconds = begun.elapsed();
    drop(beside);

    let tally = tally.lock().unwrap();
    let readings = journal.load(run).unwrap().readings;
    let flagged = readings.iter().filter(|reading| reading.flag != Flag::None).count();
    println!("{seconds:.1?}: {tally:?}; {} kept, {flagged} flagged", readings.len());
    assert!(seconds > LEAST, "{seconds:?}");
    // It listens while the machine moves or rests, which is nearly always.
    assert!(tally.taken as f64 > 800.0 * seconds.as_secs_f64(), "{tally:?}");
    assert_eq!((tally.missing, tally.silences, flagged), (0, 0, 0));
    assert_eq!(readings.len() % 20, 0);
}
