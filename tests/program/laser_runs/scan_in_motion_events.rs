//! Events during a scan in motion: the machine is held where it is, the error gives the remedy, no part of the scan
//! is kept, everything before it is, and an operator resumes the run.

use devices::controllers::HaltHandle;
use machine::record::estimate::Estimate;
use machine::record::event::RunEvent as Told;
use machine::record::plan::{Plan, Sampling, Scan, Stage, Step, StepKind};
use machine::record::reading::{Reading, ReadingFlag};
use machine::{Axis, Position};
use methods::{IdentifyError, Method, MethodRefusal, NextStage, ObjectPositionSource};
use trued::run::{InterruptedRun, Run, RunError};
use trued::setup::machine_file::SensorConnection;
use trued::setup::{self, Devices, EarlierSessions, MachineFile, SimulationPace};
use trued::store::{Journal, NewRun, RunId, RunState, StoredRun};

use super::scripted_scene::{
    self, SAMPLE_PERIOD_S, SCAN_MIDDLE_X_MM, SCAN_Z_MM, SENSOR_RANGE_UPPER_Z_MM, SceneClock, SceneSensor,
    ScriptedEvent, SharedScene, StepSampleEvent,
};

/// Number of steps: a reference at rest (0), and two scans there and back.
const STEP_COUNT: u32 = 3;
const DWELL_POINT_OFFSETS_MM: [f64; 3] = [-2.0, 0.0, 2.0];
const SAMPLES_PER_POINT: u32 = 5;
const PASS_HALF_LENGTH_MM: f64 = 4.0;
const FEED_MM_MIN: f64 = 600.0;
/// Samples in one direction of a scan, one per period.
const SAMPLES_PER_PASS: usize = (2.0 * PASS_HALF_LENGTH_MM / (FEED_MM_MIN / 60.0) / SAMPLE_PERIOD_S) as usize;
/// Step and sample in the middle of the forward pass of the second scan.
const STEP_AND_SAMPLE_MID_FORWARD_PASS: (u32, usize) = (2, SAMPLES_PER_PASS / 2);
/// First sample of the first scan: an event from the beginning affects this scan.
const STEP_AND_SAMPLE_AT_FIRST_SCAN_START: (u32, usize) = (1, 1);
/// Step and sample in the middle of the return pass of the second scan.
const STEP_AND_SAMPLE_MID_RETURN_PASS: (u32, usize) = (2, SAMPLES_PER_PASS + SAMPLES_PER_PASS / 2);

fn scan_position_at_x_offset(by: f64) -> Position {
    let at = Position::new().with(Axis::X, SCAN_MIDDLE_X_MM + by).with(Axis::Y, 0.0);
    at.with(Axis::Z, SCAN_Z_MM).with(Axis::B, 0.0).with(Axis::C, 0.0)
}

fn reference_or_pass_step(id: u32) -> Step {
    let (kind, label, path, sampling) = match id {
        0 => {
            let sampling = Sampling::Dwell { dwell_s: 0.01, samples: SAMPLES_PER_POINT };
            (StepKind::Reference, "reference".to_owned(), DWELL_POINT_OFFSETS_MM.to_vec(), sampling)
        }
        id => {
            let path = vec![-PASS_HALF_LENGTH_MM, PASS_HALF_LENGTH_MM, -PASS_HALF_LENGTH_MM];
            let sampling = Sampling::Continuous { rate_hz: 1.0 / SAMPLE_PERIOD_S, per_revolution: None };
            (StepKind::Scan, format!("pass/{id}"), path, sampling)
        }
    };
    let path: Vec<Position> = path.into_iter().map(scan_position_at_x_offset).collect();
    Step {
        id,
        stage: 0,
        kind,
        label,
        from: path[0].clone(),
        to: path[path.len() - 1].clone(),
        feed_mm_min: FEED_MM_MIN,
        sensors: vec!["laser".to_owned()],
        normal: [0.0, 0.0, 1.0],
        scan: Some(Scan { path, sampling }),
        text: None,
        mount: None,
        watch: Vec::new(),
    }
}

struct ScanPassesMethod;

impl Method for ScanPassesMethod {
    fn settings(&self) -> serde_json::Value {
        serde_json::json!({})
    }

    fn next_stage(&self, _: &Plan, done: &[Stage], _: ObjectPositionSource<'_>) -> Result<NextStage, MethodRefusal> {
        if !done.is_empty() {
            return Ok(NextStage::NoFurtherStage);
        }
        let (steps, new_steps) = ((0..STEP_COUNT).collect(), (0..STEP_COUNT).map(reference_or_pass_step).collect());
        let stage = Stage { id: 0, name: "passes".to_owned(), repeat: 0, steps, found: None };
        Ok(NextStage::Stage { stage, new_steps })
    }

