//! The seam to machine controls. A driver executes neutral blocks, a touch at a time; its
//! task owns the link, and no future of it is ever dropped half-way: callers send messages.
//!
//! Stop = hold and stay. Nothing here is an emergency stop.

use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::sync::{mpsc, oneshot};

use link::Clock;
use machine::Position;
use machine::record::machine::Machine;
use machine::record::motion::Outcome;
use planning::gcode::Transmission;
use planning::proof::{ProvenBlock, ProvenModes};

mod arrival;
mod error;
pub mod grbl;
mod introduction;
mod lines;
pub mod linuxcnc;
pub mod modbus;
mod port;
mod readiness;
mod stamp;
mod stranger;

pub use error::ControllerError;
pub use introduction::{AxisSays, Introduction, Leave, Remark, Suspicion};
pub use readiness::{ReadinessItem, describe_not_readable};

/// A control as `[controller]` names it. What stands in that table is its room's own matter.
pub trait Named: fmt::Debug + Send + Sync {
    /// The language it is spoken to, a folder of `gcode-templates/`.
    fn dialect(&self) -> &str;
    /// The file that takes the results, where the control writes them itself.
    fn log(&self) -> Option<String> {
        None
    }
    /// Where it is reached, in words.
    fn at(&self) -> String;
    /// Open its links and start its task. What it stamps has the time of `clock`, unless it has a clock
    /// of its own. Nothing is commanded yet. Call inside a tokio runtime.
    fn open<'a>(
        &'a self,
        machine: &'a Machine,
        modes: ProvenModes,
        clock: Arc<dyn Clock>,
    ) -> Opening<'a>;
    /// Why it could not be opened or prepared, which `failed` has told; the most likely first, and
    /// none where nothing is found. It opens links of its own: whoever held them has let go. Nothing
    /// moves. Call inside a tokio runtime.
    fn diagnose<'a>(
        &'a self,
        machine: &'a Machine,
        failed: &'a ControllerError,
        leave: Leave,
    ) -> Diagnosing<'a>;
}

pub type Opening<'a> =
    Pin<Box<dyn Future<Output = Result<Controller, ControllerError>> + Send + 'a>>;

pub type Diagnosing<'a> = Pin<Box<dyn Future<Output = Vec<Suspicion>> + Send + 'a>>;

/// What a control says of itself once it is ready to move.
#[derive(Debug, Clone, PartialEq)]
pub struct Prepared {
    /// Name and version as reported, for the record.
    pub identity: String,
    /// How this control stops on a halt, and its worst-case travel, in words.
    pub stop: String,
    /// Where the machine stands, machine coordinates: every axis that the control reports.
    pub stands: Position,
    pub transmission: Transmission,
    /// Items of the readiness list that the driver cannot read on this control.
    pub not_readable: Vec<ReadinessItem>,
}

/// What is to be seen of a machine that stands.
#[derive(Debug, Clone, PartialEq)]
pub struct Look {
    pub probe_closed: bool,
    /// As in [`Prepared`].
    pub stands: Position,
}

/// What each control implements. One call at a time, each runs to its end.
pub trait Driver: Send + 'static {
    /// Shake hands, refuse what cannot measure, set all modal state. Called again after a person was at the
    /// machine.
    fn prepare(&mut self) -> impl Future<Output = Result<Prepared, ControllerError>> + Send;
    /// As [`prepare`](Self::prepare), but a closed probe is accepted: while it reads closed, only a block
    /// that begins with a back-off is executed. A control whose `prepare` does not read the probe needs
    /// nothing else.
    fn prepare_in_contact(
        &mut self,
    ) -> impl Future<Output = Result<Prepared, ControllerError>> + Send {
        self.prepare()
    }
    /// Execute one block; return when the machine stands still and the result is known. Refused if the
    /// machine is not where the block begins, or the block is not the one that was proven.
    fn execute(
        &mut self,
        block: ProvenBlock,
    ) -> impl Future<Output = Result<Outcome, ControllerError>> + Send;
    /// How things stand now. Nothing moves.
    fn look(&mut self) -> impl Future<Output = Result<Look, ControllerError>> + Send;
    /// What it says of itself, prepared or not. Nothing moves and nothing is set.
    fn introduce(&mut self) -> impl Future<Output = Result<Introduction, ControllerError>> + Send;
    /// Whether the outcome of a block that moves at feed has its track.
    fn stamps(&self) -> bool {
        false
    }
    /// Restore the modal state found.
    fn finish(&mut self) -> impl Future<Output = Result<(), ControllerError>> + Send;
}

