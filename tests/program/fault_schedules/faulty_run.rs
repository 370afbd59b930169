//! One run of the real program on a faulty simulated machine, behind a bad wire.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use devices::controllers::Controller;
use devices::controllers::grbl::{GrblDriver, GrblTimeouts};
use estimation::random::seeded_stream;
use link::LineLink;
use machine::record::event::RunEvent;
use planning::gcode::Dialect;
use rand::RngExt;
use simulator::controls::grbl::{Fault, FaultKind, Firmware, SimulatedGrblOptions};
use simulator::faulty_wire::{FaultyWire, PlannedFault};
use trued::run::{Run, RunError};
use trued::setup::SimulationPace;
use trued::setup::{self, Devices, MachineFile};
use trued::store::{Journal, NewRun, StoredRun};

use super::wire_recording::{RecordedLine, WireRecording};

const WIRE_BUFFER_BYTES: usize = 4096;
/// Approximate number of lines that a run sends.
const APPROXIMATE_SENT_LINE_COUNT: u64 = 250;

/// All faults of the control.
pub const FAULT_KINDS: [FaultKind; 17] = [
    FaultKind::Silence,
    FaultKind::Restart,
    FaultKind::BannerWithoutRestart,
    FaultKind::LostLine,
    FaultKind::LostAnswer,
    FaultKind::DoubleOk,
    FaultKind::Garbage,
    FaultKind::Alarm,
    FaultKind::Error,
    FaultKind::ProbeStuck,
    FaultKind::ProbeDead,
    FaultKind::ForeignBody,
    FaultKind::RapidContact,
    FaultKind::SoftLimit,
    FaultKind::PersonHolds,
    FaultKind::Door,
    FaultKind::EStop,
];

/// The faults of one seed.
#[derive(Debug, Clone)]
pub struct FaultSchedule {
    seed: u64,
    /// Mean number of lines between two faults of the wire.
    mean_lines_between_wire_faults: Option<f64>,
    control_fault: Option<Fault>,
    /// Step at which the operator stops the run.
    halt_at_step: Option<u32>,
}

impl FaultSchedule {
    pub fn from_seed(seed: u64) -> Self {
        let mut draw = seeded_stream(seed, &[77]);
        let kind = FAULT_KINDS[(seed / 3) as usize % FAULT_KINDS.len()];
        let fault = Fault {
            kind,
            at_line: draw.random_range(1..APPROXIMATE_SENT_LINE_COUNT),
            after_touch: draw.random_range(0..6),
            code: (kind == FaultKind::Alarm).then(|| draw.random_range(1..10)),
        };
        let spacing = [150.0, 800.0, 4000.0][draw.random_range(0..3)];
        Self {
            seed,
            mean_lines_between_wire_faults: (seed % 3 != 1).then_some(spacing),
            control_fault: (!seed.is_multiple_of(3)).then_some(fault),
            halt_at_step: draw.random_bool(0.05).then(|| draw.random_range(0..20)),
        }
    }
}

/// Result of a run.
pub struct EndedRun {
    pub result: Result<(), RunError>,
    pub has_moved: bool,
    /// Readings that the run itself returned.
    pub returned_readings: Vec<machine::record::reading::Reading>,
    pub stored: StoredRun,
    /// Lines between the driver and the bad wire.
    pub driver_side_tape: Vec<RecordedLine>,
    /// Lines between the bad wire and the control.
    pub control_side_tape: Vec<RecordedLine>,
    /// Length of the driver's tape when the run ended.
    pub driver_side_tape_length_at_end: usize,
    pub planned_wire_faults: Vec<PlannedFault>,
    /// Faults of the control that occurred.
    pub occurred_control_faults: Vec<FaultKind>,
}

/// Journal and machine of one worker.
pub struct ScheduleBench {
    file: MachineFile,
    journal: Journal,
    _folder: tempfile::TempDir,
}

impl ScheduleBench {
    pub fn new() -> Self {
        let text = include_str!("../../../config/simulated.toml").to_owned()
            + "\n[method.self-calibration]\npositions = 8\nreferences = false\n";
        let shm = std::path::Path::new("/dev/shm");
        let folder = if shm.is_dir() { tempfile::tempdir_in(shm) } else { tempfile::tempdir() };
        let folder = folder.unwrap();
        Self {
            file: MachineFile::parse("machine.toml", text).unwrap(),
            journal: Journal::open(folder.path()).unwrap(),
            _folder: folder,
        }
    }