    fn identify(&self, _: &Plan, _: &[Reading]) -> Result<Estimate, IdentifyError> {
        Err(IdentifyError::IdentificationFailed("nobody asks for it".to_owned()))
    }
}

/// A machine with a scripted control and sensor on the scene's clock, and its journal.
struct ScanShop {
    folder: tempfile::TempDir,
    file: MachineFile,
    scene: SharedScene,
}

impl ScanShop {
    fn new() -> Self {
        let text = include_str!("../../../config/laser.toml").to_owned();
        let mut file = MachineFile::parse("laser.toml", text).unwrap();
        let scene = scripted_scene::new_shared_scene(scan_position_at_x_offset(0.0).with(Axis::Z, 400.0));
        file.sensors[0].connection = SensorConnection::Real(std::sync::Arc::new(SceneSensor(scene.clone())));
        Self { folder: tempfile::tempdir().unwrap(), file, scene }
    }

    async fn open_devices_with_event(&self, plot: StepSampleEvent) -> (Devices, HaltHandle) {
        let mut devices =
            setup::open_devices(&self.file, SimulationPace::Immediate, EarlierSessions::default()).await.unwrap();
        devices.open_controller = scripted_scene::spawn_scene_controller(&self.scene, plot);
        devices.clock = std::sync::Arc::new(SceneClock(self.scene.clone()));
        let halt = devices.open_controller.halt_handle();
        (devices, halt)
    }

    fn plan_without_steps(&self) -> Plan {
        let mut plan = setup::plan_without_steps(&self.file, "laser-r-test", serde_json::json!({}));
        plan.sensors = self.file.sensors.iter().map(|entry| entry.sensor.clone()).collect();
        plan
    }

    /// Runs the method with the event `plot`.
    async fn run_with_event(&self, plot: StepSampleEvent) -> (Result<(), RunError>, StoredRun, HaltHandle) {
        let (devices, halt) = self.open_devices_with_event(plot).await;
        let journal = Journal::open(self.folder.path()).unwrap();
        let plan = self.plan_without_steps();
        let new = NewRun { machine_file_text: self.file.text().to_owned(), plan: plan.clone() };
        let id = journal.begin_run(&new).await.unwrap();
        let mut tell = |_: &Told| {};
        let mut run = Run::new(id, &ScanPassesMethod, &devices, &journal, plan, &mut tell);
        let ended = run.execute().await;
        (ended, journal.load_run(id).unwrap(), halt)
    }

    /// Resumes the run without further events.
    async fn resume(&self, stored: StoredRun) -> StoredRun {
        let id: RunId = stored.summary.id;
        let (devices, _) = self.open_devices_with_event(None).await;
        let journal = Journal::open(self.folder.path()).unwrap();
        let mut tell = |_: &Told| {};
        let mut run = Run::new(id, &ScanPassesMethod, &devices, &journal, stored.plan, &mut tell);
        let (stages, readings) = (stored.stages, stored.readings);
        let answered = Vec::new();
        run.resume(InterruptedRun {
            started_stages: stages,
            readings,
            answered_prompt_steps_and_repeats: answered,
            time_since_last_reading_s: 60.0,
        })
        .await
        .unwrap();
        journal.load_run(id).unwrap()
    }

    /// Asserts that each reading was sent by the sensor, at the X position of the reading.
    fn assert_readings_were_reported(&self, readings: &[Reading], label: &str) {
        let said = &self.scene.lock().unwrap().reported_values_mm;
        let mut said = said.iter();
        for reading in readings.iter() {
            let value = reading.value_mm.unwrap_or_else(|| panic!("{label}: no value"));
            let off = reading.position.get_or_zero(Axis::X) - SCAN_MIDDLE_X_MM - value;
            assert!(off.abs() < 1e-9, "{label}: {reading:?}");
            assert!(said.any(|one| *one == value), "{label}: nobody said {reading:?}");
        }
    }
}

fn block_on<T>(work: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(work)
}

/// Number of samples of each step, in the order of the readings.
fn sample_count_per_step(readings: &[Reading]) -> Vec<(u32, usize)> {
    let same = |one: &Reading, other: &Reading| (one.step, one.repeat) == (other.step, other.repeat);
    readings.chunk_by(same).map(|step| (step[0].step, step.len())).collect()
}

/// Expected counts of these steps, each complete.
fn expected_sample_count_per_step(steps: impl IntoIterator<Item = u32>) -> Vec<(u32, usize)> {
    let rests = DWELL_POINT_OFFSETS_MM.len() * SAMPLES_PER_POINT as usize;
    steps.into_iter().map(|step| (step, if step == 0 { rests } else { 2 * SAMPLES_PER_PASS })).collect()
}

