//! One machine, its control behind a grbl wire, and measurements with it.

use std::collections::BTreeSet;

use machine::record::artefact::Artefact;
use machine::record::estimate::{Estimate, Parameter};
use machine::record::event::RunEvent;
use machine::record::plan::{Plan, Stage};
use machine::record::reading::{Reading, ReadingFlag};
use methods::{IdentifyError, Method, MethodRefusal, NextStage, ObjectPositionSource};
use planning::{BlockStart, SafeHeights, position_after_motions, touch_block};
use toml::{Table, Value};
use trued::run::{Run, RunError};
use trued::setup::{self, EarlierSessions, MachineFile, SimulationPace};
use trued::store::{Journal, NewRun};

use crate::support::proven_block::proven_block_without_collision_check;

/// The built-in machine of the method, changed.
#[derive(Clone)]
pub struct SambaWorld(Table);

impl SambaWorld {
    pub fn as_built_in() -> Self {
        Self(include_str!("../../../config/samba.toml").parse().unwrap())
    }

    /// A world with only those errors that the model and the declared noise of a touch explain.
    pub fn with_modelled_errors_only() -> Self {
        let mut world = Self::as_built_in();
        for axis in ["X", "Y", "Z", "B", "C"] {
            world = world.with_key(&format!("axes.{axis}.error_motion_um"), 0.0);
        }
        world
            .with_key("machine.drift_um_per_h", 0.0)
            .with_key("probe.lobing_um", 0.0)
            .with_key("simulated.ball_form_um", 0.0)
            .with_key("method.samba.monte_carlo_trials", 100)
    }

    /// Sets the value at `path`, keys joined by dots; missing tables are created.
    pub fn with_key(mut self, path: &str, value: impl Into<Value>) -> Self {
        let (tables, key) = path.rsplit_once('.').unwrap();
        self.toml_table(tables).insert(key.to_owned(), value.into());
        self
    }

    pub fn without_key(mut self, key: &str) -> Self {
        self.0.remove(key);
        self
    }

    /// Sets a key of the scale bar.
    pub fn with_bar(mut self, key: &str, value: f64) -> Self {
        let lengths = self.toml_table("artefact")["lengths"].as_array_mut().unwrap();
        lengths[0].as_table_mut().unwrap().insert(key.to_owned(), value.into());
        self
    }

    /// Adds an entry to `[[simulated.NAME]]`.
    pub fn with_simulated_entry(mut self, name: &str, entry: &str) -> Self {
        let list = self.toml_table("simulated").entry(name).or_insert_with(|| Value::Array(Vec::new()));
        list.as_array_mut().unwrap().push(Value::Table(entry.parse().unwrap()));
        self
    }

    pub fn toml_table(&mut self, path: &str) -> &mut Table {
        path.split('.').fold(&mut self.0, |table, key| {
            let inner = table.entry(key).or_insert_with(|| Value::Table(Table::new()));
            inner.as_table_mut().unwrap()
        })
    }

    pub fn machine_file(&self, seed: u64) -> MachineFile {
        let seeded = self.clone().with_key("simulated.seed", seed as i64);
        MachineFile::parse("world.toml", toml::to_string(&seeded.0).unwrap()).unwrap()
    }
}

pub struct MeasuredRun {
    pub plan: Plan,
    pub readings: Vec<Reading>,
    pub estimate: Estimate,
    true_errors: Table,
    /// Drift of the table in the middle of the measurement.
    table_drift_mm: [f64; 3],
    pub true_stylus_mm: [f64; 3],
}

impl MeasuredRun {
    pub fn identify(
        file: &MachineFile,
        method: &dyn Method,
        plan: Plan,
        readings: Vec<Reading>,
    ) -> Result<Self, RunFailed> {
        let estimate =
            method.identify(&plan, &readings).map_err(|error| RunFailed(format!("{error}; {}", error.remedy())))?;
        let text: Table = file.text().parse().unwrap();
        let errors = text["simulated"]["errors"].as_table().unwrap().clone();
        let world = setup::build_world(file).unwrap();
        let crept = world.true_table_drift_mm(mean_touch_time_s(&plan, &readings));
        let stylus_mm = world.true_stylus_centre_mm();
        Ok(Self { plan, readings, estimate, true_errors: errors, table_drift_mm: crept, true_stylus_mm: stylus_mm })
    }

