//! Errors of a control, and what the operator should do next.

use std::time::Duration;

use link::LinkError;
use link::modbus::ModbusError;
use planning::gcode::ProbeFault;
use planning::proof::AlteredBlockError;

#[derive(Debug, thiserror::Error)]
pub enum ControllerError {
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error(transparent)]
    Modbus(#[from] ModbusError),
    #[error("no reply to `{line}` within {seconds} s")]
    NoAnswer { line: String, seconds: f64 },
    /// Also a LinuxCNC program that stopped for no other known reason, with the messages of LinuxCNC in `reply`.
    #[error("the control replied `{reply}` to `{line}`: {meaning}")]
    LineRefused { line: String, reply: String, meaning: String },
    #[error("alarm {code}: {meaning}")]
    Alarm { code: u32, meaning: String },
    #[error("the emergency stop was pressed")]
    EmergencyStop,
    #[error("the machine has switched off{}{message}", if message.is_empty() { "" } else { ": " })]
    MachineSwitchedOff { message: String },
    /// A running program is paused, stands still for too long, or has a feed override of 0 %; the driver aborts it.
    #[error("the program is paused at the control: {reason}")]
    ProgramPaused { reason: String },
    #[error("the control has stopped working: the control accepts no command, and its status is out of date")]
    ControlFrozen,
    #[error("step {step}: the target is outside the travel limits of the control: {message}")]
    OutOfTravel { step: u32, message: String },
    #[error("step {step}: the motion task of the control was late, and the control stopped the program: {message}")]
    RealTimeTaskLate { step: u32, message: String },
    #[error("the control is not ready: {state}")]
    NotReady { state: String, remedy: String },
    /// A device replies, but not as this kind of control does.
    #[error("the control is not ready: {state}")]
    UnexpectedDevice { state: String, remedy: String },
    /// The probe is closed before the first motion.
    #[error("the control is not ready: the probe reads closed")]
    ProbeClosed,
    #[error("not possible on this control: {reason}")]
    UnsupportedByControl { reason: String, remedy: String },
    #[error("step {step}: no contact before the end of the probing move")]
    NoContact { step: u32 },
    /// Contact during a positioning or a guarded move.
    #[error("step {step}: unexpected contact during a positioning move")]
    UnexpectedContact { step: u32 },
    #[error("step {step}: the probe reads closed where the stylus must be free")]
    ProbeStillClosed { step: u32 },
    #[error("the control was reset during the run: {banner}")]
    ControlReset { banner: String },
    #[error("unexpected reply `{reply}` from the control: the replies may belong to other lines")]
    UnexpectedReply { reply: String },
    /// Positions of the axis with the largest deviation, in mm or degrees, such as `X12.000`.
    #[error("the machine is at {actual}, not at {expected}")]
    WrongPosition { expected: String, actual: String },
    #[error("step {step}: the control reports one touch with two results, `{first}` and `{second}`")]
    TouchMismatch { step: u32, first: String, second: String },
    /// A hold at the control that the driver did not request; with Grbl also an open door or a tool change.
    #[error("held at the machine: the control reports {state}")]
    HeldAtControl { state: String },
    #[error("invalid time from the control, {name} = {t_s:?} s: {reason}")]
    InvalidTimestamp { name: &'static str, t_s: f64, reason: String },
    #[error("step {step}: no axis positions with time stamps during the motion: {reason}")]
    MissingPositionTrack { step: u32, reason: String, remedy: String },
    #[error("the probe {}", fault.description())]
    ProbeFault { fault: ProbeFault },
    #[error("the run was halted on request")]
    Halted,
    #[error("the machine still moves {seconds} s after the hold, although the hold was repeated")]
    HoldFailed { seconds: f64 },
    #[error("the program for step {step} cannot be generated: {reason}")]
    RenderFailed { step: u32, reason: String },
    #[error(transparent)]
    BlockAltered(#[from] AlteredBlockError),
    #[error("step {step}: the block was checked for another form of transmission than this control uses")]
    WrongTransmission { step: u32 },
    #[error("unreadable reply from the control: `{text}`")]
    UnreadableReply { text: String },
    #[error("internal error: the task of the driver has ended")]
    DriverTaskEnded,
}

impl ControllerError {
    /// Error for a control whose state prevents a measurement; `remedy` is what the operator must do before the next
    /// start.
    pub(crate) fn not_ready(state: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::NotReady { state: state.into(), remedy: remedy.into() }
    }

    /// Error for the reply `reply` by which the control refuses `line`.
    pub(in crate::controllers) fn line_refused(line: &str, reply: impl Into<String>, meaning: &str) -> Self {
        Self::LineRefused { line: line.to_owned(), reply: reply.into(), meaning: meaning.to_owned() }
    }

    pub(in crate::controllers) fn no_answer(line: &str, waited: Duration) -> Self {
        Self::NoAnswer { line: line.to_owned(), seconds: waited.as_secs_f64() }
    }

    /// Whether the control may have lost the position of its axes: in that case the operator must home them before
    /// anything else moves (grblHAL `alarms.h`; LinuxCNC reports itself whether it is homed). After `HoldFailed` the
    /// operator has stopped the machine by its emergency stop.
    pub fn may_have_lost_position(&self) -> bool {
        let is_alarm_with_lost_position = matches!(self, Self::Alarm { code: 1 | 3 | 6..=10 | 17, .. });
        is_alarm_with_lost_position || matches!(self, Self::ControlReset { .. } | Self::HoldFailed { .. })
    }

    /// Whether the machine is at rest after this error on every control: the control reports the fault at a
    /// standstill, or a hold was sent.
    pub(in crate::controllers) fn is_machine_stationary(&self) -> bool {
        matches!(
            self,
            Self::Halted
                | Self::HeldAtControl { .. }
                | Self::Alarm { .. }
                | Self::NoContact { .. }
                | Self::UnexpectedContact { .. }
                | Self::ProbeStillClosed { .. }
                | Self::WrongPosition { .. }
                | Self::NotReady { .. }
                | Self::UnexpectedDevice { .. }
                | Self::InvalidTimestamp { .. }
                | Self::ProbeFault { .. }
                | Self::RenderFailed { .. }
        )
    }

    /// Number of the step that the message names; `None` if it names no step.
    pub fn failed_step(&self) -> Option<u32> {
        match self {
            Self::OutOfTravel { step, .. }
            | ControllerError::RealTimeTaskLate { step, .. }
            | Self::NoContact { step }
            | Self::UnexpectedContact { step }
            | Self::ProbeStillClosed { step }
            | Self::TouchMismatch { step, .. }
            | ControllerError::MissingPositionTrack { step, .. }
            | Self::BlockAltered(AlteredBlockError { step })
            | Self::WrongTransmission { step }
            | Self::RenderFailed { step, .. } => Some(*step),
            _ => None,
        }
    }

    /// What the operator should do next.
    pub fn remedy(&self) -> String {
        let text = match self {
            Self::Link(error) => return error.remedy(),
            Self::Modbus(error) => return error.remedy(),
            Self::NotReady { remedy, .. }
            | Self::UnexpectedDevice { remedy, .. }
            | ControllerError::UnsupportedByControl { remedy, .. }
            | ControllerError::MissingPositionTrack { remedy, .. } => return remedy.clone(),
            Self::NoAnswer { .. }
            | Self::UnexpectedReply { .. }
            | Self::TouchMismatch { .. }
            | Self::WrongPosition { .. } => self.communication_remedy(),
            Self::EmergencyStop
            | ControllerError::MachineSwitchedOff { .. }
            | ControllerError::ProgramPaused { .. }
            | Self::HeldAtControl { .. }
            | Self::Alarm { .. }
            | ControllerError::ControlReset { .. } => self.stop_remedy(),
            ControllerError::LineRefused { .. }
            | ControllerError::ControlFrozen
            | Self::HoldFailed { .. }
            | Self::OutOfTravel { .. }
            | ControllerError::RealTimeTaskLate { .. } => self.rejection_remedy(),
            Self::InvalidTimestamp { .. } => {
                "the touch was discarded. Modbus: compare `type`, `order`, `scale` and address of \
                 latch_time_s and time_s in [controller.registers.status] with the control's program; \
                 if both registers are 0, trued uses the time of its own clock"
            }
            Self::NoContact { .. }
            | Self::UnexpectedContact { .. }
            | Self::ProbeStillClosed { .. }
            | Self::ProbeClosed => self.probe_remedy(),
            Self::ProbeFault { fault } => fault.remedy(),
            Self::Halted => {
                "start a new run when the machine is clear. If the control is still in Hold, do not press Cycle \
                 Start, which would finish the held move: reset the control, and home it if the reset has cleared \
                 the homing"
            }
            Self::RenderFailed { .. }
            | Self::BlockAltered(_)
            | Self::WrongTransmission { .. }
            | Self::UnreadableReply { .. }
            | Self::DriverTaskEnded => BUG_REPORT_REMEDY,
        };
        text.to_owned()
    }

    fn communication_remedy(&self) -> &'static str {
        match self {
            Self::NoAnswer { .. } => {
                "the state of the machine is unknown: inspect the machine, then check cable, power and baud rate"
            }
            Self::UnexpectedReply { .. } | Self::TouchMismatch { .. } => {
                "probably the link loses or alters bytes: check cable, earthing and baud rate; if possible use USB or \
                 a network, which detect transmission errors, instead of a plain serial line"
            }
            Self::WrongPosition { .. } => {
                "inspect the machine and the stylus. Possible causes: bytes altered on the link (USB or a network \
                 are safer than a plain serial line), a contact that was not detected, or another program that \
                 commands the machine"
            }
            _ => BUG_REPORT_REMEDY,
        }
    }

    /// Remedy after an operator or a guard has stopped the machine.
    fn stop_remedy(&self) -> &'static str {
        match self {
            Self::EmergencyStop => {
                "inspect the machine; release the emergency stop, switch the machine on, home it if the control requires it"
            }
            ControllerError::MachineSwitchedOff { .. } => {
                "inspect the machine; switch it on, home it if the control requires it"
            }
            ControllerError::ProgramPaused { .. } => {
                "the program was aborted: release the pause at the control, then start again; nothing continues by itself"
            }
            Self::HeldAtControl { .. } => {
                "the run sends nothing more. Do not resume at the control, which would continue the held move: \
                 reset the control, inspect the machine, then start again"
            }
            // Alarm 2, soft limits: the firmware accepts nothing before a reset.
            Self::Alarm { code: 2, .. } => {
                "a target was beyond the soft limits of the control: min and max of [axes] may be wider than its \
                 travel (grblHAL: $130 and following; `trued check` compares them). Reset the control \
                 (Ctrl-X), home it, start again"
            }
            Self::Alarm { .. } => {
                "inspect the machine, clear the alarm at the control, home the machine if the control requires it, start again"
            }
            ControllerError::ControlReset { .. } => {
                "the position of the machine may be lost: home the machine, then start again"
            }
            _ => BUG_REPORT_REMEDY,
        }
    }

    /// Remedy for a command that the control itself has not executed.
    fn rejection_remedy(&self) -> &'static str {
        match self {
            ControllerError::LineRefused { reply, .. } if reply == "error:8" => {
                "wait until the machine is at rest and the control reports Idle, then start again"
            }
            ControllerError::LineRefused { .. } => {
                "check `dialect` in [controller] and the settings of the control that the message names"
            }
            ControllerError::ControlFrozen => {
                "the machine may still finish its queued moves, and no halt reaches the control: press the \
                 emergency stop, restart the control, home the machine"
            }
            Self::HoldFailed { .. } => {
                "press the emergency stop; check the link and the control: do not measure before the control \
                 executes a hold; home the machine"
            }
            Self::OutOfTravel { .. } => "set [axes] min and max to the limits of the control, or move the part",
            ControllerError::RealTimeTaskLate { .. } => {
                "no reading is lost: start again. If this error occurs again, the computer of the control is too \
                 slow for its servo thread: run latency-test there, use a realtime kernel, close other programs"
            }
            _ => BUG_REPORT_REMEDY,
        }
    }

    fn probe_remedy(&self) -> &'static str {
        match self {
            Self::NoContact { .. } => {
                "check the position and size of the part in the machine file ([artefact] centre_mm, radius_mm), and that the probe is switched on"
            }
            Self::UnexpectedContact { .. } => {
                "the stylus may be in contact: run `trued check`, which retracts it; then check the position of the \
                 part, the fixtures, the sense of rotation of the rotary axes ([axes.C] positive) and their zero \
                 positions"
            }
            Self::ProbeClosed => "free the stylus; check the probe's battery, cable and polarity",
            Self::ProbeStillClosed { .. } => {
                "if the stylus is in contact, run `trued check`, which retracts it; check the probe's battery, \
                 cable and polarity"
            }
            _ => BUG_REPORT_REMEDY,
        }
    }
}

const BUG_REPORT_REMEDY: &str = "please report this with the run's export";
