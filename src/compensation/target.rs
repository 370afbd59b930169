//! Interface to the compensation values of a control, which each kind of values implements.

use std::fmt;

use devices::compensation::ValueToWrite;
use devices::compensation::linuxcnc_joints::JointTableError;
use devices::compensation::linuxcnc_trunnion::TrunnionError;
use devices::controllers::{ControllerError, WorkOffsetSlot};
use machine::Axis;
use machine::kinematics::KinematicsError;
use methods::compensation::{ControlModel, ControlValue};

use crate::setup::SetupError;
use crate::store::{CompensationValue, Journal, StoreError, StoredCompensation};

#[derive(Debug, thiserror::Error)]
pub enum TargetError {
    #[error("the machine file has no section [compensation]")]
    NotConfigured,
    #[error("the machine file has no section [compensation.{0}]")]
    NoSuchTarget(String),
    #[error("the machine file has several sections of [compensation]: {0}")]
    SeveralTargets(String),
    #[error("[compensation] requires LinuxCNC, but [controller] names no INI file of LinuxCNC")]
    NoIniFile,
    #[error(transparent)]
    Trunnion(#[from] TrunnionError),
    #[error(transparent)]
    JointTable(#[from] JointTableError),
    #[error(transparent)]
    Kinematics(#[from] KinematicsError),
    #[error(
        "the kinematics of the control are for a table that tilts on {tilt} and carries C, but the machine has the \
         topology {topology}"
    )]
    OtherTopology { tilt: Axis, topology: String },
    #[error("the machine file states {axis} in another direction or sense than the control")]
    OtherDirection { axis: Axis },
    #[error("the compensation file of {axis} covers {from_mm} to {to_mm} mm, not the travel {min_mm} to {max_mm} mm")]
    ShortTable { axis: Axis, from_mm: f64, to_mm: f64, min_mm: f64, max_mm: f64 },
    #[error("the control of the machine file is simulated")]
    SimulatedControl,
    #[error("the control cannot be opened: {0}")]
    Runtime(std::io::Error),
    #[error(transparent)]
    Setup(Box<SetupError>),
    #[error(transparent)]
    Controller(#[from] ControllerError),
    #[error(
        "the topology {topology} has no rotary table axis along Z, or more than one tilting axis of the table: this is not \
         supported"
    )]
    NoRotaryTable { topology: String },
    /// The work offset of the control has no value for this axis.
    #[error("the control reports no work offset of {axis}")]
    NoWorkOffsetOfAxis { axis: Axis },
    /// A value to write has the name of another slot or axis, or a text that is no number.
    #[error("a value of the compensation is no number of {slot}")]
    UnreadableValue { slot: WorkOffsetSlot },
    #[error("{slot} has {deg}° of {axis}: with it the tilting axis is not at zero at the zero of programs")]
    TiltedSlot { slot: WorkOffsetSlot, axis: Axis, deg: f64 },
    #[error("after the write, {name} reads {read_mm} mm instead of {written_mm} mm")]
    ReadBack { name: String, written_mm: f64, read_mm: f64 },
}

impl TargetError {
    /// Remedy to show to the user.
    pub fn remedy(&self) -> String {
        let text = match self {
            Self::NotConfigured => "add a section for the kind of the control, e.g. [compensation.linuxcnc-trunnion]",
            Self::NoSuchTarget(_) | Self::SeveralTargets(_) => "name one of the sections with --target",
            Self::NoIniFile => "set [controller] ini to the INI file that LinuxCNC was started with",
            Self::Trunnion(error) => return error.remedy(),
            Self::JointTable(error) => return error.remedy(),
            Self::Kinematics(_) => "correct [machine] and [axes] in the machine file",
            Self::OtherTopology { .. } => "correct topology in [machine], or remove this section of [compensation]",
            Self::OtherDirection { .. } => {
                "correct `direction` and `positive` of the axis in the machine file: the axes must be along X, Y and Z; the \
                 trt-kins of LinuxCNC count rotary axes against ISO 841 (`reversed`) unless the pin conventional-directions is 1"
            }
            Self::ShortTable { .. } => {
                "state the first and the last position of the travel in the compensation file, or correct min and max of the \
                 axis in the machine file; then restart LinuxCNC and measure again"
            }
            Self::SimulatedControl => "give the machine file of a machine with --machine",
            Self::Runtime(_) => "end other programs, then try again",
            Self::Setup(error) => return error.remedy().unwrap_or_else(|| "correct the machine file".to_owned()),
            Self::Controller(error) => return error.remedy(),
            Self::NoRotaryTable { .. } => "correct topology in [machine], or remove [compensation.work-offset]",
            Self::NoWorkOffsetOfAxis { .. } => "correct [axes] in the machine file",
            Self::TiltedSlot { .. } => "set the tilting axis of the slot to 0 at the control, or name another slot",
            Self::UnreadableValue { .. } => {
                "set slot of [compensation.work-offset] to the one of the last compensation"
            }
            Self::ReadBack { .. } => {
                "check which other program sets the work offset; then restore the values with `trued compensate undo`"
            }
        };
        text.to_owned()
    }
}

