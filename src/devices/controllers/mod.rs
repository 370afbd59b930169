//! Interface to machine controls. A driver executes neutral blocks, one touch at a time. Its task owns the
//! link, and none of its futures is dropped before it completes: callers send messages.
//!
//! A halt holds the machine at its position. It is not an emergency stop.

use std::fmt;
use std::future::Future;
use std::path::Path;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::sync::{mpsc, oneshot};

use link::Clock;
use machine::record::machine::Machine;
use machine::record::motion::MotionBlockOutcome;
use machine::record::tool_centre::ToolCentreReading;
use machine::{Axis, Position};
use planning::gcode::TransmissionForm;
use planning::proof::{ProvenBlock, ProvenModeText};

mod arrival;
mod control_clock;
mod device_info;
mod error;
pub mod grbl;
pub mod linuxcnc;
pub mod modbus;
mod motion_lines;
mod port_diagnosis;
mod port_scan;
mod readiness;
mod stall_detector;
mod work_offset;

pub use device_info::{
    ConnectionDiagnosisRequest, DeviceInfo, DiagnosisMode, PossibleCause, ReadinessFinding, ReportedAxisProperties,
};
pub use error::ControllerError;
pub use readiness::{READINESS_ITEMS, ReadinessItem, describe_unreadable_items};
pub use work_offset::{WorkOffset, WorkOffsetSlot};

/// Texts about one kind of control, for messages that name all controls.
pub struct ControlDescription {
    /// Value of `kind` in `[controller]`.
    pub kind: &'static str,
    /// How the control receives a hold, in words.
    pub hold_command_hint: &'static str,
    /// Setting of the control for the direction of an axis, in words; `None` if there is none.
    pub axis_direction_hint: Option<&'static str>,
    /// Setting of the control for the steps per unit of an axis, in words; `None` if there is none.
    pub steps_per_unit_hint: Option<&'static str>,
}

/// Configuration of a control, from `[controller]`. Each kind of control defines the keys of its own table.
pub trait ControllerConfig: fmt::Debug + Send + Sync {
    /// The G-code dialect of the control, a folder of `gcode-templates/`.
    fn dialect(&self) -> &str;
    /// Path of the file into which the control writes the results; `None` if it reports them over the link.
    fn result_log_path(&self) -> Option<String> {
        None
    }
    /// File of the control's configuration, if the machine file names one.
    fn configuration_file(&self) -> Option<&Path> {
        None
    }
    /// Address of the control, in words.
    fn describe_address(&self) -> String;
    /// Opens the control's links and starts its task. Timestamps have the time of `clock`, unless the
    /// control has a clock of its own. Nothing is commanded yet. Call inside a tokio runtime.
    fn open<'a>(&'a self, machine: &'a Machine, modes: ProvenModeText, clock: Arc<dyn Clock>) -> OpenFuture<'a>;
    /// Possible causes why the control could not be opened or prepared; the most likely first, none if nothing
    /// is found. It opens its own links: earlier links must be closed. Nothing moves. Call inside a tokio runtime.
    fn diagnose_connection<'a>(&'a self, request: ConnectionDiagnosisRequest<'a>) -> DiagnosisFuture<'a>;
}

/// Result of `ControllerConfig::open`.
pub type OpenFuture<'a> = Pin<Box<dyn Future<Output = Result<Controller, ControllerError>> + Send + 'a>>;

/// Result of `ControllerConfig::diagnose_connection`.
pub type DiagnosisFuture<'a> = Pin<Box<dyn Future<Output = Vec<PossibleCause>> + Send + 'a>>;

/// Properties of a control that is ready to move.
#[derive(Debug, Clone, PartialEq)]
pub struct PreparedControl {
    /// Name and version as reported, or what is behind the link and its address, for the record.
    pub identity: String,
    /// How this control stops on a halt, and its worst-case travel, in words.
    pub stop_description: String,
    /// Position of the machine, machine coordinates: at least the axes of the machine file without the spindle. Whether
    /// it has further axes or the spindle's orientation depends on the control.
    pub position: Position,
    /// Form in which the driver requires the blocks.
    pub transmission: TransmissionForm,
    /// Items of the readiness list that the driver cannot read on this control.
    pub unreadable_items: Vec<ReadinessItem>,
}

