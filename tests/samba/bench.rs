//! One machine, its control behind a grbl wire, and what is measured with it.

use toml::{Table, Value};
use trued::record::estimate::{Estimate, Parameter};
use trued::record::event::Event;
use trued::record::plan::Plan;
use trued::record::reading::Reading;
use trued::run::{Run, RunError};
use trued::setup::{self, MachineFile, Pace, Past};
use trued::store::{Journal, NewRun};

/// The built-in machine of the method, changed.
#[derive(Clone)]
pub struct World(Table);

impl World {
    pub fn as_built_in() -> Self {
        Self(include_str!("../../config/samba.toml").parse().unwrap())
    }

    /// Nothing but what the model and the declared noise of a touch explain.
    pub fn inside_the_model() -> Self {
        let mut world = Self::as_built_in();
        for axis in ["X", "Y", "Z"] {
            world = world.with(&format!("axes.{axis}.error_motion_um"), 0.0);
        }
        world.table("simulated").remove("error_motion");
        world
            .with("machine.drift_um_per_h", 0.0)
            .with("probe.lobing_um", 0.0)
            .with("simulated.ball_form_um", 0.0)
            .with("method.samba.monte_carlo_trials", 100)
    }

    /// `path`: keys with dots between; tables that are missing are made.
    pub fn with(mut self, path: &str, value: impl Into<Value>) -> Self {
        let (tables, key) = path.rsplit_once('.').unwrap();
        self.table(tables).insert(key.to_owned(), value.into());
        self
    }

    /// One more entry of `[[simulated.NAME]]`.
    pub fn and(mut self, name: &str, entry: &str) -> Self {
        let list = self.table("simulated").entry(name).or_insert_with(|| Value::Array(Vec::new()));
        list.as_array_mut().unwrap().push(Value::Table(entry.parse().unwrap()));
        self
    }

    pub fn table(&mut self, path: &str) -> &mut Table {
        path.split('.').fold(&mut self.0, |table, key| {
            let inner = table.entry(key).or_insert_with(|| Value::Table(Table::new()));
            inner.as_table_mut().unwrap()
        })
    }

    pub fn file(&self, seed: u64) -> MachineFile {
        let seeded = self.clone().with("simulated.seed", seed as i64);
        MachineFile::parse("world.toml", toml::to_string(&seeded.0).unwrap()).unwrap()
    }
}

pub struct Measured {
    pub plan: Plan,
    pub readings: Vec<Reading>,
    pub estimate: Estimate,
    errors: Table,
}

impl Measured {
    pub fn parameter(&self, symbol: &str) -> &Parameter {
        let found = self.estimate.parameters.iter().find(|parameter| parameter.symbol == symbol);
        found.unwrap_or_else(|| panic!("no {symbol}"))
    }

    /// Estimate less truth, in the unit of both; `key` as in `[simulated.errors]`.
    pub fn error(&self, symbol: &str, key: &str) -> f64 {
        self.parameter(symbol).value - self.errors[key].as_float().unwrap()
    }
}

/// A run that did not come to its end, in words.
pub struct Failed(pub String);

pub struct Bench {
    journal: Journal,
    _folder: tempfile::TempDir,
}

impl Bench {
    pub fn new() -> Self {
        let memory = std::path::Path::new("/dev/shm");
        let folder =
            if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() };
        let folder = folder.unwrap();
        Self { journal: Journal::open(folder.path()).unwrap(), _folder: folder }
    }

    pub fn measure(&self, seed: u64, world: &World) -> Measured {
        self.try_measure(seed, world).unwrap_or_else(|Failed(why)| panic!("seed {seed}: {why}"))
    }

    pub fn try_measure(&self, seed: u64, world: &World) -> Result<Measured, Failed> {
        let file = world.file(seed);
        let (method, header) =
            setup::header(&file, "samba", None).map_err(|e| Failed(e.to_string()))?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let (plan, readings) = runtime.block_on(self.run(&file, method.as_ref(), header))?;
        let estimate = method
            .identify(&plan, &readings, &[])
            .map_err(|error| Failed(format!("{error}; {}", error.remedy())))?;
        let simulated = world.0["simulated"].as_table().unwrap();
        let errors = simulated["errors"].as_table().unwrap().clone();
        Ok(Measured { plan, readings, estimate, errors })
    }

    async fn run(
        &self,
        file: &MachineFile,
        method: &dyn trued::methods::Method,
        plan: Plan,
    ) -> Result<(Plan, Vec<Reading>), Failed> {
        let devices = setup::devices(file, Pace::Fast, Past::default()).await.unwrap();
        let new = NewRun { config: file.text().to_owned(), plan: plan.clone() };
        let id = self.journal.begin(&new).await.unwrap();
        let mut tell = |_: &Event| {};
        let mut run = Run::new(id, method, &devices, &self.journal, plan, &mut tell);
        let ended = run.execute().await;
        let Run { plan, readings, .. } = run;
        let why = |error: RunError| Failed(format!("{error}; {}", error.remedy()));
        ended.map(|()| (plan, readings)).map_err(why)
    }
}

/// `matrix`⁻¹·`right`.
pub fn solve(matrix: &faer::Mat<f64>, right: &faer::Col<f64>) -> faer::Col<f64> {
    use faer::linalg::solvers::Solve;
    matrix.partial_piv_lu().solve(right)
}
