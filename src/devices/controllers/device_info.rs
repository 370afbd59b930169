//! Properties that a control reports; if no control can be identified, possible causes of that fault.

use std::collections::BTreeMap;
use std::fmt;

use super::ControllerError;
use machine::Axis;
use machine::record::machine::{AxisSense, Machine};

/// Properties that a control reports, from its own settings, independent of the machine file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DeviceInfo {
    /// Name and version as reported.
    pub identity: String,
    /// All axes that the control drives; if the control does not report them, those of the machine file.
    pub axes: BTreeMap<Axis, ReportedAxisProperties>,
    /// Remarks on settings and states that prevent a measurement or that the operator must know.
    pub findings: Vec<ReadinessFinding>,
    /// How the operator inverts the probe input at the control, if the control supports it.
    pub probe_inversion_hint: Option<String>,
}

/// Properties of one axis as the control reports them, in the units of
/// [`StatedAxis`](machine::record::machine::StatedAxis): mm, degrees, minutes and seconds. `None` if the control does
/// not report the value.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ReportedAxisProperties {
    /// Lower end of the travel, in machine coordinates.
    pub travel_min: Option<f64>,
    /// Upper end of the travel, in machine coordinates.
    pub travel_max: Option<f64>,
    /// Length of the travel; a control may report it without the ends.
    pub travel_length: Option<f64>,
    /// Whether the control homes the axis.
    pub has_homing: Option<bool>,
    pub rapid_per_min: Option<f64>,
    pub acceleration_per_s2: Option<f64>,
    /// Smallest step that the control can command or report, mm or degrees.
    pub resolution: Option<f64>,
    /// Sense of rotation of the table or head for a positive command, as the control's kinematics compute it. The
    /// wiring of the machine may differ.
    pub positive_sense: Option<AxisSense>,
}

/// A remark on the settings or the state of a control.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadinessFinding {
    /// Whether the remark prevents a measurement; otherwise it is information.
    pub is_blocking: bool,
    pub description: String,
    pub remedy: String,
}

impl ReadinessFinding {
    pub(in crate::controllers) fn blocking(description: impl Into<String>, remedy: &str) -> Self {
        Self { is_blocking: true, description: description.into(), remedy: remedy.to_owned() }
    }

    pub(in crate::controllers) fn non_blocking(description: impl Into<String>, remedy: &str) -> Self {
        Self { is_blocking: false, ..Self::blocking(description, remedy) }
    }
}

/// Requests that the operator permits during the search for the reason why a control does not answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum DiagnosisMode {
    /// Search only with the settings of the machine file.
    ConfiguredSettings,
    /// Search also at other baud rates, in the protocols of other controls, under other unit numbers. None of these
    /// requests is a command in its own protocol; their effect on another device is unknown.
    OtherSettings,
}

/// Request to find the reason why the control of `machine` could not be opened or prepared.
#[derive(Clone, Copy)]
pub struct ConnectionDiagnosisRequest<'a> {
    pub machine: &'a Machine,
    pub failure: &'a ControllerError,
    pub mode: DiagnosisMode,
}

/// A possible cause of a fault.
#[derive(Debug, Clone, PartialEq)]
pub struct PossibleCause {
    /// Whether the cause was observed; otherwise it is suspected.
    pub is_observed: bool,
    /// Whether a search with other settings could find out more.
    pub needs_other_settings_search: bool,
    /// Description of the possible cause.
    pub cause: String,
    /// Evidence for the cause.
    pub evidence: String,
    /// What the operator should do, or the lines to write in the machine file.
    pub remedy: String,
}

impl PossibleCause {
    pub(in crate::controllers) fn observed(
        cause: impl Into<String>,
        evidence: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self { is_observed: true, ..Self::suspected(cause, evidence, remedy) }
    }

    pub(in crate::controllers) fn suspected(
        cause: impl Into<String>,
        evidence: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        let (cause, evidence, remedy) = (cause.into(), evidence.into(), remedy.into());
        Self { is_observed: false, needs_other_settings_search: false, cause, evidence, remedy }
    }

    /// Returns this cause as one about which a search with other settings could find out more.
    pub(in crate::controllers) fn before_search(self) -> Self {
        Self { needs_other_settings_search: true, ..self }
    }
}

impl fmt::Display for PossibleCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { is_observed, cause, evidence, .. } = self;
        let grade = if *is_observed { "" } else { "suspected: " };
        write!(f, "{grade}{cause} ({evidence})")
    }
}