/// Compensation values of a control that can be read and written. Each call blocks the thread.
pub trait CompensationTarget: fmt::Debug {
    /// Key of `[compensation]`.
    fn kind(&self) -> &'static str;

    /// Description of the control, for display.
    fn describe(&self) -> String;

    /// The present values of the control, with the model of their effect.
    ///
    /// # Errors
    /// The control cannot be read, or does not match the machine file.
    fn read(&self) -> Result<ControlModel, TargetError>;

    /// Whether `name` is one of these values by the machine file. Does not read the control.
    fn has_value(&self, _name: &str) -> bool {
        true
    }

    /// Refuses a write that would move the machine.
    ///
    /// # Errors
    /// The machine is moving, or the control currently applies its values.
    fn check_writable(&self) -> Result<(), TargetError>;

    /// Whether one call of [`Self::write`] writes all values; otherwise each value needs its own call.
    fn is_written_in_one_batch(&self) -> bool {
        false
    }

    /// Sets values, in mm, and reads them back.
    ///
    /// # Errors
    /// The errors of [`Self::check_writable`]; a value cannot be set, or another value is read back.
    fn write(&self, values: &[ValueToWrite<'_>]) -> Result<(), TargetError>;

    /// Whether the values determine the tool centre of the control.
    fn sets_tool_centre(&self) -> bool {
        false
    }

    /// Whether the control uses new values only after it was started again.
    fn needs_restart(&self) -> bool {
        false
    }

    /// Checks that the control uses its present values. If `replaced` contains values, also checks that the control no
    /// longer uses these values.
    ///
    /// # Errors
    /// The control uses other values, or does not show which values it uses.
    fn check_in_effect(&self, _replaced: &[(String, f64)]) -> Result<(), TargetError> {
        Ok(())
    }

    /// Instructions to the operator after a write or an undo, in their order.
    fn advice_after_write(&self) -> String;

    /// Sentences for the person who approves a proposal.
    fn notes(&self) -> Vec<String> {
        Vec::new()
    }

    /// Lines of a file that set the values at each start of the control. `None`: the control stores the values itself.
    fn startup_lines(&self, _values: &[ControlValue]) -> Option<String> {
        None
    }
}

/// The newest compensation of `machine` that changed values of `target`, or the unfinished one of the same kind.
///
/// # Errors
/// The journal cannot be read.
pub(super) fn last_compensation(
    journal: &Journal,
    machine: &str,
    target: &dyn CompensationTarget,
) -> Result<Option<StoredCompensation>, StoreError> {
    let has_values = |own: &StoredCompensation| own.changes.iter().all(|change| target.has_value(&change.name));
    let mut of_kind = journal.compensations(machine)?.into_iter().filter(|own| own.target == target.kind());
    Ok(of_kind.find(|own| own.state.forbids_motion() || has_values(own)))
}

/// Names and values (mm) of the changes: after the compensation if `is_after`, otherwise before it.
pub(super) fn values_before_or_after(changes: &[CompensationValue], is_after: bool) -> Vec<(String, f64)> {
    let value = |own: &CompensationValue| (own.name.clone(), if is_after { own.after_mm } else { own.before_mm });
    changes.iter().map(value).collect()
}