/// Whether the machine must be held during the pass, or is at the end of the scan anyway.
#[derive(Clone, Copy, PartialEq)]
enum ExpectedEnd {
    HeldInPass,
    AfterScan,
}

async fn check_scripted_event_and_resume(
    (step_and_sample, event, expected_end): ((u32, usize), ScriptedEvent, ExpectedEnd),
    words: &[&str],
) {
    let label = format!("{event:?}");
    let shop = ScanShop::new();
    let (ended, stored, halt) = shop.run_with_event(Some((step_and_sample.0, step_and_sample.1, event))).await;
    let error = ended.expect_err(&label);
    let said = format!("{error}\n  -> {}", error.remedy());
    println!("{label}: {said}");
    for words in words {
        assert!(said.contains(words), "{label}: no {words} in {said}");
    }
    {
        let scene = shop.scene.lock().unwrap();
        // The machine has not moved, and no step after this scan has begun.
        if expected_end == ExpectedEnd::HeldInPass {
            assert_eq!(Some(&scene.position), scene.position_at_event.as_ref(), "{label}: it moved on");
        }
        assert_eq!(scene.started_steps.last(), Some(&step_and_sample.0), "{label}: something followed");
    }
    // A control that is gone has stopped by itself.
    let holds = expected_end == ExpectedEnd::HeldInPass && event != ScriptedEvent::ControlLinkLost;
    assert_eq!(halt.is_halt_requested(), holds, "{label}");
    assert_eq!(stored.summary.state, RunState::Held, "{label}");
    assert_eq!(
        sample_count_per_step(&stored.readings),
        expected_sample_count_per_step(0..step_and_sample.0),
        "{label}"
    );
    shop.assert_readings_were_reported(&stored.readings, &label);
    let told = |(_, event): &(_, Told)| match event {
        Told::Held { .. } => error.is_requested_stop(),
        Told::Faulted { what, remedy, .. } => (what, remedy) == (&error.to_string(), &error.remedy()),
        _ => false,
    };
    assert!(stored.events.iter().any(told), "{label}: the journal does not say so");

    let stored = shop.resume(stored).await;
    assert_eq!(stored.summary.state, RunState::NotIdentified, "{label}");
    // The repeatability of its means is not declared: the reference is measured twice to determine it.
    let steps = (0..step_and_sample.0).chain([0, 0]).chain(step_and_sample.0..STEP_COUNT);
    assert_eq!(sample_count_per_step(&stored.readings), expected_sample_count_per_step(steps), "{label}");
    shop.assert_readings_were_reported(&stored.readings, &label);
}

pub fn failure_in_a_pass_stops_the_run_and_keeps_complete_steps() {
    use ExpectedEnd::{AfterScan, HeldInPass};
    type FailureCase = ((u32, usize), ScriptedEvent, ExpectedEnd);
    let on_step = "pass/2, step 2";
    let resume = "`trued resume` measures the step again";
    let cases: [(FailureCase, &[&str]); 12] = [
        (
            (STEP_AND_SAMPLE_MID_FORWARD_PASS, ScriptedEvent::FlagAllSamples(ReadingFlag::Stale), HeldInPass),
            &[on_step, "(stale)", "sends no more data: check its cable"],
        ),
        (
            (STEP_AND_SAMPLE_MID_RETURN_PASS, ScriptedEvent::FlagAllSamples(ReadingFlag::Range), HeldInPass),
            &[on_step, "(range)", "check that the artefact is at its position"],
        ),
        (
            (STEP_AND_SAMPLE_MID_RETURN_PASS, ScriptedEvent::FlagAllSamples(ReadingFlag::Saturated), HeldInPass),
            &[on_step, "(saturated)", "reduce its exposure"],
        ),
        (
            (STEP_AND_SAMPLE_MID_FORWARD_PASS, ScriptedEvent::SensorLinkLost, HeldInPass),
            &["`laser`", "is lost", "the sensor's power and cable"],
        ),
        (
            (STEP_AND_SAMPLE_MID_RETURN_PASS, ScriptedEvent::ControlLinkLost, HeldInPass),
            &["the link to the control is lost"],
        ),
        (
            (STEP_AND_SAMPLE_MID_FORWARD_PASS, ScriptedEvent::OperatorHold, HeldInPass),
            &["the run was halted on request", "start a new run when the machine is clear"],
        ),
        (
            (STEP_AND_SAMPLE_MID_FORWARD_PASS, ScriptedEvent::NoTrack, AfterScan),
            &["does not report time-stamped axis positions", "[controller.sampler]"],
        ),
        (
            (STEP_AND_SAMPLE_MID_RETURN_PASS, ScriptedEvent::TrackEndsEarly, AfterScan),
            &[on_step, "2 of the 3 points", resume],
        ),
        (
            (STEP_AND_SAMPLE_MID_FORWARD_PASS, ScriptedEvent::TrackBeginsLate, AfterScan),
            &[on_step, "1 of the 3 points", resume],
        ),
        (
            (STEP_AND_SAMPLE_MID_RETURN_PASS, ScriptedEvent::StampsJump, AfterScan),
            &[on_step, "2 of the 3 points", resume],
        ),
        (
            (STEP_AND_SAMPLE_AT_FIRST_SCAN_START, ScriptedEvent::OtherClock, AfterScan),
            &["pass/1, step 1", "no sample of laser lies within the times for which the control reported", resume],
        ),
        (
            (STEP_AND_SAMPLE_AT_FIRST_SCAN_START, ScriptedEvent::OnDemandSensor, AfterScan),
            &["pass/1, step 1", "laser sent no samples during the motion", resume],
        ),
    ];
    std::thread::scope(|scope| {
        for (case, words) in &cases {
            scope.spawn(move || block_on(check_scripted_event_and_resume(*case, words)));
        }
    });
}

