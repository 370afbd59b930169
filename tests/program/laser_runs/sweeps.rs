//! Events during a scan in motion: the machine is held where it is, the error gives the remedy, no part of the scan
//! is kept, everything before it is, and an operator resumes the run.

use devices::controllers::HaltHandle;
use machine::record::estimate::Estimate;
use machine::record::event::Event as Told;
use machine::record::plan::{Plan, Sampling, Scan, Stage, Step, StepKind};
use machine::record::reading::{Reading, ReadingFlag};
use machine::{Axis, Position};
use methods::{IdentifyError, Method, MethodRefusal, NextStage, PositionSource};
use trued::run::{InterruptedRun, Run, RunError};
use trued::setup::machine_file::SensorConnection;
use trued::setup::{self, Devices, EarlierSessions, MachineFile, SimulationPace};
use trued::store::{Journal, NewRun, RunId, RunState, StoredRun};

use super::played::{
    self, EventSchedule, RANGE_ENDS_Z_MM, SAMPLE_PERIOD_S, SCAN_MIDDLE_MM, SCAN_Z_MM, SceneClock, SceneSensor,
    ScriptedEvent, SharedScene,
};

/// Number of steps: a reference at rest (0), and two scans there and back.
const STEP_COUNT: u32 = 3;
const DWELL_POINTS_MM: [f64; 3] = [-2.0, 0.0, 2.0];
const SAMPLES_PER_POINT: u32 = 5;
const PASS_HALF_LENGTH_MM: f64 = 4.0;
const FEED_MM_MIN: f64 = 600.0;
/// Samples in one direction of a scan, one per period.
const SAMPLES_PER_PASS: usize = (2.0 * PASS_HALF_LENGTH_MM / (FEED_MM_MIN / 60.0) / SAMPLE_PERIOD_S) as usize;
/// In the middle of the forward pass, and of the return pass, of the second scan.
const MIDDLE_OF_PASS: (u32, usize) = (2, SAMPLES_PER_PASS / 2);
/// An event from the beginning affects the first scan.
const START_OF_PASS: (u32, usize) = (1, 1);
const MIDDLE_OF_RETURN: (u32, usize) = (2, SAMPLES_PER_PASS + SAMPLES_PER_PASS / 2);

fn position_over_scan(by: f64) -> Position {
    let at = Position::new().with(Axis::X, SCAN_MIDDLE_MM + by).with(Axis::Y, 0.0);
    at.with(Axis::Z, SCAN_Z_MM).with(Axis::B, 0.0).with(Axis::C, 0.0)
}