/// State of a machine at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct MachineSnapshot {
    pub is_probe_closed: bool,
    /// Position of the machine, machine coordinates, mm and rad; some drivers add the commanded orientation of the
    /// spindle.
    pub position: Position,
}

/// Interface that each control implements. One call at a time; each call runs to its end.
pub trait ControllerDriver: Send + 'static {
    /// Performs the handshake, refuses a control that cannot measure, sets all modal state. Called again
    /// after an operator was at the machine.
    fn prepare(&mut self) -> impl Future<Output = Result<PreparedControl, ControllerError>> + Send;
    /// As [`prepare`](Self::prepare), but a closed probe is accepted: while it reads closed, only a block
    /// that begins with a back-off is executed. A control whose `prepare` does not read the probe uses this
    /// default.
    fn prepare_in_contact(&mut self) -> impl Future<Output = Result<PreparedControl, ControllerError>> + Send {
        self.prepare()
    }
    /// Executes one block; returns when the machine is at rest and the result is known. Refuses the block
    /// if the machine is not where the block begins, or if the block is not the one that was proven.
    fn execute(
        &mut self,
        block: ProvenBlock,
    ) -> impl Future<Output = Result<MotionBlockOutcome, ControllerError>> + Send;
    /// Reads the present state. Nothing moves.
    fn read_snapshot(&mut self) -> impl Future<Output = Result<MachineSnapshot, ControllerError>> + Send;
    /// Reads the control's properties, prepared or not. Nothing moves and nothing is set.
    fn identify_device(&mut self) -> impl Future<Output = Result<DeviceInfo, ControllerError>> + Send;
    /// Reads the tool centre as the control computes it with tool centre point control switched on. Nothing moves,
    /// and it is off again afterwards. `None`: the machine file does not state how to switch it.
    fn read_tool_centre(&mut self) -> impl Future<Output = Result<Option<ToolCentreReading>, ControllerError>> + Send {
        async { Ok(None) }
    }
    /// Whether the outcome of a block with a feed motion has the track of that motion.
    fn can_record_track(&self) -> bool {
        false
    }
    /// Restores what `prepare` has changed: the modal state, and the probe if `prepare` switched it on.
    fn restore_modes(&mut self) -> impl Future<Output = Result<(), ControllerError>> + Send;
    /// Reads a work offset of a machine at rest, prepared or not. Refuses an active G92 and a rotation. Nothing moves.
    /// Afterwards the control must be prepared before the next block. Default: an error, because the control does not
    /// support the request.
    fn read_work_offset(
        &mut self,
        _slot: WorkOffsetSlot,
    ) -> impl Future<Output = Result<WorkOffset, ControllerError>> + Send {
        async { Err(work_offset::unsupported_error()) }
    }
    /// Sets the zero of a work offset on these axes, machine coordinates, mm, by `G10 L2`, at a machine at rest. It
    /// needs no proof: `G10 L2` moves no axis, and no proven block depends on the slot, which is not that of the
    /// dialect. Afterwards the control must be prepared before the next block. Default: an error, as for reading.
    fn write_work_offset(
        &mut self,
        _slot: WorkOffsetSlot,
        _zero_mm: &[(Axis, f64)],
    ) -> impl Future<Output = Result<(), ControllerError>> + Send {
        async { Err(work_offset::unsupported_error()) }
    }
}

/// Refuses a block after a halt, and while the control is not prepared: before the first preparation, after a fault,
/// after an access to a work offset.
fn require_prepared(is_prepared: bool, is_halt_requested: bool) -> Result<(), ControllerError> {
    match (is_halt_requested, is_prepared) {
        (true, _) => Err(ControllerError::Halted),
        (false, true) => Ok(()),
        (false, false) => {
            Err(ControllerError::not_ready("the control was not prepared after the last fault", "start again"))
        }
    }
}

