//! Commands to a machine's worker, and the acknowledgement of a person.

use tokio::sync::oneshot;

use super::machine_state::Refusal;
use crate::store::RunId;

/// Commands to the worker. While one is in progress, no other is accepted.
#[derive(Debug)]
pub enum WorkerCommand {
    StartCycle { cycle: u16 },
    Acknowledge(Acknowledgement),
    ResumeRun { run: RunId, acknowledgement: Acknowledgement },
    ShutDown,
}

/// Acknowledgement that a person has inspected the machine.
#[derive(Debug)]
pub struct Acknowledgement {
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
    pub(super) fn acknowledgement_channel(self) -> (Acknowledgement, AcknowledgementReceiver) {
        let (result_sender, result_receiver) = oneshot::channel();
        let Self { who, why, is_homed: homed } = self;
        (Acknowledgement { who: who.to_owned(), why: why.to_owned(), is_homed: homed, result_sender }, result_receiver)
    }
}

/// Receiver of the result of an accepted acknowledgement.
pub type AcknowledgementReceiver = oneshot::Receiver<Result<(), Refusal>>;

/// Effect of a hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HoldEffect {
    RunHeld,
    /// No motion of this program was in progress.
    NoRunInProgress,
    /// Another process may move the machine; this one cannot hold it.
    OtherProcessCannotBeHeld,
}
