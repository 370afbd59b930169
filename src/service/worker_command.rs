//! Commands to a machine's worker, and a person's report that the machine has been inspected.

use std::fmt;

use tokio::sync::oneshot;

use super::machine_state::Refusal;
use crate::compensation::{CompensationError, MachineCompensation};
use crate::setup::MachineFile;
use crate::store::{Journal, MachineLock, RunId};

/// Commands to the worker. While a command is in progress, no other command is accepted.
#[derive(Debug)]
pub enum WorkerCommand {
    /// Measures a new run of the configured cycle `cycle`.
    StartCycle {
        cycle: u16,
    },
    /// Ends the held or failed state; the held run is not resumed.
    Acknowledge(InspectionReport),
    ResumeRun {
        run: RunId,
        report: InspectionReport,
    },
    /// Read, write or restore values of the control.
    Compensate(CompensationJob),
    /// Ends the worker.
    ShutDown,
}

/// Report of a person who has inspected the machine, with the channel for its result.
#[derive(Debug)]
pub struct InspectionReport {
    pub who: String,
    /// Reason that the person gave; may be empty.
    pub why: String,
    /// Whether all axes are homed; required where the control may have lost its position.
    pub is_homed: bool,
    /// Channel for the result: `Ok` once the acknowledgement is in the journal, before a resumed run moves.
    pub result_sender: oneshot::Sender<Result<(), Refusal>>,
}

/// The person who inspected the machine, the reason, and whether the axes are homed.
#[derive(Debug, Clone, Copy, Default)]
pub struct Inspection<'a> {
    pub who: &'a str,
    pub why: &'a str,
    pub is_homed: bool,
}

impl Inspection<'_> {
    pub(super) fn report_and_result_receiver(self) -> (InspectionReport, InspectionResultReceiver) {
        let (result_sender, result_receiver) = oneshot::channel();
        let Self { who, why, is_homed: homed } = self;
        (InspectionReport { who: who.to_owned(), why: why.to_owned(), is_homed: homed, result_sender }, result_receiver)
    }
}

/// Receiver of the result of an inspection report: `Ok` once the acknowledgement is in the journal. An error of the
/// receiver: the service ends.
pub type InspectionResultReceiver = oneshot::Receiver<Result<(), Refusal>>;

/// Job that reads, writes or restores values of the control for a request.
pub struct CompensationJob(Box<ExecuteCompensation>);

type ExecuteCompensation = dyn FnOnce(&MachineFile, &Journal, &MachineLock) -> SendResult + Send;

/// Sends the result of a job to the request. The next command must be possible before, because it may follow at once.
pub(super) type SendResult = Box<dyn FnOnce() + Send>;

/// Receiver of the result of a [`CompensationJob`].
pub type CompensationResultReceiver<T> = oneshot::Receiver<Result<T, CompensationError>>;

impl CompensationJob {
    /// The job that calls `decide`, and the receiver of its result. `target`: key of `[compensation]`, if there are
    /// several.
    pub(super) fn new<T: Send + 'static>(
        target: Option<String>,
        decide: impl FnOnce(&MachineCompensation<'_>, &MachineLock) -> Result<T, CompensationError> + Send + 'static,
    ) -> (Self, CompensationResultReceiver<T>) {
        let (result_sender, result_receiver) = oneshot::channel();
        let job = move |file: &MachineFile, journal: &Journal, lock: &MachineLock| {
            let opened = MachineCompensation::open(file, journal, target.as_deref());
            let result = opened.and_then(|compensation| decide(&compensation, lock));
            // The receiver may have been dropped.
            let send: SendResult = Box::new(move || drop(result_sender.send(result)));
            send
        };
        (Self(Box::new(job)), result_receiver)
    }

    /// Executes the job; blocks the calling thread.
    pub(super) fn execute(self, file: &MachineFile, journal: &Journal, lock: &MachineLock) -> SendResult {
        (self.0)(file, journal, lock)
    }
}

impl fmt::Debug for CompensationJob {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CompensationJob").finish_non_exhaustive()
    }
}

/// Effect of a hold on the run of this process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HoldEffect {
    /// A run is in progress or about to begin: the hold is sent to the control at once, or when the control is open.
    /// Its effect is not awaited.
    RunHeld,
    /// No motion of this program was in progress.
    NoRunInProgress,
    /// Another process may move the machine, and this process cannot hold the machine.
    OtherProcessCannotBeHeld,
}