/// Holds the machine at its position, whatever else is pending. Cloneable; works from any thread.
#[derive(Clone)]
pub struct HaltHandle {
    /// Set by the first halt and never reset.
    is_halt_requested: Arc<AtomicBool>,
    /// Sends the hold at once, without blocking.
    send_hold: Arc<dyn Fn() + Send + Sync>,
}

impl HaltHandle {
    /// `send_hold` sends the hold at once and must not block.
    pub fn new(send_hold: impl Fn() + Send + Sync + 'static) -> Self {
        Self { is_halt_requested: Arc::new(AtomicBool::new(false)), send_hold: Arc::new(send_hold) }
    }

    /// Requests the halt and sends the hold; a repeated call sends the hold again.
    pub fn trigger(&self) {
        self.is_halt_requested.store(true, Ordering::SeqCst);
        (self.send_hold)();
    }

    /// Whether a halt was requested. Drivers check this before every line that could move the machine.
    pub fn is_halt_requested(&self) -> bool {
        self.is_halt_requested.load(Ordering::SeqCst)
    }
}

/// Request to the driver's task, with the channel for its result.
enum DriverRequest {
    Prepare(oneshot::Sender<Result<PreparedControl, ControllerError>>),
    /// As `Prepare`, but a closed probe is accepted: see [`ControllerDriver::prepare_in_contact`].
    PrepareInContact(oneshot::Sender<Result<PreparedControl, ControllerError>>),
    Execute(ProvenBlock, oneshot::Sender<Result<MotionBlockOutcome, ControllerError>>),
    ReadSnapshot(oneshot::Sender<Result<MachineSnapshot, ControllerError>>),
    /// The result is `None` if the machine file does not state how to switch tool centre point control.
    ReadToolCentre(oneshot::Sender<Result<Option<ToolCentreReading>, ControllerError>>),
    IdentifyDevice(oneshot::Sender<Result<DeviceInfo, ControllerError>>),
    RestoreModes(oneshot::Sender<Result<(), ControllerError>>),
    ReadWorkOffset(WorkOffsetSlot, oneshot::Sender<Result<WorkOffset, ControllerError>>),
    /// Zero of the slot on some axes, machine coordinates, mm.
    WriteWorkOffset(WorkOffsetSlot, Vec<(Axis, f64)>, oneshot::Sender<Result<(), ControllerError>>),
}

/// Handle that the run holds: sends messages to the driver's task.
pub struct Controller {
    requests: mpsc::Sender<DriverRequest>,
    halt: HaltHandle,
    /// Whether a block with a feed motion returns the positions of the axes during the block.
    can_record_track: bool,
}

impl Controller {
    /// Starts the task that owns `driver`. Call inside a tokio runtime.
    pub fn spawn(driver: impl ControllerDriver, halt: HaltHandle) -> Self {
        let (requests, inbox) = mpsc::channel(1);
        let can_record_track = driver.can_record_track();
        tokio::spawn(run_driver(driver, inbox, halt.clone()));
        Self { requests, halt, can_record_track }
    }

    /// Whether the control stamps the positions of the axes during motion: see [`MotionBlockOutcome::track`].
    pub fn can_record_track(&self) -> bool {
        self.can_record_track
    }

    pub fn halt_handle(&self) -> HaltHandle {
        self.halt.clone()
    }

    /// Prepares the control: see [`ControllerDriver::prepare`].
    pub async fn prepare(&self) -> Result<PreparedControl, ControllerError> {
        self.send_request(DriverRequest::Prepare).await
    }

    /// Prepares for a retract: see [`ControllerDriver::prepare_in_contact`].
    pub async fn prepare_in_contact(&self) -> Result<PreparedControl, ControllerError> {
        self.send_request(DriverRequest::PrepareInContact).await
    }

    /// Executes one block; returns when the machine is at rest and the result is known.
    pub async fn execute(&self, block: ProvenBlock) -> Result<MotionBlockOutcome, ControllerError> {
        self.send_request(|answer| DriverRequest::Execute(block, answer)).await
    }

