//! The bytes that a control receives are exactly the bytes that the proof has read.

use std::sync::{Arc, Mutex};

use devices::controllers::{
    Controller, ControllerDriver, ControllerError, DeviceInfo, HaltHandle, MachineSnapshot, PreparedControl,
};
use machine::record::event::RunEvent;
use machine::record::motion::{Motion, MotionBlockOutcome};
use machine::{Axis, Position};
use planning::proof::ProvenBlock;
use simulator::controls::modbus::{ControlEvent, Firmware, SimulatedModbusOptions, serve_tcp};
use tokio::net::TcpListener;
use trued::run::Run;
use trued::setup::{self, Devices, EarlierSessions, MachineFile, SimulationPace};
use trued::store::{Journal, NewRun};

use crate::support::harness::{Pool, Trials, trials};
use crate::support::recording_control::{self, RecordingControl};

pub fn trials() -> Trials {
    trials![Pool::Computing, 0;
        grbl_receives_the_proven_lines_of_a_self_calibration,
        grbl_receives_the_proven_lines_of_a_latch_delay,
        a_window_of_registers_receives_the_proven_lines,
        a_resident_program_receives_a_row_for_each_proven_motion,
    ]
}

/// Keeps the text of each block before it reaches the driver.
struct RecordingController {
    inner: Controller,
    lines: Arc<Mutex<Vec<String>>>,
    motion_tables: Arc<Mutex<Vec<String>>>,
}

impl ControllerDriver for RecordingController {
    async fn prepare(&mut self) -> Result<PreparedControl, ControllerError> {
        self.inner.prepare().await
    }

    async fn execute(&mut self, block: ProvenBlock) -> Result<MotionBlockOutcome, ControllerError> {
        for part in block.units()? {
            self.lines.lock().unwrap().extend(part.unit.text.lines().map(str::to_owned));
        }
        let rows: Vec<String> = block.motions().map(motion_as_table_row).collect();
        let table = format!("step {}: {}", block.step(), rows.join("; "));
        self.motion_tables.lock().unwrap().push(table);
        self.inner.execute(block).await
    }

    async fn read_snapshot(&mut self) -> Result<MachineSnapshot, ControllerError> {
        self.inner.read_snapshot().await
    }

    async fn identify_device(&mut self) -> Result<DeviceInfo, ControllerError> {
        self.inner.identify_device().await
    }

    async fn restore_modes(&mut self) -> Result<(), ControllerError> {
        self.inner.restore_modes().await
    }
}

/// The proven text of one run: the lines of all blocks, and the rows of each, in the format in which the simulated
/// control's diary shows a decoded table.
struct ProvenText {
    head: Vec<String>,
    lines: Vec<String>,
    foot: Vec<String>,
    motion_tables: Vec<String>,
}

/// A motion as a row of a table, in the format of the diary.
fn motion_as_table_row(motion: &Motion) -> String {
    let (does, to, value) = match motion {
        Motion::Rapid { to } => ("Rapid", to.clone(), 0.0),
        Motion::BackOff { to, feed_mm_min } | Motion::Feed { to, feed_mm_min } => ("Feed", to.clone(), *feed_mm_min),
        Motion::Guarded { to, feed_mm_min } => ("Guarded", to.clone(), *feed_mm_min),
        Motion::Probe { to, feed_mm_min } => ("Touch", to.clone(), *feed_mm_min),
        Motion::Dwell { seconds } => ("Dwell", Position::new(), *seconds),
        Motion::OrientSpindle { s } => ("Orient", Position::new(), s.to_degrees()),
    };
    // Rounded to a tenth of a micrometre, and without a negative zero.
    let edge = |axis: Axis, at: f64| (axis.to_mm_or_deg(at) * 1e4).round() / 1e4 + 0.0;
    let axes = to.iter().map(|(axis, at)| format!(" {axis}{:.4}", edge(axis, at)));
    format!("{does}{} {value}", axes.collect::<String>())
}