fn pass_step(id: u32) -> Step {
    let (kind, label, path, sampling) = match id {
        0 => {
            let sampling = Sampling::Dwell { dwell_s: 0.01, samples: SAMPLES_PER_POINT };
            (StepKind::Reference, "reference".to_owned(), DWELL_POINTS_MM.to_vec(), sampling)
        }
        id => {
            let path = vec![-PASS_HALF_LENGTH_MM, PASS_HALF_LENGTH_MM, -PASS_HALF_LENGTH_MM];
            let sampling = Sampling::Continuous { rate_hz: 1.0 / SAMPLE_PERIOD_S, per_revolution: None };
            (StepKind::Scan, format!("pass/{id}"), path, sampling)
        }
    };
    let path: Vec<Position> = path.into_iter().map(position_over_scan).collect();
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

struct PassesMethod;

impl Method for PassesMethod {
    fn settings(&self) -> serde_json::Value {
        serde_json::json!({})
    }

    fn next_stage(&self, _: &Plan, done: &[Stage], _: PositionSource<'_>) -> Result<NextStage, MethodRefusal> {
        if !done.is_empty() {
            return Ok(NextStage::NoFurtherStage);
        }
        let (steps, new_steps) = ((0..STEP_COUNT).collect(), (0..STEP_COUNT).map(pass_step).collect());
        let stage = Stage { id: 0, name: "passes".to_owned(), repeat: 0, steps, found: None };
        Ok(NextStage::Stage { stage, new_steps })
    }

    fn identify(&self, _: &Plan, _: &[Reading]) -> Result<Estimate, IdentifyError> {
        Err(IdentifyError::IdentificationFailed("nobody asks for it".to_owned()))
    }
}

/// A machine with the control and sensor of [`played`], and its journal.
struct ScanShop {
    folder: tempfile::TempDir,
    file: MachineFile,
    scene: SharedScene,
}

impl ScanShop {
    fn new() -> Self {
        let text = include_str!("../../../config/laser.toml").to_owned();
        let mut file = MachineFile::parse("laser.toml", text).unwrap();
        let scene = played::new_shared_scene(position_over_scan(0.0).with(Axis::Z, 400.0));
        file.sensors[0].connection = SensorConnection::Real(std::sync::Arc::new(SceneSensor(scene.clone())));
        Self { folder: tempfile::tempdir().unwrap(), file, scene }
    }

    async fn devices(&self, plot: EventSchedule) -> (Devices, HaltHandle) {
        let mut devices =
            setup::open_devices(&self.file, SimulationPace::Fast, EarlierSessions::default()).await.unwrap();
        devices.controller = played::scene_controller(&self.scene, plot);
        devices.clock = std::sync::Arc::new(SceneClock(self.scene.clone()));
        let halt = devices.controller.halt_handle();
        (devices, halt)
    }

    fn plan(&self) -> Plan {
        let mut plan = setup::plan_without_steps(&self.file, "laser-r-test", serde_json::json!({}));
        plan.sensors = self.file.sensors.iter().map(|entry| entry.sensor.clone()).collect();
        plan
    }

    /// Runs the method with the event `plot`.
    async fn run_with_events(&self, plot: EventSchedule) -> (Result<(), RunError>, StoredRun, HaltHandle) {
        let (devices, halt) = self.devices(plot).await;
        let journal = Journal::open(self.folder.path()).unwrap();
        let plan = self.plan();
        let new = NewRun { config: self.file.text().to_owned(), plan: plan.clone() };
        let id = journal.begin_run(&new).await.unwrap();
        let mut tell = |_: &Told| {};
        let mut run = Run::new(id, &PassesMethod, &devices, &journal, plan, &mut tell);
        let ended = run.execute().await;
        (ended, journal.load_run(id).unwrap(), halt)
    }

    /// Resumes the run without further events.
    async fn resume(&self, stored: StoredRun) -> StoredRun {
        let id: RunId = stored.summary.id;
        let (devices, _) = self.devices(None).await;
        let journal = Journal::open(self.folder.path()).unwrap();
        let mut tell = |_: &Told| {};
        let mut run = Run::new(id, &PassesMethod, &devices, &journal, stored.plan, &mut tell);
        let (stages, readings) = (stored.stages, stored.readings);
        let answered = Vec::new();
        run.resume(InterruptedRun { stages, readings, answered_prompts: answered, elapsed_s: 60.0 }).await.unwrap();
        journal.load_run(id).unwrap()
    }

    /// Checks that each reading was sent by the sensor, at the X position of the reading.
    fn is_true(&self, readings: &[Reading], label: &str) {
        let said = &self.scene.lock().unwrap().reported_values;
        let mut said = said.iter();
        for reading in readings.iter() {
            let value = reading.value_mm.unwrap_or_else(|| panic!("{label}: no value"));
            let off = reading.position.get_or_zero(Axis::X) - SCAN_MIDDLE_MM - value;
            assert!(off.abs() < 1e-9, "{label}: {reading:?}");
            assert!(said.any(|one| *one == value), "{label}: nobody said {reading:?}");
        }
    }
}

fn block_on<T>(work: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(work)
}

/// Number of samples of each step, in the order of the readings.
fn samples_per_step(readings: &[Reading]) -> Vec<(u32, usize)> {
    let same = |one: &Reading, other: &Reading| (one.step, one.repeat) == (other.step, other.repeat);
    readings.chunk_by(same).map(|step| (step[0].step, step.len())).collect()
}

/// Expected counts of these steps, each complete.
fn complete_steps(steps: impl IntoIterator<Item = u32>) -> Vec<(u32, usize)> {
    let rests = DWELL_POINTS_MM.len() * SAMPLES_PER_POINT as usize;
    steps.into_iter().map(|step| (step, if step == 0 { rests } else { 2 * SAMPLES_PER_PASS })).collect()
}

/// Whether the machine must be held during the pass, or is at the end of the scan anyway.
#[derive(Clone, Copy, PartialEq)]
enum ExpectedEnd {
    Held,
    Over,
}

async fn check_failure_and_resume((at, event, then): ((u32, usize), ScriptedEvent, ExpectedEnd), words: &[&str]) {
    let label = format!("{event:?}");
    let shop = ScanShop::new();
    let (ended, stored, halt) = shop.run_with_events(Some((at.0, at.1, event))).await;
    let error = ended.expect_err(&label);
    let said = format!("{error}\n  -> {}", error.remedy());
    println!("{label}: {said}");
    for words in words {
        assert!(said.contains(words), "{label}: no {words} in {said}");
    }
    {
        let scene = shop.scene.lock().unwrap();
        // The machine has not moved, and no step after this scan has begun.
        if then == ExpectedEnd::Held {
            assert_eq!(Some(&scene.position), scene.position_at_event.as_ref(), "{label}: it moved on");
        }
        assert_eq!(scene.started_steps.last(), Some(&at.0), "{label}: something followed");
    }
    // A control that is gone has stopped by itself.
    let holds = then == ExpectedEnd::Held && event != ScriptedEvent::ControlLinkLost;
    assert_eq!(halt.is_halted(), holds, "{label}");
    assert_eq!(stored.summary.state, RunState::Held, "{label}");
    assert_eq!(samples_per_step(&stored.readings), complete_steps(0..at.0), "{label}");
    shop.is_true(&stored.readings, &label);
    let told = |(_, event): &(_, Told)| match event {
        Told::Held { .. } => error.is_stop(),
        Told::Faulted { what, remedy, .. } => (what, remedy) == (&error.to_string(), &error.remedy()),
        _ => false,
    };
    assert!(stored.events.iter().any(told), "{label}: the journal does not say so");

    let stored = shop.resume(stored).await;
    assert_eq!(stored.summary.state, RunState::NotIdentified, "{label}");
    // The repeatability of its means is not declared: the reference is measured twice to determine it.
    let steps = (0..at.0).chain([0, 0]).chain(at.0..STEP_COUNT);
    assert_eq!(samples_per_step(&stored.readings), complete_steps(steps), "{label}");
    shop.is_true(&stored.readings, &label);
}

pub fn what_fails_in_mid_pass_holds_the_machine_and_keeps_what_is_true() {
    use ExpectedEnd::{Held, Over};
    type FailureCase = ((u32, usize), ScriptedEvent, ExpectedEnd);
    let on_step = "pass/2, step 2";
    let resume = "`trued resume` measures the step again";
    let cases: [(FailureCase, &[&str]); 12] = [
        (
            (MIDDLE_OF_PASS, ScriptedEvent::Flag(ReadingFlag::Stale), Held),
            &[on_step, "(stale)", "sends no more data: check its cable"],
        ),
        (
            (MIDDLE_OF_RETURN, ScriptedEvent::Flag(ReadingFlag::Range), Held),
            &[on_step, "(range)", "check that the artefact is at its position"],
        ),
        (
            (MIDDLE_OF_RETURN, ScriptedEvent::Flag(ReadingFlag::Saturated), Held),
            &[on_step, "(saturated)", "reduce its exposure"],
        ),
        (
            (MIDDLE_OF_PASS, ScriptedEvent::SensorLinkLost, Held),
            &["`laser`", "is lost", "the sensor's power and cable"],
        ),
        ((MIDDLE_OF_RETURN, ScriptedEvent::ControlLinkLost, Held), &["the link to the control is lost"]),
        (
            (MIDDLE_OF_PASS, ScriptedEvent::Hold, Held),
            &["the run was halted on request", "start a new run when the machine is clear"],
        ),
        (
            (MIDDLE_OF_PASS, ScriptedEvent::NoTrack, Over),
            &["does not report time-stamped axis positions", "[controller.sampler]"],
        ),
        ((MIDDLE_OF_RETURN, ScriptedEvent::TrackEnds, Over), &[on_step, "2 of the 3 points", resume]),
        ((MIDDLE_OF_PASS, ScriptedEvent::TrackBegins, Over), &[on_step, "1 of the 3 points", resume]),
        ((MIDDLE_OF_RETURN, ScriptedEvent::StampsJump, Over), &[on_step, "2 of the 3 points", resume]),
        (
            (START_OF_PASS, ScriptedEvent::OtherClock, Over),
            &["pass/1, step 1", "no sample of laser lies within the times for which the control reported", resume],
        ),
        (
            (START_OF_PASS, ScriptedEvent::SilentSensor, Over),
            &["pass/1, step 1", "laser sent no samples during the motion", resume],
        ),
    ];
    std::thread::scope(|scope| {
        for (case, words) in &cases {
            scope.spawn(move || block_on(check_failure_and_resume(*case, words)));
        }
    });
}

/// Samples lost by the sensor, and stamps lost by the control: the remaining samples are kept, flagged and
/// reported.
pub fn what_is_lost_in_mid_pass_is_left_out_and_nothing_put_in_its_place() {
    let measured = |at: (u32, usize), event| {
        let shop = ScanShop::new();
        let (ended, stored, _) = block_on(shop.run_with_events(Some((at.0, at.1, event))));
        ended.unwrap();
        shop.is_true(&stored.readings, &format!("{event:?}"));
        let of_step = stored.readings.iter().filter(|reading| reading.step == at.0);
        let scan: Vec<Reading> = of_step.cloned().collect();
        let told = stored.events.into_iter().filter_map(|(_, event)| match event {
            Told::Announced { text } => Some(text),
            _ => None,
        });
        (scan, told.collect::<Vec<String>>().join("\n"))
    };
    let longest = |scan: &[Reading]| scan.windows(2).map(|pair| pair[1].t_s - pair[0].t_s).fold(0.0, f64::max);
    let gaps = |scan: &[Reading]| scan.iter().filter(|reading| reading.flag == ReadingFlag::Gap).count();

    let (scan, _) = measured(MIDDLE_OF_PASS, ScriptedEvent::LostSamples(30));
    assert_eq!((scan.len(), gaps(&scan)), (2 * SAMPLES_PER_PASS - 30, 1));
    assert!((longest(&scan) - 31.0 * SAMPLE_PERIOD_S).abs() < 1e-9, "{}", longest(&scan));

    // Only the counter has jumped.
    let (scan, _) = measured(MIDDLE_OF_PASS, ScriptedEvent::CounterSkips(60_000));
    assert_eq!((scan.len(), gaps(&scan)), (2 * SAMPLES_PER_PASS, 1));

    let (scan, told) = measured(MIDDLE_OF_RETURN, ScriptedEvent::TrackGap);
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
pub fn early_distance_holds_the_machine_in_the_approach() {
    let shop = ScanShop::new();
    let lower = ScriptedEvent::SensorLower(15.0);
    let (ended, stored, halt) = block_on(shop.run_with_events(Some((0, 0, lower))));
    let error = ended.unwrap_err();
    let said = format!("{error}\n  -> {}", error.remedy());
    for words in ["`laser` reports ", "no body of the machine file", "retract by hand"] {
        assert!(said.contains(words), "no {words} in {said}");
    }
    let z = shop.scene.lock().unwrap().position.get_or_zero(Axis::Z);
    assert!((RANGE_ENDS_Z_MM + 14.8..RANGE_ENDS_Z_MM + 15.0).contains(&z), "held at Z {z}");
    assert!(halt.is_halted() && stored.readings.is_empty());
}
