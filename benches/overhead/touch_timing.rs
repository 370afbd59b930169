//! Runs a measurement (plan, proof, rendering, driver, link, journal) on a control that replays recorded answers,
//! and times each touch: from the previous reading, or the start of the stage, until its own reading is in the journal.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use devices::controllers::Controller;
use devices::controllers::grbl::GrblDriver;
use devices::controllers::modbus::{ModbusConfig, ModbusDriver};
use link::{CaptureWriter, LineLink, LinkAddress, LinkMode};
use machine::record::event::RunEvent;
use machine::record::reading::Reading;
use planning::gcode::Dialect;
use trued::run::Run;
use trued::setup::{self, Devices, EarlierSessions, MachineFile, SimulationPace};
use trued::store::{Journal, NewRun};

use super::{replay_controls, tape};

const SIMULATED_MACHINE_TOML: &str = include_str!("../../config/simulated.toml");
const METHOD_NAME: &str = "self-calibration";

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ControlWire {
    GrblMemory,
    GrblPty,
    ModbusTcp,
}

impl ControlWire {
    pub const ALL: [Self; 3] = [Self::GrblMemory, Self::GrblPty, Self::ModbusTcp];

    pub fn name(self) -> &'static str {
        match self {
            Self::GrblMemory => "grbl in memory",
            Self::GrblPty => "grbl over a pseudo-terminal",
            Self::ModbusTcp => "Modbus TCP",
        }
    }

    /// Whether the limit applies. On a pseudo-terminal each exchange passes the kernel's line discipline, one work
    /// queue in each direction; the daemon does not control that time.
    pub fn has_time_limit(self) -> bool {
        self != Self::GrblPty
    }

    fn machine_file(self) -> MachineFile {
        let keys = match self {
            Self::GrblMemory | Self::GrblPty => "wire = \"memory\"\n",
            Self::ModbusTcp => "speaks = \"modbus\"\nwire = \"tcp\"\n",
        };
        assert!(SIMULATED_MACHINE_TOML.contains("wire = \"memory\"\n"));
        let text = SIMULATED_MACHINE_TOML.replace("wire = \"memory\"\n", keys);
        let text = text + "\n[method.self-calibration]\nrepeats = 4\n";
        MachineFile::parse("machine.toml", text).unwrap()
    }
}

/// The recorded answers of a control to one run of a method, for replay over one wire.
pub struct RecordedControl {
    wire: ControlWire,
    machine_file: MachineFile,
    capture_text: String,
}

/// Times of the touches in their order, and of the pauses between stages, in which the next stage is planned and
/// proven.
pub struct TimedRun {
    pub touch_times: Vec<Duration>,
    pub pauses_between_stages: Vec<Duration>,
    pub readings: Vec<Reading>,
}

/// A folder in memory, where the system has one.
pub fn memory_folder() -> PathBuf {
    let shared = PathBuf::from("/dev/shm");
    if shared.is_dir() { shared } else { std::env::temp_dir() }
}

impl RecordedControl {
    /// Runs the method once on the simulated control and keeps its answers.
    pub fn record(wire: ControlWire) -> Self {
        let (file, folder) = (wire.machine_file(), tempfile::tempdir().unwrap());
        let path = folder.path().join("a.capture");
        block_on_new_runtime(async {
            let capture = CaptureWriter::create(&path).unwrap();
            let wiring = LinkMode::Captured(capture.clone());
            let opening = setup::open_devices(&file, SimulationPace::Immediate, EarlierSessions::default());
            let devices = wiring.apply_to(opening).await.unwrap();
            run_and_time_touches(&file, &devices, &memory_folder()).await;
            drop(devices);
            capture.finish().unwrap();
        });
        let capture = std::fs::read_to_string(&path).unwrap();
        Self { wire, machine_file: file, capture_text: capture }
    }