/// A whole run of `method` with the machine file `text`.
async fn run_and_record_proven_text(text: String, method: &str) -> ProvenText {
    let file = MachineFile::parse("machine.toml", text).unwrap();
    let devices = setup::open_devices(&file, SimulationPace::Immediate, EarlierSessions::default()).await.unwrap();
    let (lines, rows) = (Arc::<Mutex<Vec<String>>>::default(), Arc::<Mutex<Vec<String>>>::default());
    let halt = devices.open_controller.halt_handle();
    let halting = HaltHandle::new(move || halt.trigger());
    let Devices { open_controller: inner, sensor_opener: sensors, thermometers, dialect, clock, .. } = devices;
    let recorded = RecordingController { inner, lines: lines.clone(), motion_tables: rows.clone() };
    let modes = setup::prove_mode_text(&dialect, &file.machine, None).unwrap();
    let mut devices = Devices::new(Controller::spawn(recorded, halting), dialect);
    (devices.sensor_opener, devices.thermometers, devices.clock) = (sensors, thermometers, clock);
    let folder = tempfile::tempdir().unwrap();
    let journal = Journal::open(folder.path()).unwrap();
    let (method, header) = setup::configure_method_and_plan_without_steps(&file, method, None).unwrap();
    let new = NewRun { machine_file_text: file.text().to_owned(), plan: header.clone() };
    let id = journal.begin_run(&new).await.unwrap();
    let mut tell = |_: &RunEvent| {};
    Run::new(id, method.as_ref(), &devices, &journal, header, &mut tell).execute().await.unwrap();
    let (lines, rows) = (lines.lock().unwrap().clone(), rows.lock().unwrap().clone());
    ProvenText { head: modes.head_lines().to_vec(), lines, foot: modes.foot_lines().to_vec(), motion_tables: rows }
}

fn block_on<T>(work: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(work)
}

/// The lines that grbl received are queries, the head, the proven lines, the foot and the modes that were read.
fn check_grbl_receives_proven_lines(method: &str) {
    let control = RecordingControl::start();
    let text = recording_control::machine_with_control(&control.address()) + "positions = 5\n";
    let proven = block_on(run_and_record_proven_text(text, method));
    let received = control.stop_and_take_record().received_lines();
    let is_query = |line: &String| line.is_empty() || line.starts_with('$');
    let received: Vec<String> = received.into_iter().filter(|line| !is_query(line)).collect();
    let (modes_found, rest) = received.split_last().unwrap();
    assert!(modes_found.starts_with('G'), "{modes_found}");
    assert_eq!(rest, [proven.head, proven.lines.clone(), proven.foot].concat());
    assert!(proven.lines.len() > 50, "{}", proven.lines.len());
}

pub fn grbl_receives_the_proven_lines_of_a_self_calibration() {
    check_grbl_receives_proven_lines("self-calibration");
}

pub fn grbl_receives_the_proven_lines_of_a_latch_delay() {
    check_grbl_receives_proven_lines("latch-delay");
}

/// The text that a control behind a window of registers accepted, and the proven text.
fn accepted_and_proven_text_over_modbus(has_resident_program: bool) -> (Vec<String>, ProvenText) {
    block_on(async {
        let text = include_str!("../../../config/simulated.toml");
        let world_of = MachineFile::parse("machine.toml", text.to_owned()).unwrap();
        let world = Arc::new(Mutex::new(setup::build_world(&world_of).unwrap()));
        let options = SimulatedModbusOptions {
            has_resident_program,
            ..SimulatedModbusOptions::for_machine(&world_of.machine, SimulationPace::Immediate)
        };
        let firmware = Firmware::new(world, options);
        let diary = firmware.event_log();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        tokio::spawn(async move { serve_tcp(firmware, listener).await.unwrap() });
        let program = if has_resident_program { "program = {}\n" } else { "" };
        let keys = format!("kind = \"modbus\"\ntcp = \"{address}\"\ndialect = \"grbl-m19\"\n{program}");
        let text = text.replace("kind = \"simulated\"\n", &keys).replace("wire = \"memory\"\n", "")
            + "\n[method.self-calibration]\npositions = 5\nmonte_carlo_trials = 100\n";
        let proven = run_and_record_proven_text(text, "self-calibration").await;
        let diary = diary.lock().unwrap();
        let took = diary.iter().filter_map(|entry| match entry {
            ControlEvent::ChunkAccepted { text, .. } => Some(text.clone()),
            _ => None,
        });
        (took.collect(), proven)
    })
}

pub fn a_window_of_registers_receives_the_proven_lines() {
    let (took, proven) = accepted_and_proven_text_over_modbus(false);
    let head = proven.head.into_iter().filter(|line| !line.starts_with('('));
    let expected: Vec<String> = head.chain(proven.lines).chain(proven.foot).collect();
    assert_eq!(took, expected);
}

pub fn a_resident_program_receives_a_row_for_each_proven_motion() {
    let (took, proven) = accepted_and_proven_text_over_modbus(true);
    assert_eq!(took, proven.motion_tables);
    assert!(took.len() > 10, "{}", took.len());
}
