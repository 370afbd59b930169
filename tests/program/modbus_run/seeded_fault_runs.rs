//! Fault schedules: short runs on a faulty control behind a faulty wire. No reading that the control did not make,
//! no line or program executed twice, no motion after a fault. `TRUED_FAULT_SEED=17` runs one schedule alone.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use devices::controllers::Controller;
use devices::controllers::modbus::{ModbusConfig, ModbusDriver, ModbusTimeouts};
use estimation::random::seeded_stream;
use link::{Pty, create_pty};
use machine::Axis;
use machine::record::reading::Reading;
use planning::gcode::Dialect;
use rand::RngExt;
use simulator::controls::modbus::{
    ControlEvent, Fault, FaultKind, Firmware, SimulatedModbusOptions, serve_rtu, serve_tcp,
};
use tokio::net::TcpListener;
use trued::setup::{self, Devices, MachineFile, SimulationPace};

use testing::population::population_size;

use super::measured_run::{MachineUnderTest, MeasuredRun, machine_with_controller};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Framing {
    Tcp,
    Rtu,
}

/// Type of the control behind the window, and its wire.
#[derive(Debug, Clone, Copy)]
struct ControlVariant {
    wire: Framing,
    is_resident_program: bool,
    full_schedule_count: u64,
    /// Approximate numbers of chunks and requests of a short run.
    approximate_chunk_count: u64,
    approximate_request_count: u64,
}

const LINE_WINDOW_TCP: ControlVariant = ControlVariant {
    wire: Framing::Tcp,
    is_resident_program: false,
    full_schedule_count: 80,
    approximate_chunk_count: 200,
    approximate_request_count: 700,
};
/// Over RTU the silences between the frames make a run slower.
const LINE_WINDOW_RTU: ControlVariant =
    ControlVariant { wire: Framing::Rtu, full_schedule_count: 38, ..LINE_WINDOW_TCP };
const RESIDENT_PROGRAM_TCP: ControlVariant = ControlVariant {
    wire: Framing::Tcp,
    is_resident_program: true,
    full_schedule_count: 72,
    approximate_chunk_count: 20,
    approximate_request_count: 350,
};
const RESIDENT_PROGRAM_RTU: ControlVariant =
    ControlVariant { wire: Framing::Rtu, full_schedule_count: 46, ..RESIDENT_PROGRAM_TCP };

/// Faults that apply to every window; `LostHold` is not included, because it affects only holds.
const COMMON_FAULT_KINDS: [FaultKind; 20] = [
    FaultKind::Late,
    FaultKind::LostAnswer,
    FaultKind::LostRequest,
    FaultKind::Exception,
    FaultKind::StatusChangesDuringRead,
    FaultKind::StaleStatus,
    FaultKind::ConnectionCut,
    FaultKind::Silence,
    FaultKind::ProgramStopped,
    FaultKind::PowerCycle,
    FaultKind::Alarm,
    FaultKind::EStop,
    FaultKind::PersonHolds,
    FaultKind::ProbeStuck,
    FaultKind::ProbeDead,
    FaultKind::ForeignBody,
    FaultKind::RapidContact,
    FaultKind::LatchByScan,
    FaultKind::HalfWritten,
    FaultKind::LostStart,
];

impl ControlVariant {
    /// All faults that can occur. A serial line has no connection that could be cut.
    fn fault_kinds(&self) -> Vec<FaultKind> {
        let program_only_kinds = self.is_resident_program.then_some(FaultKind::PROGRAM_ONLY).into_iter().flatten();
        let kinds = COMMON_FAULT_KINDS.into_iter().chain(program_only_kinds);
        kinds.filter(|kind| self.wire == Framing::Tcp || *kind != FaultKind::ConnectionCut).collect()
    }
}

/// Distance of the seeds: `wanted`, or the next larger number without a common divisor with the number of kinds.
/// The seed modulo that number selects the kind of fault, so that successive seeds give different kinds.
fn seed_stride(wanted: u64, kinds: u64) -> u64 {
    let is_coprime = |stride: &u64| (2..=kinds).all(|d| !(kinds.is_multiple_of(d) && stride.is_multiple_of(d)));
    (wanted..).find(is_coprime).unwrap_or(1)
}