    /// Runs the whole method again with the prepared answers; the journal is in `folder`.
    pub fn time_run(&self, folder: &Path) -> TimedRun {
        block_on_new_runtime(async {
            let devices = self.open_devices().await;
            run_and_time_touches(&self.machine_file, &devices, folder).await
        })
    }

    async fn open_devices(&self) -> Devices {
        let machine = &self.machine_file.machine;
        let dialect = Dialect::from_name("grbl-m19").unwrap();
        let dialect = dialect.with_machine_options(machine, &self.machine_file.probe).unwrap();
        let modes = setup::prove_mode_text(&dialect, machine, None).unwrap();
        let link = match self.wire {
            ControlWire::GrblMemory => {
                let (near, far) = tokio::io::duplex(4096);
                replay_controls::serve_grbl_control(tape::grbl_exchanges(&self.capture_text), move || far);
                LineLink::from_stream("the control", near)
            }
            ControlWire::GrblPty => {
                let (tell, told) = std::sync::mpsc::channel();
                replay_controls::serve_grbl_control(tape::grbl_exchanges(&self.capture_text), move || {
                    let pty = link::create_pty().unwrap();
                    tell.send((pty.path, pty.client_side)).unwrap();
                    pty.device
                });
                let (path, client_side) = told.recv().unwrap();
                // Held open until the process ends.
                std::mem::forget(client_side);
                link::open_line_link(&LinkAddress::Serial { path, baud: 115_200 }).await.unwrap()
            }
            ControlWire::ModbusTcp => {
                let port = replay_controls::serve_modbus_control(tape::modbus_status_by_sequence(&self.capture_text));
                let config: ModbusConfig = toml::from_str(&format!("tcp = \"127.0.0.1:{port}\"")).unwrap();
                let opened = ModbusDriver::open(&config, machine, modes).await;
                let (driver, halt) = opened.unwrap();
                return Devices::new(Controller::spawn(driver, halt), dialect);
            }
        };
        let (driver, halt) = GrblDriver::new(link, machine, modes);
        Devices::new(Controller::spawn(driver, halt), dialect)
    }
}

fn block_on_new_runtime<T>(work: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(work)
}

async fn run_and_time_touches(file: &MachineFile, devices: &Devices, folder: &Path) -> TimedRun {
    let folder = tempfile::tempdir_in(folder).unwrap();
    let journal = Journal::open(folder.path()).unwrap();
    let (method, header) = setup::configure_method_and_plan_without_steps(file, METHOD_NAME, None).unwrap();
    let new = NewRun { machine_file_text: file.text().to_owned(), plan: header.clone() };
    let id = journal.begin_run(&new).await.unwrap();
    let (mut touches, mut stages) = (Vec::new(), Vec::new());
    let (mut begun, mut ended, mut between) = (None::<Instant>, None::<Instant>, false);
    let mut on_event = |event: &RunEvent| match event {
        RunEvent::StageStarted { .. } => between = true,
        RunEvent::StepStarted { .. } if between => {
            between = false;
            let now = Instant::now();
            stages.extend(ended.map(|ended| now - ended));
            begun = Some(now);
        }
        // This event comes after the reading is stored.
        RunEvent::ReadingStored { .. } => {
            let now = Instant::now();
            touches.extend(begun.replace(now).map(|begun| now - begun));
            ended = Some(now);
        }
        _ => {}
    };
    let mut run = Run::new(id, method.as_ref(), devices, &journal, header, &mut on_event);
    run.execute().await.unwrap();
    let readings = run.readings;
    assert!(touches.len() == readings.len() && readings.len() > 200, "{} touches", touches.len());
    TimedRun { touch_times: touches, pauses_between_stages: stages, readings }
}

/// Smallest time that at least `share` of the times do not exceed.
pub fn quantile(times: &[Duration], share: f64) -> Duration {
    let mut sorted = times.to_vec();
    sorted.sort();
    sorted[((sorted.len() - 1) as f64 * share).ceil() as usize]
}