/// Samples lost by the sensor, and stamps lost by the control: the remaining samples are kept, flagged and
/// reported.
pub fn samples_lost_in_a_pass_are_left_out_and_not_replaced() {
    let measured = |at: (u32, usize), event| {
        let shop = ScanShop::new();
        let (ended, stored, _) = block_on(shop.run_with_event(Some((at.0, at.1, event))));
        ended.unwrap();
        shop.assert_readings_were_reported(&stored.readings, &format!("{event:?}"));
        let of_step = stored.readings.iter().filter(|reading| reading.step == at.0);
        let scan: Vec<Reading> = of_step.cloned().collect();
        let told = stored.events.into_iter().filter_map(|(_, event)| match event {
            Told::OperatorMessage { text } => Some(text),
            _ => None,
        });
        (scan, told.collect::<Vec<String>>().join("\n"))
    };
    let longest = |scan: &[Reading]| scan.windows(2).map(|pair| pair[1].t_s - pair[0].t_s).fold(0.0, f64::max);
    let gaps = |scan: &[Reading]| scan.iter().filter(|reading| reading.flag == ReadingFlag::Gap).count();

    let (scan, _) = measured(STEP_AND_SAMPLE_MID_FORWARD_PASS, ScriptedEvent::LostSamples(30));
    assert_eq!((scan.len(), gaps(&scan)), (2 * SAMPLES_PER_PASS - 30, 1));
    assert!((longest(&scan) - 31.0 * SAMPLE_PERIOD_S).abs() < 1e-9, "{}", longest(&scan));

    // Only the counter has jumped.
    let (scan, _) = measured(STEP_AND_SAMPLE_MID_FORWARD_PASS, ScriptedEvent::CounterSkips(60_000));
    assert_eq!((scan.len(), gaps(&scan)), (2 * SAMPLES_PER_PASS, 1));

    let (scan, told) = measured(STEP_AND_SAMPLE_MID_RETURN_PASS, ScriptedEvent::TrackGap);
    assert_eq!(scan.len(), 2 * SAMPLES_PER_PASS - 50, "{told}");
    assert!(
        told.contains(
            "pass/2: 50 of 1600 samples of laser are not used: the positions of the control have \
            1 gaps"
        ),
        "{told}"
    );
    assert!((longest(&scan) - 51.0 * SAMPLE_PERIOD_S).abs() < 1e-9, "{}", longest(&scan));
}

/// The surface is within the sensor's range from Z 245 down, but out of range down to Z 234 by the machine file.
pub fn unexpected_distance_in_the_approach_holds_the_machine() {
    let shop = ScanShop::new();
    let lower = ScriptedEvent::SensorLowerByMm(15.0);
    let (ended, stored, halt) = block_on(shop.run_with_event(Some((0, 0, lower))));
    let error = ended.unwrap_err();
    let said = format!("{error}\n  -> {}", error.remedy());
    for words in ["`laser` reports ", "no body of the machine file", "retract by hand"] {
        assert!(said.contains(words), "no {words} in {said}");
    }
    let z = shop.scene.lock().unwrap().position.get_or_zero(Axis::Z);
    assert!((SENSOR_RANGE_UPPER_Z_MM + 14.8..SENSOR_RANGE_UPPER_Z_MM + 15.0).contains(&z), "held at Z {z}");
    assert!(halt.is_halt_requested() && stored.readings.is_empty());
}