    pub fn parameter(&self, symbol: &str) -> &Parameter {
        let found = self.estimate.parameters.iter().find(|parameter| parameter.symbol == symbol);
        found.unwrap_or_else(|| panic!("no {symbol}"))
    }

    /// Estimate minus true value in the middle of the measurement, in the unit of both; `key` as in
    /// `[simulated.errors]`. A drift of the table in one direction appears as a spindle offset in the other.
    pub fn parameter_error(&self, symbol: &str, key: &str) -> f64 {
        let [x, y, _] = self.table_drift_mm;
        let since = match symbol {
            "EX0S" => -1e3 * x,
            "EY0S" => -1e3 * y,
            _ => 0.0,
        };
        self.parameter(symbol).value - self.true_errors[key].as_float().unwrap() - since
    }

    /// Estimate minus true stylus, mm.
    pub fn stylus_error_mm(&self) -> [f64; 3] {
        let value = |k: usize| self.parameter(["tool_x", "tool_y", "tool_z"][k]).value;
        let since = |k: usize| if k == 2 { -self.table_drift_mm[2] } else { 0.0 };
        std::array::from_fn(|k| value(k) - self.true_stylus_mm[k] - since(k))
    }
}

/// Mean time of the touches that the estimate uses.
fn mean_touch_time_s(plan: &Plan, readings: &[Reading]) -> f64 {
    let fast: BTreeSet<u32> = plan.steps.iter().filter(|s| s.label.starts_with("find/")).map(|s| s.id).collect();
    let slow = readings.iter().filter(|reading| !fast.contains(&reading.step));
    let times: Vec<f64> = slow.map(|reading| reading.t_s).collect();
    times.iter().sum::<f64>() / times.len() as f64
}

/// The reason of a run that failed, as text.
pub struct RunFailed(pub String);

pub struct SambaRunner {
    journal: Journal,
    _folder: tempfile::TempDir,
}

impl SambaRunner {
    pub fn new() -> Self {
        let memory = std::path::Path::new("/dev/shm");
        let folder = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() };
        let folder = folder.unwrap();
        Self { journal: Journal::open(folder.path()).unwrap(), _folder: folder }
    }

    pub fn measure(&self, seed: u64, world: &SambaWorld) -> MeasuredRun {
        self.try_measure(seed, world).unwrap_or_else(|RunFailed(why)| panic!("seed {seed}: {why}"))
    }

    pub fn try_measure(&self, seed: u64, world: &SambaWorld) -> Result<MeasuredRun, RunFailed> {
        let file = world.machine_file(seed);
        let (method, header) = setup::configure_method_and_plan_without_steps(&file, "samba", None)
            .map_err(|e| RunFailed(e.to_string()))?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let (plan, readings) = runtime.block_on(self.run_method(&file, method.as_ref(), header))?;
        MeasuredRun::identify(&file, method.as_ref(), plan, readings)
    }

    /// Measures the first stages only.
    pub fn run_first_stages(&self, seed: u64, world: &SambaWorld, stages: usize) -> Result<Vec<Reading>, RunFailed> {
        let file = world.machine_file(seed);
        let (method, header) = setup::configure_method_and_plan_without_steps(&file, "samba", None)
            .map_err(|e| RunFailed(e.to_string()))?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let method = FirstStages { method, stage_count: stages };
        Ok(runtime.block_on(self.run_method(&file, &method, header))?.1)
    }

    async fn run_method(
        &self,
        file: &MachineFile,
        method: &dyn Method,
        plan: Plan,
    ) -> Result<(Plan, Vec<Reading>), RunFailed> {
        let devices = setup::open_devices(file, SimulationPace::Immediate, EarlierSessions::default()).await.unwrap();
        let new = NewRun { machine_file_text: file.text().to_owned(), plan: plan.clone() };
        let id = self.journal.begin_run(&new).await.unwrap();
        let mut tell = |_: &RunEvent| {};
        let mut run = Run::new(id, method, &devices, &self.journal, plan, &mut tell);
        let ended = run.execute().await;
        let Run { plan, readings, .. } = run;
        let why = |error: RunError| RunFailed(format!("{error}; {}", error.remedy()));
        ended.map(|()| (plan, readings)).map_err(why)
    }
}

