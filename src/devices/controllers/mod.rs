//! Interface to machine controls. A driver executes neutral blocks, one touch at a time. Its task owns the
//! link, and none of its futures is dropped before it completes: callers send messages.
//!
//! A stop holds the machine, which stays where it is. Nothing here is an emergency stop.

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
mod port_scan;
mod readiness;
mod stamp;

pub use error::ControllerError;
pub use introduction::{DeviceInfo, Diagnosis, Leave, ReadinessFinding, ReportedAxis};
pub use readiness::{ReadinessItem, describe_not_readable};

/// Configuration of a control, from `[controller]`. Each kind of control defines the keys of its own table.
pub trait Named: fmt::Debug + Send + Sync {
    /// The G-code dialect of the control, a folder of `gcode-templates/`.
    fn dialect(&self) -> &str;
    /// Name of the result file, if the control writes the results itself.
    fn log(&self) -> Option<String> {
        None
    }
    /// Address of the control, in words.
    fn at(&self) -> String;
    /// Opens the control's links and starts its task. Timestamps have the time of `clock`, unless the
    /// control has a clock of its own. Nothing is commanded yet. Call inside a tokio runtime.
    fn open<'a>(
        &'a self,
        machine: &'a Machine,
        modes: ProvenModes,
        clock: Arc<dyn Clock>,
    ) -> Opening<'a>;
    /// Possible causes why the control could not be opened or prepared, which has failed with `failed`; the
    /// most likely first, none if nothing is found. It opens its own links: earlier links must be closed.
    /// Nothing moves. Call inside a tokio runtime.
    fn diagnose<'a>(
        &'a self,
        machine: &'a Machine,
        failed: &'a ControllerError,
        leave: Leave,
    ) -> Diagnosing<'a>;
}

pub type Opening<'a> =
    Pin<Box<dyn Future<Output = Result<Controller, ControllerError>> + Send + 'a>>;

pub type Diagnosing<'a> = Pin<Box<dyn Future<Output = Vec<Diagnosis>> + Send + 'a>>;

/// Properties of a control that is ready to move.
#[derive(Debug, Clone, PartialEq)]
pub struct Prepared {
    /// Name and version as reported, for the record.
    pub identity: String,
    /// How this control stops on a halt, and its worst-case travel, in words.
    pub stop: String,
    /// Position of the machine, machine coordinates: every axis that the control reports.
    pub stands: Position,
    pub transmission: Transmission,
    /// Items of the readiness list that the driver cannot read on this control.
    pub not_readable: Vec<ReadinessItem>,
}

/// State of a machine at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Look {
    pub probe_closed: bool,
    /// Position of the machine, as in [`Prepared`].
    pub stands: Position,
}

/// Interface that each control implements. One call at a time; each call runs to its end.
pub trait Driver: Send + 'static {
    /// Performs the handshake, refuses a control that cannot measure, sets all modal state. Called again
    /// after an operator was at the machine.
    fn prepare(&mut self) -> impl Future<Output = Result<Prepared, ControllerError>> + Send;
    /// As [`prepare`](Self::prepare), but a closed probe is accepted: while it reads closed, only a block
    /// that begins with a back-off is executed. A control whose `prepare` does not read the probe uses this
    /// default.
    fn prepare_in_contact(
        &mut self,
    ) -> impl Future<Output = Result<Prepared, ControllerError>> + Send {
        self.prepare()
    }
    /// Executes one block; returns when the machine is at rest and the result is known. Refuses the block
    /// if the machine is not where the block begins, or if the block is not the one that was proven.
    fn execute(
        &mut self,
        block: ProvenBlock,
    ) -> impl Future<Output = Result<Outcome, ControllerError>> + Send;
    /// Reads the present state. Nothing moves.
    fn look(&mut self) -> impl Future<Output = Result<Look, ControllerError>> + Send;
    /// Reads the control's properties, prepared or not. Nothing moves and nothing is set.
    fn introduce(&mut self) -> impl Future<Output = Result<DeviceInfo, ControllerError>> + Send;
    /// Whether the outcome of a block with a feed motion has the track of that motion.
    fn stamps(&self) -> bool {
        false
    }
    /// Restores the modal state that `prepare` has found.
    fn finish(&mut self) -> impl Future<Output = Result<(), ControllerError>> + Send;
}

/// Holds the machine at its position, whatever else is pending. Cloneable; works from any thread.
#[derive(Clone)]
pub struct Halt {
    halted: Arc<AtomicBool>,
    act: Arc<dyn Fn() + Send + Sync>,
}

impl Halt {
    /// `act` sends the hold at once and must not block.
    pub fn new(act: impl Fn() + Send + Sync + 'static) -> Self {
        Self { halted: Arc::new(AtomicBool::new(false)), act: Arc::new(act) }
    }

    pub fn now(&self) {
        self.halted.store(true, Ordering::SeqCst);
        (self.act)();
    }

    /// Whether a halt was requested. Drivers check this before every line that could move the machine.
    pub fn is_halted(&self) -> bool {
        self.halted.load(Ordering::SeqCst)
    }
}

enum Request {
    Prepare(oneshot::Sender<Result<Prepared, ControllerError>>),
    PrepareInContact(oneshot::Sender<Result<Prepared, ControllerError>>),
    Execute(ProvenBlock, oneshot::Sender<Result<Outcome, ControllerError>>),
    Look(oneshot::Sender<Result<Look, ControllerError>>),
    Introduce(oneshot::Sender<Result<DeviceInfo, ControllerError>>),
    Finish(oneshot::Sender<Result<(), ControllerError>>),
}

/// Handle that the run holds: sends messages to the driver's task.
pub struct Controller {
    requests: mpsc::Sender<Request>,
    halt: Halt,
    stamps: bool,
}

impl Controller {
    /// Starts the task that owns `driver`. Call inside a tokio runtime.
    pub fn spawn(driver: impl Driver, halt: Halt) -> Self {
        let (requests, inbox) = mpsc::channel(1);
        let stamps = driver.stamps();
        tokio::spawn(serve(driver, inbox, halt.clone()));
        Self { requests, halt, stamps }
    }

    /// Whether the control stamps the positions of the axes during motion: see [`Outcome::track`].
    pub fn stamps(&self) -> bool {
        self.stamps
    }

    pub fn halt(&self) -> Halt {
        self.halt.clone()
    }

    pub async fn prepare(&self) -> Result<Prepared, ControllerError> {
        self.ask(Request::Prepare).await
    }

    /// Prepares for a retract: see [`Driver::prepare_in_contact`].
    pub async fn prepare_in_contact(&self) -> Result<Prepared, ControllerError> {
        self.ask(Request::PrepareInContact).await
    }

    pub async fn execute(&self, block: ProvenBlock) -> Result<Outcome, ControllerError> {
        self.ask(|answer| Request::Execute(block, answer)).await
    }

    pub async fn look(&self) -> Result<Look, ControllerError> {
        self.ask(Request::Look).await
    }

    pub async fn introduce(&self) -> Result<DeviceInfo, ControllerError> {
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

/// Task of the driver: handles requests one after the other until the handle is dropped. If the caller no
/// longer waits for an answer, the answer is dropped; the request was still executed to its end.
async fn serve(mut driver: impl Driver, mut inbox: mpsc::Receiver<Request>, halt: Halt) {
    // A control that was held meanwhile is not ready: that is not its own fault. A lost position is
    // reported all the same.
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
