//! Runs on the simulated control; the calls to its driver are logged.

mod prompt_runs;
mod time_left;

use std::sync::{Arc, Mutex};

use super::*;
use crate::setup::{self, EarlierSessions, MachineFile, SimulationPace};
use crate::store::{NewRun, StoredRun};
use devices::controllers::{
    Controller, ControllerDriver, ControllerError, DeviceInfo, HaltHandle, MachineSnapshot, PreparedControl,
};
use machine::record::motion::MotionBlockOutcome;
use planning::proof::ProvenBlock;

type CallLog = Arc<Mutex<Vec<&'static str>>>;

/// Logs the calls to the inner control.
struct CallLoggingController {
    inner: Controller,
    calls: CallLog,
}

impl CallLoggingController {
    fn log_call(&self, call: &'static str) -> &Controller {
        self.calls.lock().unwrap().push(call);
        &self.inner
    }
}

impl ControllerDriver for CallLoggingController {
    async fn prepare(&mut self) -> Result<PreparedControl, ControllerError> {
        self.log_call("prepare").prepare().await
    }

    async fn execute(&mut self, block: ProvenBlock) -> Result<MotionBlockOutcome, ControllerError> {
        self.log_call("execute").execute(block).await
    }

    async fn read_snapshot(&mut self) -> Result<MachineSnapshot, ControllerError> {
        self.log_call("look").read_snapshot().await
    }

    async fn identify_device(&mut self) -> Result<DeviceInfo, ControllerError> {
        self.log_call("introduce").identify_device().await
    }

    async fn restore_modes(&mut self) -> Result<(), ControllerError> {
        self.log_call("finish").restore_modes().await
    }
}

struct RunWorkspace {
    journal_folder: tempfile::TempDir,
    journal: Journal,
    machine_file: MachineFile,
    calls: CallLog,
}

impl RunWorkspace {
    /// `more`: text added to the machine file.
    fn new(more: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let built_in = MachineFile::built_in_for_method("self-calibration").unwrap();
        let text = format!("{}\n[method.self-calibration]\npositions = 5\nrepeats = 2\n{more}", built_in.text());
        let file = MachineFile::parse("shop.toml", text).unwrap();
        let journal = Journal::open(folder.path()).unwrap();
        Self { journal_folder: folder, journal, machine_file: file, calls: CallLog::default() }
    }

    fn method_and_plan(&self) -> (Box<dyn Method>, Plan) {
        setup::configure_method_and_plan_without_steps(&self.machine_file, "self-calibration", None).unwrap()
    }

    async fn open_call_logging_devices(&self, past: EarlierSessions<'_>) -> (Devices, HaltHandle) {
        let mut devices = setup::open_devices(&self.machine_file, SimulationPace::Immediate, past).await.unwrap();
        let halt = devices.open_controller.halt_handle();
        let (halt_too, calls) = (halt.clone(), self.calls.clone());
        let counted = |inner| Controller::spawn(CallLoggingController { inner, calls }, halt_too);
        let inner = std::mem::replace(&mut devices.open_controller, unreachable_controller());
        devices.open_controller = counted(inner);
        (devices, halt)
    }

    /// Runs until the end. `answers` and `on_event` get the halt handle.
    async fn run_method(
        &self,
        method: &dyn Method,
        answers: impl FnOnce(HaltHandle) -> PromptAnswerSource,
        on_event: impl Fn(&RunEvent, &HaltHandle),
    ) -> (Result<(), RunError>, StoredRun) {
        let (_, plan) = self.method_and_plan();
        let new = NewRun { machine_file_text: self.machine_file.text().to_owned(), plan: plan.clone() };
        let id = self.journal.begin_run(&new).await.unwrap();
        let (devices, halt) = self.open_call_logging_devices(EarlierSessions::default()).await;
        let mut with_halt = |event: &RunEvent| on_event(event, &halt);
        let run = Run::new(id, method, &devices, &self.journal, plan, &mut with_halt);
        let ended = run.with_prompt_answer_source(answers(halt.clone())).execute().await;
        (ended, self.journal.load_run(id).unwrap())
    }

    /// Resumes the run with an operator's acknowledgement, as in another process.
    async fn resume(
        &self,
        method: &dyn Method,
        stored: StoredRun,
        on_event: impl Fn(&RunEvent, &HaltHandle),
    ) -> (Result<(), RunError>, StoredRun) {
        let id = stored.summary.id;
        let past = EarlierSessions {
            readings: &stored.readings,
            time_since_last_reading_s: 60.0,
            ..EarlierSessions::default()
        };
        let (devices, halt) = self.open_call_logging_devices(past).await;
        let mut with_halt = |event: &RunEvent| on_event(event, &halt);
        let answered_prompts = super::prompts::answered_prompt_steps_and_repeats(&stored.events);
        let (stages, readings) = (stored.stages.clone(), stored.readings.clone());
        let run = Run::new(id, method, &devices, &self.journal, stored.plan.clone(), &mut with_halt);
        let before = InterruptedRun {
            started_stages: stages,
            readings,
            answered_prompt_steps_and_repeats: answered_prompts,
            time_since_last_reading_s: 60.0,
        };
        let ended = run.with_prompt_answer_source(answers_by_operator()).resume(before).await;
        (ended, self.journal.load_run(id).unwrap())
    }

    fn calls(&self) -> Vec<&'static str> {
        self.calls.lock().unwrap().clone()
    }
}

/// Placeholder for a control while it is replaced.
fn unreachable_controller() -> Controller {
    struct UnreachableDriver;
    impl ControllerDriver for UnreachableDriver {
        async fn prepare(&mut self) -> Result<PreparedControl, ControllerError> {
            Err(ControllerError::DriverTaskEnded)
        }
        async fn execute(&mut self, _: ProvenBlock) -> Result<MotionBlockOutcome, ControllerError> {
            Err(ControllerError::DriverTaskEnded)
        }
        async fn read_snapshot(&mut self) -> Result<MachineSnapshot, ControllerError> {
            Err(ControllerError::DriverTaskEnded)
        }
        async fn identify_device(&mut self) -> Result<DeviceInfo, ControllerError> {
            Err(ControllerError::DriverTaskEnded)
        }
        async fn restore_modes(&mut self) -> Result<(), ControllerError> {
            Err(ControllerError::DriverTaskEnded)
        }
    }
    Controller::spawn(UnreachableDriver, HaltHandle::new(|| {}))
}

fn answers_by_operator() -> PromptAnswerSource {
    PromptAnswerSource::new(|_| Some("Ada".to_owned()))
}