/// A fault of the wire that a run survives, and one of any kind.
fn faults_of_schedule(variant: &ControlVariant, seed: u64) -> Vec<Fault> {
    let mut draw = seeded_stream(seed, &[78, u64::from(variant.is_resident_program)]);
    let kinds = variant.fault_kinds();
    let kind = kinds[seed as usize % kinds.len()];
    let fault = |kind, at_request, at_line, after_touch| Fault {
        kind,
        at_request,
        min_accepted_chunks: at_line,
        after_touch,
        code: None,
        late_s: Some(0.45),
        slow_latch_period_s: None,
    };
    let passing: Vec<_> = kinds.iter().filter(|kind| TOLERATED_FAULTS.contains(kind)).collect();
    let passing = *passing[draw.random_range(0..passing.len())];
    let at_line = draw.random_range(1..variant.approximate_chunk_count);
    vec![
        fault(passing, draw.random_range(1..variant.approximate_request_count), 0, 0),
        fault(kind, draw.random_range(0..variant.approximate_request_count / 2), at_line, draw.random_range(0..6)),
    ]
}

/// Faults that cost only time.
const TOLERATED_FAULTS: [FaultKind; 9] = [
    FaultKind::Late,
    FaultKind::LostAnswer,
    FaultKind::LostRequest,
    FaultKind::Exception,
    FaultKind::StatusChangesDuringRead,
    FaultKind::StaleStatus,
    FaultKind::HalfWritten,
    FaultKind::StaleResult,
    FaultKind::AcknowledgeIgnored,
];
/// Faults after which the control accepts nothing.
const FATAL_FAULTS: [FaultKind; 9] = [
    FaultKind::Silence,
    FaultKind::ProgramStopped,
    FaultKind::PowerCycle,
    FaultKind::Alarm,
    FaultKind::EStop,
    FaultKind::PersonHolds,
    FaultKind::LostStart,
    FaultKind::SkippedResult,
    FaultKind::ProgramRestartedAtEnd,
];
/// Faults that change the behaviour of the machine.
const WORLD_CHANGING_FAULTS: [FaultKind; 5] = [
    FaultKind::ProbeStuck,
    FaultKind::ProbeDead,
    FaultKind::ForeignBody,
    FaultKind::RapidContact,
    FaultKind::LatchByScan,
];

struct EndedRun {
    measured: MeasuredRun,
    readings: Vec<Reading>,
    diary: Vec<ControlEvent>,
    /// Length of the diary when the run ended.
    diary_length_at_end: usize,
}

fn short_run_machine_file() -> String {
    machine_with_controller("") + "\n[method.self-calibration]\npositions = 5\n"
}

/// Short timeouts, so that many schedules finish quickly.
fn short_timeouts(wire: Framing) -> ModbusTimeouts {
    let ms = Duration::from_millis;
    // On a serial line the link waits for a lost reply, and then checks whether it still comes.
    let answer = if wire == Framing::Tcp { ms(1200) } else { ms(3000) };
    ModbusTimeouts {
        reply_timeout: answer,
        poll_interval: ms(10),
        stall_timeout: ms(1200),
        heartbeat_timeout: ms(1000),
    }
}

/// Serves the control; returns its address as `[controller]`.
async fn serve_firmware(firmware: Firmware, wire: Framing) -> (String, tokio::task::JoinHandle<()>) {
    match wire {
        Framing::Tcp => {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            let at = format!("tcp = \"{}\"", listener.local_addr().unwrap());
            (at, tokio::spawn(async move { serve_tcp(firmware, listener).await.unwrap() }))
        }
        Framing::Rtu => {
            let Pty { device, path, client_side } = create_pty().unwrap();
            let at = format!("serial = \"{path}\"\nbaud = 115200\nparity = \"none\"");
            let served = async move {
                let _client_side = client_side;
                let _ = serve_rtu(firmware, device).await;
            };
            (at, tokio::spawn(served))
        }
    }
}

fn run_with_faults(variant: &ControlVariant, faults: Vec<Fault>) -> EndedRun {
    let ControlVariant { wire, is_resident_program: resident, .. } = *variant;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let file = MachineFile::parse("machine.toml", self::short_run_machine_file()).unwrap();
        let world = Arc::new(Mutex::new(setup::build_world(&file).unwrap()));
        let options = SimulatedModbusOptions {
            faults,
            has_resident_program: resident,
            ..SimulatedModbusOptions::for_machine(&file.machine, SimulationPace::Immediate)
        };
        let firmware = Firmware::new(world, options);
        let diary = firmware.event_log();
        let (at, served) = serve_firmware(firmware, wire).await;
        let program = if resident { "[program]" } else { "" };
        let keys = format!("{at}\ntimeout_s = 0.3\n{program}");
        let config: ModbusConfig = toml::from_str(&keys).unwrap();
        let dialect = Dialect::from_name("grbl-m19").unwrap();
        let modes = setup::prove_mode_text(&dialect, &file.machine, None).unwrap();
        let opened = ModbusDriver::open(&config, &file.machine, modes).await;
        let (driver, halt) = opened.unwrap();
        let controller = Controller::spawn(driver.with_timeouts(short_timeouts(wire)), halt);
        let devices = Devices::new(controller, dialect);
        let measured = MachineUnderTest::from_machine_text(self::short_run_machine_file()).measure_with(&devices).await;
        let mark = diary.lock().unwrap().len();
        // Wait for late bytes of the driver.
        tokio::time::sleep(Duration::from_millis(30)).await;
        drop(devices);
        tokio::time::sleep(Duration::from_millis(10)).await;
        served.abort();
        let diary = diary.lock().unwrap().clone();
        EndedRun { readings: measured.readings_of_any_run().to_vec(), measured, diary, diary_length_at_end: mark }
    })
}