/// Holds the machine where it stands, whatever else waits. Cloneable; works from any thread.
#[derive(Clone)]
pub struct Halt {
    halted: Arc<AtomicBool>,
    act: Arc<dyn Fn() + Send + Sync>,
}

impl Halt {
    /// `act` puts the hold on the wire at once and must not block.
    pub fn new(act: impl Fn() + Send + Sync + 'static) -> Self {
        Self { halted: Arc::new(AtomicBool::new(false)), act: Arc::new(act) }
    }

    pub fn now(&self) {
        self.halted.store(true, Ordering::SeqCst);
        (self.act)();
    }

    /// Drivers ask this before every line that could move the machine.
    pub fn is_halted(&self) -> bool {
        self.halted.load(Ordering::SeqCst)
    }
}

enum Request {
    Prepare(oneshot::Sender<Result<Prepared, ControllerError>>),
    PrepareInContact(oneshot::Sender<Result<Prepared, ControllerError>>),
    Execute(ProvenBlock, oneshot::Sender<Result<Outcome, ControllerError>>),
    Look(oneshot::Sender<Result<Look, ControllerError>>),
    Introduce(oneshot::Sender<Result<Introduction, ControllerError>>),
    Finish(oneshot::Sender<Result<(), ControllerError>>),
}

/// The handle that the run holds: messages to the driver's task.
pub struct Controller {
    requests: mpsc::Sender<Request>,
    halt: Halt,
    stamps: bool,
}

impl Controller {
    /// Start the task that owns `driver`. Call inside a tokio runtime.
    pub fn spawn(driver: impl Driver, halt: Halt) -> Self {
        let (requests, inbox) = mpsc::channel(1);
        let stamps = driver.stamps();
        tokio::spawn(serve(driver, inbox, halt.clone()));
        Self { requests, halt, stamps }
    }

    /// Whether it stamps where the axes stand while they move: see [`Outcome::track`].
    pub fn stamps(&self) -> bool {
        self.stamps
    }

    pub fn halt(&self) -> Halt {
        self.halt.clone()
    }

    pub async fn prepare(&self) -> Result<Prepared, ControllerError> {
        self.ask(Request::Prepare).await
    }

    /// For a retract: see [`Driver::prepare_in_contact`].
    pub async fn prepare_in_contact(&self) -> Result<Prepared, ControllerError> {
        self.ask(Request::PrepareInContact).await
    }

    pub async fn execute(&self, block: ProvenBlock) -> Result<Outcome, ControllerError> {
        self.ask(|answer| Request::Execute(block, answer)).await
    }

    pub async fn look(&self) -> Result<Look, ControllerError> {
        self.ask(Request::Look).await
    }

    pub async fn introduce(&self) -> Result<Introduction, ControllerError> {
        self.ask(Request::Introduce).await
    }

    pub async fn finish(&self) -> Result<(), ControllerError> {
        self.ask(Request::Finish).await
    }

    async fn ask<T>(
        &self,
        request: impl FnOnce(oneshot::Sender<Result<T, ControllerError>>) -> Request,
    ) -> Result<T, ControllerError> {
        let (answer, result) = oneshot::channel();
        self.requests.send(request(answer)).await.map_err(|_| ControllerError::DriverGone)?;
        result.await.map_err(|_| ControllerError::DriverGone)?
    }
}

/// The driver's task: requests one after the other until the handle is dropped. An answer nobody
/// waits for any more is dropped; the work it stands for was still done to its end.
async fn serve(mut driver: impl Driver, mut inbox: mpsc::Receiver<Request>, halt: Halt) {
    // A control that was held meanwhile is not ready: that is no fault of its own. One that has lost its
    // position has lost it all the same.
    let held = |error: ControllerError| match halt.is_halted() && !error.position_lost() {
        true => ControllerError::Halted,
        false => error,
    };
    while let Some(request) = inbox.recv().await {
        match request {
            Request::Prepare(answer) => drop(answer.send(driver.prepare().await.map_err(held))),
            Request::PrepareInContact(answer) => {
                drop(answer.send(driver.prepare_in_contact().await.map_err(held)));
            }
            Request::Execute(block, answer) => drop(answer.send(driver.execute(block).await)),
            Request::Look(answer) => drop(answer.send(driver.look().await)),
            Request::Introduce(answer) => drop(answer.send(driver.introduce().await)),
            Request::Finish(answer) => drop(answer.send(driver.finish().await)),
        }
    }
}
