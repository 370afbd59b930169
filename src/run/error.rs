//! Errors that end a run early.

use super::counted_turn::EncoderCountFault;
use crate::store::{StoreError, UnfinishedCompensation};
use devices::controllers::ControllerError;
use devices::sensors::SensorError;
use machine::record::plan::Step;
use machine::record::reading::ReadingFlag;
use methods::MethodRefusal;
use methods::decision::reference_shifts::{ReferenceShift, TouchScatter, describe_shifts};
use planning::PlanningError;
use planning::gcode::RenderError;
use planning::proof::ProofRefusal;

/// Error that ends a run early. Only two of these errors close the run ([`RunError::closes_run`]).
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    #[error(transparent)]
    MethodRefused(#[from] MethodRefusal),
    #[error(transparent)]
    Planning(#[from] PlanningError),
    #[error("the collision check refuses stage `{stage}`: {source}")]
    CollisionCheckRefused { stage: String, source: Box<ProofRefusal> },
    #[error("the collision check of stage `{stage}` ended without a result")]
    ProofAborted { stage: String },
    #[error("the program of stage `{stage}` cannot be written for this control: {source}")]
    ProgramNotWritable { stage: String, source: RenderError },
    #[error(transparent)]
    Controller(#[from] ControllerError),
    /// A fault of one step, with the label of that step.
    #[error("{label}, {source}")]
    AtStep { label: String, source: Box<RunError> },
    /// Fault of the probe input while a sensor is mounted instead of the probe.
    #[error("{source}; but the sensor `{sensor}` is mounted instead of the probe")]
    ProbeInputFaultWithSensor { sensor: String, source: Box<RunError> },
    #[error("the run contains a prompt (`{text}`), but no operator can answer it")]
    NoOperator { text: String },
    #[error("the stylus was not {} within {seconds} s", if *expects_closed { "deflected" } else { "released" })]
    StylusTimeout { expects_closed: bool, seconds: u64 },
    #[error("step {step}: the first touch reached its end without contact")]
    NoFirstContact { step: u32 },
    #[error("sensor `{name}`: {source}")]
    Sensor { name: String, source: SensorError },
    #[error("step {step}: the sensor `{sensor}` has no valid value ({})", flag.as_str())]
    NoValidSample { step: u32, sensor: String, flag: ReadingFlag },
    #[error(
        "step {step}: the sensor `{sensor}` reports {value_mm:.3} mm at a position where no body of the \
        machine file is within its range"
    )]
    UnexpectedBodyInRange { step: u32, sensor: String, value_mm: f64 },
    #[error("step {step} is sampled in motion, but this control does not report time-stamped axis positions")]
    NoTimeStampedPositions { step: u32 },
    #[error("step {step} was not sampled in motion: {why}")]
    ScanInMotionFailed { step: u32, why: String },
    #[error("step {step}: the samples of `{sensor}` cannot be assigned to axis positions: {source}")]
    EncoderFault { step: u32, sensor: String, source: EncoderCountFault },
    #[error("step {step} ended without a contact position")]
    NoContactPosition { step: u32 },
    #[error("not all references were measured before the stop: a shift of the machine cannot be detected")]
    ReferencesIncompleteBeforeStop,
    #[error("not all references could be measured again after the stop: {reference_labels}")]
    ReferencesNotRemeasured { reference_labels: String },
    #[error("the references have shifted since the stop: {}; {}", describe_shifts(shifts), scatter.describe())]
    ReferencesShifted { shifts: Vec<ReferenceShift>, scatter: TouchScatter },
    #[error(transparent)]
    UnfinishedCompensation(UnfinishedCompensation),
    #[error("the run stopped, because the journal could not be written: {0}")]
    Store(#[from] StoreError),
}

const PROBE_INPUT_REMEDY: &str = "make sure that the probe input of the control reads open while a sensor is in the spindle. \
    If the machine was in motion, first check whether the sensor has touched a body. Check that \
    the removed probe is not deflected, and that its receiver does not report an error without \
    a probe. If the input is open only with a closed probe circuit, plug in a connector that closes the circuit";

const UNEXPECTED_DISTANCE_REMEDY: &str = "retract by hand along the approach path; then check that the position of the \
    machine agrees with the display of the control, that the artefact is at its position in the machine \
    file, and that no other body is below the sensor";

impl RunError {
    /// Remedy to show to the user.
    pub fn remedy(&self) -> String {
        let remedy = match self {
            Self::MethodRefused(refused) => return refused.remedy.clone(),
            Self::Planning(error) => return error.remedy(),
            Self::CollisionCheckRefused { source, .. } => source.remedy(),
            Self::ProofAborted { .. } => "report this fault to the developers and attach the plan",
            Self::ProgramNotWritable { source, .. } => return source.remedy(),
            Self::Controller(error) => return error.remedy(),
            Self::AtStep { source, .. } => return source.remedy(),
            Self::ProbeInputFaultWithSensor { .. } => PROBE_INPUT_REMEDY,
            Self::NoOperator { .. } => {
                "start or resume the run from the page of `trued serve`, or from a terminal with an operator"
            }
            Self::StylusTimeout { .. } => {
                "deflect the stylus and watch the probe input at the control; check that the probe is \
                switched on, its battery charged and its cable undamaged"
            }
            Self::NoFirstContact { .. } => {
                "the probe may not work: before the next motion, deflect the stylus and watch the probe \
                input at the control. If the input changes, check that the part is at its position in the \
                machine file ([artefact] centre_mm, radius_mm)"
            }
            Self::Sensor { source, .. } => return source.remedy(),
            Self::NoValidSample { flag, .. } => flag_remedy(*flag),
            Self::UnexpectedBodyInRange { .. } => UNEXPECTED_DISTANCE_REMEDY,
            Self::NoTimeStampedPositions { .. } => {
                "use dwell points (sampling = \"dwell\"); or, on LinuxCNC, add the sampler to the machine \
                file ([controller.sampler]); or, for one revolution of a rotary axis, use sensors that send \
                the count of the axis encoder ([encoder])"
            }
            Self::EncoderFault { source, .. } => return source.remedy(),
            Self::ScanInMotionFailed { .. } => {
                "`trued resume` measures the step again; if the fault repeats, use dwell points (sampling = \"dwell\")"
            }
            Self::NoContactPosition { .. } => "report this fault to the developers and attach the export of the run",
            Self::UnfinishedCompensation(unfinished) => return unfinished.remedy(),
            Self::Store(error) => error.remedy(),
            Self::ReferencesNotRemeasured { .. } => {
                "find out why the sensor has no valid value at these positions, then run `trued resume` again"
            }
            Self::ReferencesIncompleteBeforeStop => "the run is closed, its readings are stored; start a new run",
            Self::ReferencesShifted { .. } => {
                "the run is closed, its readings are stored (`trued identify` with --run evaluates them). \
                Start a new run; after a long stop, thermal drift may be the cause"
            }
        };
        remedy.to_owned()
    }

    /// Replaces `NoContact` by `NoFirstContact`, because no touch has confirmed yet that the probe works.
    pub(super) fn convert_no_contact_to_no_first_contact(self) -> Self {
        match self {
            Self::Controller(ControllerError::NoContact { step }) => Self::NoFirstContact { step },
            Self::AtStep { label, source } => {
                Self::AtStep { label, source: Box::new(source.convert_no_contact_to_no_first_contact()) }
            }
            other => other,
        }
    }

    /// Adds to a fault of the probe input that `sensor` is mounted instead of the probe, and has no stylus to release.
    pub(super) fn add_sensor_to_probe_input_error(self, sensor: &str) -> Self {
        use ControllerError::{ProbeClosed, ProbeStillClosed, UnexpectedContact};
        let closed =
            |error: &ControllerError| matches!(error, ProbeClosed | ProbeStillClosed { .. } | UnexpectedContact { .. });
        match self.controller_error().is_some_and(closed) {
            true => RunError::ProbeInputFaultWithSensor { sensor: sensor.to_owned(), source: Box::new(self) },
            false => self,
        }
    }

    /// Adds the label of the step to an error that names the step by its number: the label tells the operator
    /// which feature was touched, and from which side.
    pub(super) fn with_step_label(self, step: &Step) -> Self {
        let failed_step = match &self {
            Self::Controller(error) => error.failed_step(),
            Self::NoContactPosition { step: id }
            | Self::NoValidSample { step: id, .. }
            | Self::UnexpectedBodyInRange { step: id, .. }
            | Self::ScanInMotionFailed { step: id, .. }
            | Self::EncoderFault { step: id, .. } => Some(*id),
            _ => None,
        };
        match failed_step == Some(step.id) {
            true => Self::AtStep { label: step.label.clone(), source: Box::new(self) },
            false => self,
        }
    }

    /// The error of the control that caused this error; `None` if the control did not cause it.
    pub fn controller_error(&self) -> Option<&ControllerError> {
        match self {
            Self::Controller(error) => Some(error),
            Self::AtStep { source, .. } | RunError::ProbeInputFaultWithSensor { source, .. } => {
                source.controller_error()
            }
            _ => None,
        }
    }

    /// Whether the run can never be resumed; its readings stay.
    pub fn closes_run(&self) -> bool {
        matches!(self, RunError::ReferencesIncompleteBeforeStop | Self::ReferencesShifted { .. })
    }

    /// Whether the axes must be homed before any other motion.
    pub fn may_have_lost_position(&self) -> bool {
        self.controller_error().is_some_and(ControllerError::may_have_lost_position)
    }

    /// Whether the link to the control or to a sensor failed.
    pub fn is_link_error(&self) -> bool {
        use ControllerError::{Link, Modbus, NoAnswer};
        match self {
            Self::Sensor { source, .. } => source.is_link_error(),
            _ => matches!(self.controller_error(), Some(Link(_) | Modbus(_) | NoAnswer { .. })),
        }
    }

    /// Whether a person requested the stop.
    pub fn is_requested_stop(&self) -> bool {
        matches!(self, Self::Controller(ControllerError::Halted))
    }
}

/// Remedy for a sample with this flag.
fn flag_remedy(flag: ReadingFlag) -> &'static str {
    match flag {
        ReadingFlag::Stale => "the sensor sends no more data: check its cable, its power supply and its link",
        ReadingFlag::Saturated => {
            "the sensor receives too much light: reduce its exposure or laser power, or use a less reflective sphere"
        }
        _ => {
            "check that the artefact is at its position in the machine file, that its surface is clean, and \
            that the sensor is mounted as zero_mm and direction state"
        }
    }
}