fn occurred_faults(ended: &EndedRun) -> Vec<FaultKind> {
    let kinds = ended.diary.iter().filter_map(|entry| match entry {
        ControlEvent::FaultOccurred(kind) => Some(*kind),
        _ => None,
    });
    kinds.collect()
}

fn accepted_chunk_texts(ended: &EndedRun) -> Vec<&str> {
    let taken = ended.diary.iter().filter_map(|entry| match entry {
        ControlEvent::ChunkAccepted { text, .. } => Some(text.as_str()),
        _ => None,
    });
    taken.collect()
}

/// Every violation, as text.
fn violations(ended: &EndedRun, clean: &EndedRun) -> Vec<String> {
    let kinds = occurred_faults(ended);
    let mut all = Vec::new();
    all.extend(check_no_invented_reading(ended));
    all.extend(check_no_chunk_after_hold(ended));
    all.extend(check_no_chunk_after_fault(ended));
    all.extend(check_no_repeated_write(ended));
    if !kinds.iter().any(|kind| WORLD_CHANGING_FAULTS.contains(kind)) {
        if !accepted_chunk_texts(clean).starts_with(&accepted_chunk_texts(ended)) {
            all.push("the control accepted program chunks that are not the first ones of the clean run".to_owned());
        }
        if !clean.readings.starts_with(&ended.readings) {
            all.push("readings are not those of a clean run".to_owned());
        }
        let ended_well = ended.measured.result.is_ok();
        if kinds.iter().all(|kind| TOLERATED_FAULTS.contains(kind)) && !ended_well {
            all.push(format!("{kinds:?} ended it: {:?}", ended.measured.result));
        }
    }
    all
}

/// `None` if each reading is a contact of the control, in order, each at most once.
fn check_no_invented_reading(ended: &EndedRun) -> Option<String> {
    const AXES: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];
    let mut contacts = ended.diary.iter().filter_map(|entry| match entry {
        ControlEvent::ContactLatched { latch, t_s } => Some((latch.clone(), *t_s)),
        _ => None,
    });
    let told = |reading: &Reading| {
        let step = |axis: Axis| (axis.to_mm_or_deg(reading.position.get_or_zero(axis)) * 1e3).round() as i32;
        (AXES.map(step).to_vec(), reading.t_s)
    };
    let made_up = ended.readings.iter().find(|reading| {
        let told = told(reading);
        !contacts.any(|contact| contact == told)
    });
    made_up.map(|reading| format!("the control never made {reading:?}"))
}

/// `None` if no chunk is offered after a hold was written, nor after the run has ended.
fn check_no_chunk_after_hold(ended: &EndedRun) -> Option<String> {
    let hold = ended.diary.iter().position(|entry| *entry == ControlEvent::HoldRegisterWritten);
    let from = hold.unwrap_or(ended.diary_length_at_end).min(ended.diary_length_at_end);
    let late = ended.diary[from..].iter().any(|entry| matches!(entry, ControlEvent::ChunkOffered { .. }));
    late.then(|| "a chunk was offered after the hold, or after the end".to_owned())
}

/// `None` if after a fatal fault the control accepts no chunk and is offered at most 4: one chunk may be in transit.
fn check_no_chunk_after_fault(ended: &EndedRun) -> Option<String> {
    let fatal =
        |entry: &ControlEvent| matches!(entry, ControlEvent::FaultOccurred(kind) if FATAL_FAULTS.contains(kind));
    let after = ended.diary.iter().skip_while(|entry| !fatal(entry));
    let (mut asked, mut took) = (0, 0);
    for entry in after {
        asked += u32::from(matches!(entry, ControlEvent::ChunkOffered { .. }));
        took += u32::from(matches!(entry, ControlEvent::ChunkAccepted { .. }));
    }
    // A chunk repeated for lack of an answer has the same sequence.
    (took > 0 || asked > 4).then(|| format!("after the fault {asked} chunks were offered, {took} taken"))
}