    /// Reads position and probe of the machine at rest.
    pub async fn read_snapshot(&self) -> Result<MachineSnapshot, ControllerError> {
        self.send_request(DriverRequest::ReadSnapshot).await
    }

    /// Reads the tool centre as the control computes it; `None`: the machine file does not state how. See
    /// [`ControllerDriver::read_tool_centre`].
    pub async fn read_tool_centre(&self) -> Result<Option<ToolCentreReading>, ControllerError> {
        self.send_request(DriverRequest::ReadToolCentre).await
    }

    /// Reads the properties of the control; nothing moves and nothing is set.
    pub async fn identify_device(&self) -> Result<DeviceInfo, ControllerError> {
        self.send_request(DriverRequest::IdentifyDevice).await
    }

    /// Restores what `prepare` has changed.
    pub async fn restore_modes(&self) -> Result<(), ControllerError> {
        self.send_request(DriverRequest::RestoreModes).await
    }

    /// Reads a work offset; refuses an active G92 and a rotation. Afterwards the control must be prepared before the
    /// next block. See [`ControllerDriver::read_work_offset`].
    pub async fn read_work_offset(&self, slot: WorkOffsetSlot) -> Result<WorkOffset, ControllerError> {
        self.send_request(|answer| DriverRequest::ReadWorkOffset(slot, answer)).await
    }

    /// Sets the zero of a work offset on these axes, machine coordinates, mm. Afterwards the control must be prepared
    /// before the next block. See [`ControllerDriver::write_work_offset`].
    pub async fn write_work_offset(
        &self,
        slot: WorkOffsetSlot,
        zero_mm: Vec<(Axis, f64)>,
    ) -> Result<(), ControllerError> {
        self.send_request(|answer| DriverRequest::WriteWorkOffset(slot, zero_mm, answer)).await
    }

    /// Sends the request and waits for its result; an error if the driver's task has ended.
    async fn send_request<T>(
        &self,
        request: impl FnOnce(oneshot::Sender<Result<T, ControllerError>>) -> DriverRequest,
    ) -> Result<T, ControllerError> {
        let (answer, result) = oneshot::channel();
        self.requests.send(request(answer)).await.map_err(|_| ControllerError::DriverTaskEnded)?;
        result.await.map_err(|_| ControllerError::DriverTaskEnded)?
    }
}

/// Task of the driver: handles requests one after the other until the [`Controller`] is dropped. If the caller no
/// longer waits for an answer, the answer is dropped; the request was still executed to its end. A halt does not end
/// the task.
async fn run_driver(mut driver: impl ControllerDriver, mut inbox: mpsc::Receiver<DriverRequest>, halt: HaltHandle) {
    // After a halt a control reports that it is not ready: the error is `Halted`. A lost position is reported
    // nevertheless.
    let held = |error: ControllerError| {
        if halt.is_halt_requested() && !error.may_have_lost_position() { ControllerError::Halted } else { error }
    };
    while let Some(request) = inbox.recv().await {
        match request {
            DriverRequest::Prepare(answer) => drop(answer.send(driver.prepare().await.map_err(held))),
            DriverRequest::PrepareInContact(answer) => {
                drop(answer.send(driver.prepare_in_contact().await.map_err(held)));
            }
            DriverRequest::Execute(block, answer) => drop(answer.send(driver.execute(block).await)),
            DriverRequest::ReadSnapshot(answer) => drop(answer.send(driver.read_snapshot().await)),
            DriverRequest::ReadToolCentre(answer) => drop(answer.send(driver.read_tool_centre().await)),
            DriverRequest::IdentifyDevice(answer) => drop(answer.send(driver.identify_device().await)),
            DriverRequest::RestoreModes(answer) => drop(answer.send(driver.restore_modes().await)),
            DriverRequest::ReadWorkOffset(slot, answer) => drop(answer.send(driver.read_work_offset(slot).await)),
            DriverRequest::WriteWorkOffset(slot, zero_mm, answer) => {
                drop(answer.send(driver.write_work_offset(slot, &zero_mm).await));
            }
        }
    }
}