    pub fn run(&self, schedule: &FaultSchedule) -> EndedRun {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(self.measure(schedule))
    }

    async fn measure(&self, schedule: &FaultSchedule) -> EndedRun {
        let wired = self.open_faulty_link(schedule);
        let dialect = Dialect::from_name("grbl").unwrap();
        let modes = setup::prove_mode_text(&dialect, &self.file.machine, None).unwrap();
        let (driver, halt) = GrblDriver::new(wired.link, &self.file.machine, modes);
        let controller = Controller::spawn(driver.with_timeouts(short_timeouts()), halt.clone());
        let devices = Devices::new(controller, dialect);
        let (method, header) =
            setup::configure_method_and_plan_without_steps(&self.file, "self-calibration", None).unwrap();
        let new = NewRun { machine_file_text: self.file.text().to_owned(), plan: header.clone() };
        let id = self.journal.begin_run(&new).await.unwrap();
        let halt_at = schedule.halt_at_step;
        let mut tell = |event: &RunEvent| {
            if matches!(event, RunEvent::StepStarted { step, .. } if Some(*step) == halt_at) {
                halt.trigger();
            }
        };
        let mut run = Run::new(id, method.as_ref(), &devices, &self.journal, header, &mut tell);
        let result = run.execute().await;
        let mark = wired.driver_side_tape.entries().len();
        let Run { readings, may_have_moved: moved, .. } = run;
        // Wait for late bytes of the driver.
        tokio::time::sleep(Duration::from_millis(15)).await;
        drop(devices);
        tokio::time::sleep(Duration::from_millis(5)).await;
        EndedRun {
            result,
            has_moved: moved,
            returned_readings: readings,
            stored: self.journal.load_run(id).unwrap(),
            driver_side_tape: wired.driver_side_tape.entries(),
            control_side_tape: wired.control_side_tape.entries(),
            driver_side_tape_length_at_end: mark,
            planned_wire_faults: wired.planned_wire_faults.lock().unwrap().clone(),
            occurred_control_faults: wired.occurred_control_faults.lock().unwrap().clone(),
        }
    }

    /// Driver – tape – bad wire – tape – control.
    fn open_faulty_link(&self, schedule: &FaultSchedule) -> FaultyLink {
        let duplex = || tokio::io::duplex(WIRE_BUFFER_BYTES);
        let (driver, near_tape) = duplex();
        let (tape_near, wire_near) = duplex();
        let (wire_far, tape_far) = duplex();
        let (far_tape, control) = duplex();
        let (near, far) = (WireRecording::default(), WireRecording::default());
        let harms: Arc<Mutex<Vec<PlannedFault>>> = Arc::default();
        tokio::spawn(near.clone().record_between(near_tape, tape_near));
        tokio::spawn(far.clone().record_between(tape_far, far_tape));
        let bad = FaultyWire {
            seed: schedule.seed,
            mean_exponential_gap_lines: schedule.mean_lines_between_wire_faults.unwrap_or(f64::INFINITY),
            max_delay: Duration::from_millis(120),
        };
        let noted = harms.clone();
        tokio::spawn(async move {
            let note = move |_, planned| noted.lock().unwrap().push(planned);
            bad.connect(wire_near, wire_far, &note).await
        });
        let world = Arc::new(Mutex::new(setup::build_world(&self.file).unwrap()));
        let faults = schedule.control_fault.iter().cloned().collect();
        let options = SimulatedGrblOptions {
            faults,
            ..SimulatedGrblOptions::for_machine(&self.file.machine, SimulationPace::Immediate)
        };
        let mut firmware = Firmware::new(world, options);
        let happened = firmware.occurred_faults();
        tokio::spawn(async move { firmware.serve(control).await });
        FaultyLink {
            link: LineLink::from_stream("the bench", driver),
            driver_side_tape: near,
            control_side_tape: far,
            planned_wire_faults: harms,
            occurred_control_faults: happened,
        }
    }
}

struct FaultyLink {
    link: LineLink,
    driver_side_tape: WireRecording,
    control_side_tape: WireRecording,
    planned_wire_faults: Arc<Mutex<Vec<PlannedFault>>>,
    occurred_control_faults: Arc<Mutex<Vec<FaultKind>>>,
}

/// Short timeouts, so that hundreds of schedules finish quickly.
fn short_timeouts() -> GrblTimeouts {
    let ms = Duration::from_millis;
    GrblTimeouts { reply_timeout: ms(80), poll_interval: ms(10), follow_up_timeout: ms(20), stall_timeout: ms(300) }
}