/// `None` if no chunk that the control has accepted is offered again.
fn check_no_repeated_write(ended: &EndedRun) -> Option<String> {
    let mut last = None;
    ended.diary.iter().find_map(|entry| match entry {
        ControlEvent::ChunkAccepted { sequence, .. } => {
            last = Some(*sequence);
            None
        }
        ControlEvent::ChunkOffered { sequence } if last == Some(*sequence) => {
            Some(format!("sequence {sequence} was written again"))
        }
        _ => None,
    })
}

fn variant_name(value: impl std::fmt::Debug) -> String {
    let text = format!("{value:?}");
    text.trim_start_matches("Err(").split(|c: char| !c.is_alphanumeric()).next().unwrap().to_owned()
}

fn ending_name(ended: &EndedRun) -> String {
    match &ended.measured.result {
        Ok(()) => "Finished".to_owned(),
        Err(error) => error.controller_error().map_or_else(|| variant_name(error), variant_name),
    }
}

const EXPECTED_ENDINGS: [&str; 6] = ["Finished", "Modbus", "Alarm", "HeldAtControl", "Reset", "NoContact"];

pub fn line_window_faults_repeat_no_chunk_nor_invent_readings_over_tcp() {
    run_all_schedules(&LINE_WINDOW_TCP, "NoAnswer");
}

pub fn line_window_faults_repeat_no_chunk_nor_invent_readings_over_rtu() {
    run_all_schedules(&LINE_WINDOW_RTU, "NoAnswer");
}

pub fn resident_program_faults_repeat_no_chunk_nor_invent_readings_over_tcp() {
    run_all_schedules(&RESIDENT_PROGRAM_TCP, "UnexpectedReply");
}

pub fn resident_program_faults_repeat_no_chunk_nor_invent_readings_over_rtu() {
    run_all_schedules(&RESIDENT_PROGRAM_RTU, "UnexpectedReply");
}

/// Asserts the invariants for all schedules of `variant`. `additional_ending`: an ending that only
/// this control and wire have; like [`EXPECTED_ENDINGS`], it must occur in a full set of schedules.
fn run_all_schedules(variant: &ControlVariant, additional_ending: &str) {
    let clean = run_with_faults(variant, Vec::new());
    assert!(clean.measured.result.is_ok(), "{:?}", clean.measured.result);
    if let Ok(seed) = std::env::var("TRUED_FAULT_SEED") {
        let ended = run_with_faults(variant, faults_of_schedule(variant, seed.parse().unwrap()));
        ended.diary.iter().for_each(|entry| println!("{entry:?}"));
        println!("{:?}", ended.measured.result);
        assert_eq!(violations(&ended, &clean), Vec::<String>::new());
        return;
    }
    let schedules = population_size(variant.full_schedule_count);
    let stride = seed_stride(variant.full_schedule_count / schedules, variant.fault_kinds().len() as u64);
    let (next, all) = (AtomicU64::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        // Most of the time a run waits for an answer that does not come.
        for _ in 0..6 {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::SeqCst);
                    if number >= schedules {
                        return;
                    }
                    let seed = number * stride;
                    let ended = run_with_faults(variant, faults_of_schedule(variant, seed));
                    let breaches = violations(&ended, &clean);
                    all.lock().unwrap().push((seed, ending_name(&ended), occurred_faults(&ended), breaches));
                }
            });
        }
    });
    let all = all.into_inner().unwrap();
    let mut endings = BTreeMap::<&str, u32>::new();
    let mut kinds = BTreeMap::<FaultKind, u32>::new();
    for (_, ending, wrong, _) in &all {
        *endings.entry(ending).or_default() += 1;
        wrong.iter().for_each(|kind| *kinds.entry(*kind).or_default() += 1);
    }
    println!("{variant:?}: endings {endings:?}\nfaults {kinds:?}");
    let breached: Vec<_> = all.iter().filter(|(.., breaches)| !breaches.is_empty()).collect();
    assert!(breached.is_empty(), "{breached:#?}");
    if schedules < variant.full_schedule_count {
        // Too few schedules for all kinds of fault: several kinds must have occurred.
        let least = (schedules.min(variant.fault_kinds().len() as u64) / 4).max(1) as usize;
        assert!(endings.len() > 1 && kinds.len() >= least, "{endings:?} {kinds:?}");
        return;
    }
    // Each fault and each result occurred.
    let missing: Vec<_> = variant.fault_kinds().into_iter().filter(|kind| !kinds.contains_key(kind)).collect();
    assert!(missing.is_empty(), "{missing:?}");
    for ending in EXPECTED_ENDINGS.into_iter().chain([additional_ending]) {
        assert!(endings.contains_key(ending), "no run ended as {ending}: {endings:?}");
    }
}
