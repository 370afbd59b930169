//! Commands to a machine's worker, and a person's report that the machine has been inspected.

use tokio::sync::oneshot;

use super::machine_state::Refusal;
use crate::store::RunId;

/// Commands to the worker. While one is in progress, no other is accepted.
#[derive(Debug)]
pub enum WorkerCommand {
    StartCycle { cycle: u16 },
    ReportInspection(InspectionReport),
    ResumeRun { run: RunId, report: InspectionReport },
    ShutDown,
}

/// Report of a person who has inspected the machine, with the channel for its result.
#[derive(Debug)]
pub struct InspectionReport {
    pub who: String,
    pub why: String,
    /// Whether all axes are homed; required where the control may have lost its position.
    pub is_homed: bool,
    /// Channel for the result.
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

/// Receiver of the result of an accepted inspection report.
pub type InspectionResultReceiver = oneshot::Receiver<Result<(), Refusal>>;

/// Effect of a hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HoldEffect {
    RunHeld,
    /// No motion of this program was in progress.
    NoRunInProgress,
    /// Another process may move the machine; this one cannot hold it.
    OtherProcessCannotBeHeld,
}