/// A method that ends after this number of stages.
struct FirstStages {
    method: Box<dyn Method>,
    stage_count: usize,
}

impl Method for FirstStages {
    fn settings(&self) -> serde_json::Value {
        self.method.settings()
    }

    fn next_stage(
        &self,
        plan: &Plan,
        done: &[Stage],
        source: ObjectPositionSource<'_>,
    ) -> Result<NextStage, MethodRefusal> {
        if done.len() < self.stage_count {
            self.method.next_stage(plan, done, source)
        } else {
            Ok(NextStage::NoFurtherStage)
        }
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        self.method.identify(plan, readings)
    }
}

/// One method for many worlds that differ in their truth only: its design is made once.
pub struct RunSeries {
    world: SambaWorld,
    method: Box<dyn Method>,
    header: Plan,
}

impl RunSeries {
    pub fn new(world: SambaWorld) -> Self {
        let (method, header) =
            setup::configure_method_and_plan_without_steps(&world.machine_file(0), "samba", None).unwrap();
        Self { world, method, header }
    }

    /// The series with a plan that does not declare the drift of the world.
    pub fn without_declared_drift(mut self) -> Self {
        self.header.machine.drift_um_per_h = 0.0;
        self
    }

    /// Measures as a run does, over the same wire, without proof and journal.
    pub fn measure(&self, seed: u64) -> Result<MeasuredRun, RunFailed> {
        let file = self.world.machine_file(seed);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let touched = play_all_touches(&file, self.method.as_ref(), self.header.clone());
        let (plan, readings) = runtime.block_on(touched)?;
        MeasuredRun::identify(&file, self.method.as_ref(), plan, readings)
    }
}

async fn play_all_touches(
    file: &MachineFile,
    method: &dyn Method,
    mut plan: Plan,
) -> Result<(Plan, Vec<Reading>), RunFailed> {
    let devices = setup::open_devices(file, SimulationPace::Immediate, EarlierSessions::default()).await.unwrap();
    let mut stands = devices.open_controller.prepare().await.unwrap().position;
    let (mut done, mut readings) = (Vec::<Stage>::new(), Vec::new());
    loop {
        let next = method.next_stage(&plan, &done, ObjectPositionSource::Measured(&readings));
        let next = next.map_err(|refused| RunFailed(format!("{refused}; {}", refused.remedy)))?;
        let NextStage::Stage { stage, new_steps } = next else { return Ok((plan, readings)) };
        plan.steps.extend(new_steps);
        let clearance = match &stage.found {
            Some(balls @ Artefact::Balls(_)) => SafeHeights::above_artefact(&plan, balls).unwrap(),
            _ => SafeHeights::above_plan_artefact(&plan).unwrap(),
        };
        for step in plan.steps.iter().filter(|step| stage.steps.contains(&step.id)) {
            let start = BlockStart { position: Some(&stands), touched_directions: planning::TouchedDirections::all() };
            let block = touch_block(&plan, step, stage.repeat, start, &clearance).unwrap();
            stands = position_after_motions(&block.motions, &stands);
            let block = proven_block_without_collision_check(file, &devices, &block);
            let outcome = devices.open_controller.execute(block).await;
            let outcome = outcome.map_err(|error| RunFailed(error.to_string()))?;
            readings.push(Reading {
                step: step.id,
                repeat: stage.repeat,
                position: outcome.trigger_position.unwrap(),
                value_mm: None,
                sensor: step.first_sensor().to_owned(),
                t_s: outcome.trigger_time_s.unwrap_or(0.0),
                flag: ReadingFlag::None,
                temperatures_c: Default::default(),
            });
        }
        done.push(stage);
    }
}

/// `matrix`⁻¹·`right`.
pub fn solve_linear(matrix: &faer::Mat<f64>, right: &faer::Col<f64>) -> faer::Col<f64> {
    use faer::linalg::solvers::Solve;
    matrix.partial_piv_lu().solve(right)
}
