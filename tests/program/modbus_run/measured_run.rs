//! A run of the real program on a simulated machine.

use machine::record::estimate::Estimate;
use machine::record::event::RunEvent;
use machine::record::plan::Plan;
use machine::record::reading::Reading;
use methods::Method;
use trued::run::{Run, RunError};
use trued::setup::{self, Devices, EarlierSessions, MachineFile, SimulationPace};
use trued::store::{Journal, NewRun};

pub const SIMULATED_MACHINE: &str = include_str!("../../../config/simulated.toml");
const METHOD: &str = "self-calibration";

pub struct MachineUnderTest {
    file: MachineFile,
}

/// A run that has ended.
pub struct MeasuredRun {
    pub result: Result<(), RunError>,
    method: Box<dyn Method>,
    plan: Plan,
    readings: Vec<Reading>,
}

impl MeasuredRun {
    /// Panics if the run failed.
    pub fn readings_of_successful_run(&self) -> &[Reading] {
        self.result.as_ref().unwrap();
        &self.readings
    }

    /// The readings, whatever the result of the run.
    pub fn readings_of_any_run(&self) -> &[Reading] {
        &self.readings
    }

    pub fn estimate(&self) -> Estimate {
        self.method.identify(&self.plan, &self.readings).unwrap()
    }
}

/// The built-in machine file with the keys `controller` in place of its wire; empty: unchanged.
pub fn machine_with_controller(controller: &str) -> String {
    assert!(SIMULATED_MACHINE.contains("wire = \"memory\"\n"));
    match controller {
        "" => SIMULATED_MACHINE.to_owned(),
        keys => SIMULATED_MACHINE.replace("wire = \"memory\"\n", &format!("{keys}\n")),
    }
}

/// A folder in memory, if there is one: these tests do not test a disk.
pub fn create_state_folder_in_memory() -> tempfile::TempDir {
    let shm = std::path::Path::new("/dev/shm");
    let folder = if shm.is_dir() { tempfile::tempdir_in(shm) } else { tempfile::tempdir() };
    folder.unwrap()
}

impl MachineUnderTest {
    /// The built-in machine behind `controller`, with the whole method and few Monte Carlo trials.
    pub fn with_controller(controller: &str) -> Self {
        Self::from_machine_text(
            machine_with_controller(controller) + "\n[method.self-calibration]\nmonte_carlo_trials = 1000\n",
        )
    }

    pub fn from_machine_text(text: String) -> Self {
        Self { file: MachineFile::parse("machine.toml", text).unwrap() }
    }

    pub fn measure(&self) -> MeasuredRun {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let devices =
                setup::open_devices(&self.file, SimulationPace::Immediate, EarlierSessions::default()).await.unwrap();
            self.measure_with(&devices).await
        })
    }

    pub async fn measure_with(&self, devices: &Devices) -> MeasuredRun {
        let folder = create_state_folder_in_memory();
        let journal = Journal::open(folder.path()).unwrap();
        let (method, header) = setup::configure_method_and_plan_without_steps(&self.file, METHOD, None).unwrap();
        let new = NewRun { machine_file_text: self.file.text().to_owned(), plan: header.clone() };
        let id = journal.begin_run(&new).await.unwrap();
        let mut tell = |_: &RunEvent| {};
        let mut run = Run::new(id, method.as_ref(), devices, &journal, header, &mut tell);
        let result = run.execute().await;
        let Run { plan, readings, .. } = run;
        MeasuredRun { result, method, plan, readings }
    }
}
