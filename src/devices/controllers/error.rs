//! Errors of a control, and what the operator should do next.

use link::LinkError;
use link::modbus::ModbusError;
use planning::gcode::ProbeFault;
use planning::proof::Altered;

#[derive(Debug, thiserror::Error)]
pub enum ControllerError {
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error(transparent)]
    Modbus(#[from] ModbusError),
    #[error("no answer to `{line}` within {seconds} s")]
    NoAnswer { line: String, seconds: f64 },
    #[error("the control answered `{reply}` to `{line}`: {meaning}")]
    Refused { line: String, reply: String, meaning: String },
    #[error("alarm {code}: {meaning}")]
    Alarm { code: u32, meaning: String },
    #[error("the emergency stop was pressed")]
    EmergencyStop,
    #[error("the machine has switched off{}{said}", if said.is_empty() { "" } else { ": " })]
    SwitchedOff { said: String },
    #[error("the machine is held at the control: {how}")]
    Paused { how: String },
    #[error("the control has stopped working: it takes no command, and what it shows is old")]
    Frozen,
    #[error("step {step}: the control refuses to leave its travel: {said}")]
    OutOfTravel { step: u32, said: String },
    #[error("step {step}: the control was too late for itself and stopped: {said}")]
    Late { step: u32, said: String },
    #[error("the control is not ready: {state}")]
    NotReady { state: String, remedy: String },
    /// A device answers, but not as this kind of control does.
    #[error("the control is not ready: {state}")]
    UnexpectedDevice { state: String, remedy: String },
    /// The probe is closed before the first motion.
    #[error("the control is not ready: the probe reads closed")]
    ProbeClosed,
    #[error("this control cannot do it: {what}")]
    Unsupported { what: String, remedy: String },
    #[error("step {step}: no contact up to the end of the touch")]
    NoContact { step: u32 },
    #[error("step {step}: the probe touched something during a move that should be free")]
    UnexpectedContact { step: u32 },
    #[error("step {step}: the probe reads closed although the stylus should be free")]
    StillTripped { step: u32 },
    #[error("the control reset itself in mid-job: {banner}")]
    Reset { banner: String },
    #[error(
        "the control said `{heard}` although it was not asked: answers may belong to other lines"
    )]
    OutOfStep { heard: String },
    #[error("the machine stands at {stands}, not at {wanted}")]
    WrongPosition { wanted: String, stands: String },
    #[error("step {step}: the control tells the touch as `{first}` and as `{again}`")]
    ContradictoryTouch { step: u32, first: String, again: String },
    #[error("held at the machine: the control says {state}")]
    HeldThere { state: String },
    #[error("the control reports {name} = {t_s:?} s: {why}")]
    Stamp { name: &'static str, t_s: f64, why: String },
    #[error("step {step}: nobody can say where the axes stood while they moved: {why}")]
    Unstamped { step: u32, why: String, remedy: String },
    #[error("the probe {}", fault.says())]
    Probe { fault: ProbeFault },
    #[error("held on request")]
    Halted,
    #[error("the hold was sent again and again, and after {seconds} s the machine does not stand")]
    NotHeld { seconds: f64 },
    #[error("the program for step {step} cannot be written: {why}")]
    Render { step: u32, why: String },
    #[error(transparent)]
    Altered(#[from] Altered),
    #[error("step {step}: the block was not proven for the way in which this control receives it")]
    Transmission { step: u32 },
    #[error("the control said something that cannot be understood: `{text}`")]
    Garbled { text: String },
    #[error("the driver's task has ended")]
    DriverGone,
}

impl ControllerError {
    /// Whether the control may have lost the position of its axes: then the operator must home them before
    /// anything else moves (grblHAL `alarms.h`; LinuxCNC reports itself whether it is homed). A machine
    /// that did not obey a hold was stopped hard.
    pub fn position_lost(&self) -> bool {
        match self {
            Self::Reset { .. } | Self::NotHeld { .. } => true,
            Self::Alarm { code, .. } => matches!(code, 1 | 3 | 6..=10 | 17),
            _ => false,
        }
    }

    /// The step that the message names.
    pub fn step(&self) -> Option<u32> {
        match self {
            Self::OutOfTravel { step, .. }
            | Self::Late { step, .. }
            | Self::NoContact { step }
            | Self::UnexpectedContact { step }
            | Self::StillTripped { step }
            | Self::ContradictoryTouch { step, .. }
            | Self::Unstamped { step, .. }
            | Self::Altered(Altered { step })
            | Self::Transmission { step }
            | Self::Render { step, .. } => Some(*step),
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
            | Self::Unsupported { remedy, .. }
            | Self::Unstamped { remedy, .. } => {
                return remedy.clone();
            }
            Self::NoAnswer { .. }
            | Self::OutOfStep { .. }
            | Self::ContradictoryTouch { .. }
            | Self::WrongPosition { .. } => self.on_the_wire(),
            Self::EmergencyStop
            | Self::SwitchedOff { .. }
            | Self::Paused { .. }
            | Self::HeldThere { .. }
            | Self::Alarm { .. }
            | Self::Reset { .. } => self.stopped_there(),
            Self::Refused { .. }
            | Self::Frozen
            | Self::NotHeld { .. }
            | Self::OutOfTravel { .. }
            | Self::Late { .. } => self.given_up_there(),
            Self::Stamp { .. } => {
                "the touch is not kept. Modbus: compare `type`, `order`, `scale` and address of \
                 latch_time_s and time_s in [controller.registers.status] with the control's program; \
                 where both are 0, trued takes the time itself"
            }
            Self::NoContact { .. }
            | Self::UnexpectedContact { .. }
            | Self::StillTripped { .. }
            | Self::ProbeClosed => self.at_the_probe(),
            Self::Probe { fault } => fault.remedy(),
            Self::Halted => {
                "nothing moves until a person starts a run again. A control that is still in Hold would end the \
                 held move at Cycle Start: reset it instead, and home it where a reset forgets that"
            }
            Self::Render { .. }
            | Self::Altered(_)
            | Self::Transmission { .. }
            | Self::Garbled { .. }
            | Self::DriverGone => REPORT,
        };
        text.to_owned()
    }

    fn on_the_wire(&self) -> &'static str {
        match self {
            Self::NoAnswer { .. } => {
                "the state of the machine is unknown: look at it, then check cable, power and speed"
            }
            Self::OutOfStep { .. } | Self::ContradictoryTouch { .. } => {
                "the wire loses or alters bytes: check cable, earthing and speed; USB or a network, \
                 which check what they carry, are better than a bare serial line"
            }
            Self::WrongPosition { .. } => {
                "look at the machine and at the stylus: a wire that alters bytes moved it elsewhere (USB \
                 or a network are safer than a bare serial line), a contact was not seen, or somebody \
                 else commands it"
            }
            _ => REPORT,
        }
    }

    /// Remedy after an operator or a guard has stopped the machine.
    fn stopped_there(&self) -> &'static str {
        match self {
            Self::EmergencyStop => {
                "look at the machine; release the stop, switch it on, home it if it asks"
            }
            Self::SwitchedOff { .. } => "look at the machine; switch it on, home it if it asks",
            Self::Paused { .. } => {
                "what was held has been given up: release it at the control; nothing goes on by itself"
            }
            Self::HeldThere { .. } => {
                "nothing more is sent; what the control still holds moves when somebody resumes it \
                 there: reset the control instead, look at the machine, then go on"
            }
            // Alarm 2, soft limits: the firmware accepts nothing before a reset.
            Self::Alarm { code: 2, .. } => {
                "the control was asked beyond its soft limits: min and max of [axes] may be wider than its \
                 travel (grblHAL: $130 and following; `trued check` compares them). Reset the control \
                 (Ctrl-X), home it, start again"
            }
            Self::Alarm { .. } => {
                "look at the machine, clear the alarm there, home it if it asks, start again"
            }
            Self::Reset { .. } => "the machine's position may be lost: home it, then start again",
            _ => REPORT,
        }
    }

    /// Remedy for a command that the control itself has not executed.
    fn given_up_there(&self) -> &'static str {
        match self {
            Self::Refused { reply, .. } if reply == "error:8" => {
                "wait until the machine stands and the control reports Idle, then start again"
            }
            Self::Refused { .. } => {
                "check the dialect and the control's settings named in the message"
            }
            Self::Frozen => {
                "the machine may still end the moves it has, and hears no halt: press its emergency \
                 stop, start the control anew, home it"
            }
            Self::NotHeld { .. } => {
                "press the emergency stop; look at the wire and at the control, which must obey a hold \
                 before anything is measured here; home it"
            }
            Self::OutOfTravel { .. } => {
                "make [axes] min and max as narrow as the control's limits, or move the part"
            }
            Self::Late { .. } => {
                "nothing is lost; if it comes again, the control's computer is not fast enough for its \
                 servo thread: run latency-test there, use a realtime kernel, end other programs"
            }
            _ => REPORT,
        }
    }

    fn at_the_probe(&self) -> &'static str {
        match self {
            Self::NoContact { .. } => {
                "is the part where the machine file says ([artefact] centre_mm, radius_mm), and the probe on?"
            }
            Self::UnexpectedContact { .. } => {
                "the stylus may be in contact: trued check leads it out; then check the part's position and \
                 the fixtures. Is the sense of the rotary axes right ([axes.C] positive), and does each stand \
                 at its zero?"
            }
            Self::ProbeClosed => "free the stylus; check the probe's battery, cable and polarity",
            Self::StillTripped { .. } => {
                "if the stylus is in contact, trued check leads it out; check the probe's battery, cable and \
                 polarity"
            }
            _ => REPORT,
        }
    }
}

const REPORT: &str = "please report this with the run's export";
