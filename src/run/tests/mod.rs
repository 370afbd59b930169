//! Runs on the simulated control; the calls to its driver are counted.

mod asking;
mod time_left;

use std::sync::{Arc, Mutex};

use super::*;
use crate::setup::{self, EarlierSessions, MachineFile, SimulationPace};
use crate::store::{NewRun, StoredRun};
use devices::controllers::{
    Controller, ControllerDriver, ControllerError, DeviceInfo, HaltHandle, MachineSnapshot, PreparedControl,
};
use machine::record::motion::BlockOutcome;
use planning::proof::ProvenBlock;

type CallLog = Arc<Mutex<Vec<&'static str>>>;

/// Counts the calls to the inner control.
struct CountingController {
    inner: Controller,
    calls: CallLog,
}

impl CountingController {
    fn count(&self, call: &'static str) -> &Controller {
        self.calls.lock().unwrap().push(call);
        &self.inner
    }
}

impl ControllerDriver for CountingController {
    async fn prepare(&mut self) -> Result<PreparedControl, ControllerError> {
        self.count("prepare").prepare().await
    }

    async fn execute(&mut self, block: ProvenBlock) -> Result<BlockOutcome, ControllerError> {
        self.count("execute").execute(block).await
    }

    async fn read_snapshot(&mut self) -> Result<MachineSnapshot, ControllerError> {
        self.count("look").read_snapshot().await
    }

    async fn identify_device(&mut self) -> Result<DeviceInfo, ControllerError> {
        self.count("introduce").identify_device().await
    }

    async fn finish(&mut self) -> Result<(), ControllerError> {
        self.count("finish").finish().await
    }
}

struct RunWorkspace {
    folder: tempfile::TempDir,
    journal: Journal,
    file: MachineFile,
    calls: CallLog,
}

impl RunWorkspace {
    /// `more`: text added to the machine file.
    fn new(more: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let text = crate::setup::built_in_file("self-calibration").text;
        let text = format!("{text}\n[method.self-calibration]\npositions = 5\nrepeats = 2\n{more}");
        let file = MachineFile::parse("shop.toml", text).unwrap();
        let journal = Journal::open(folder.path()).unwrap();
        Self { folder, journal, file, calls: CallLog::default() }
    }

    fn method(&self) -> (Box<dyn Method>, Plan) {
        setup::configure_method_and_plan(&self.file, "self-calibration", None).unwrap()
    }

    async fn devices(&self, past: EarlierSessions<'_>) -> (Devices, HaltHandle) {
        let mut devices = setup::open_devices(&self.file, SimulationPace::Fast, past).await.unwrap();
        let halt = devices.controller.halt_handle();
        let (halt_too, calls) = (halt.clone(), self.calls.clone());
        let counted = |inner| Controller::spawn(CountingController { inner, calls }, halt_too);
        let inner = std::mem::replace(&mut devices.controller, unreachable_controller());
        devices.controller = counted(inner);
        (devices, halt)
    }

    /// Runs until the end. `answers` and `tell` get the halt handle.
    async fn run_method(
        &self,
        method: &dyn Method,
        answers: impl FnOnce(HaltHandle) -> PromptAnswerSource,
        tell: impl Fn(&Event, &HaltHandle),
    ) -> (Result<(), RunError>, StoredRun) {
        let (_, plan) = self.method();
        let new = NewRun { config: self.file.text().to_owned(), plan: plan.clone() };
        let id = self.journal.begin_run(&new).await.unwrap();
        let (devices, halt) = self.devices(EarlierSessions::default()).await;
        let mut tell = |event: &Event| tell(event, &halt);
        let run = Run::new(id, method, &devices, &self.journal, plan, &mut tell);
        let ended = run.with_answers(answers(halt.clone())).execute().await;
        (ended, self.journal.load_run(id).unwrap())
    }

    /// Resumes the run with an operator's acknowledgement, as in another process.
    async fn resume(
        &self,
        method: &dyn Method,
        stored: StoredRun,
        tell: impl Fn(&Event, &HaltHandle),
    ) -> (Result<(), RunError>, StoredRun) {
        let id = stored.summary.id;
        let past = EarlierSessions { readings: &stored.readings, elapsed_s: 60.0, ..EarlierSessions::default() };
        let (devices, halt) = self.devices(past).await;
        let mut tell = |event: &Event| tell(event, &halt);
        let answered_prompts = super::prompts::answered_prompts(&stored.events);
        let (stages, readings) = (stored.stages.clone(), stored.readings.clone());
        let run = Run::new(id, method, &devices, &self.journal, stored.plan.clone(), &mut tell);
        let before = InterruptedRun { stages, readings, answered_prompts, elapsed_s: 60.0 };
        let ended = run.with_answers(answers_by_operator()).resume(before).await;
        (ended, self.journal.load_run(id).unwrap())
    }

    fn calls(&self) -> Vec<&'static str> {
        self.calls.lock().unwrap().clone()
    }
}

/// Placeholder for a control while it is replaced.
fn unreachable_controller() -> Controller {
    struct NoMethod;
    impl ControllerDriver for NoMethod {
        async fn prepare(&mut self) -> Result<PreparedControl, ControllerError> {
            Err(ControllerError::DriverTaskEnded)
        }
        async fn execute(&mut self, _: ProvenBlock) -> Result<BlockOutcome, ControllerError> {
            Err(ControllerError::DriverTaskEnded)
        }
        async fn read_snapshot(&mut self) -> Result<MachineSnapshot, ControllerError> {
            Err(ControllerError::DriverTaskEnded)
        }
        async fn identify_device(&mut self) -> Result<DeviceInfo, ControllerError> {
            Err(ControllerError::DriverTaskEnded)
        }
        async fn finish(&mut self) -> Result<(), ControllerError> {
            Err(ControllerError::DriverTaskEnded)
        }
    }
    Controller::spawn(NoMethod, HaltHandle::new(|| {}))
}

fn answers_by_operator() -> PromptAnswerSource {
    PromptAnswerSource::new(|_| Some("Ada".to_owned()))
}
