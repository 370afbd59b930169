//! Properties that a control reports, and possible causes if no control can be identified.

use std::collections::BTreeMap;
use std::fmt;

use machine::Axis;
use machine::record::machine::Sense;

/// Properties that a control reports, from its own settings, independent of the machine file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DeviceInfo {
    /// Name and version as reported.
    pub identity: String,
    /// All axes that the control drives.
    pub axes: BTreeMap<Axis, ReportedAxis>,
    /// Settings with which the control cannot measure, or which the operator must know.
    pub remarks: Vec<ReadinessFinding>,
    /// How the operator inverts the probe input at the control, if the control supports it.
    pub polarity: Option<String>,
}

/// Properties of one axis, in the units of [`AxisSpec`](machine::record::machine::AxisSpec): mm, degrees,
/// minutes and seconds. `None` if the control does not report the value.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ReportedAxis {
    /// Lower end of the travel in machine coordinates; `max` is the upper end.
    pub min: Option<f64>,
    pub max: Option<f64>,
    /// Length of the travel, if the control reports it without the ends.
    pub travel: Option<f64>,
    /// Whether the control homes the axis.
    pub homes: Option<bool>,
    pub rapid_per_min: Option<f64>,
    pub acceleration_per_s2: Option<f64>,
    /// Smallest step that the control can command or report, mm or degrees.
    pub step: Option<f64>,
    /// Sense in which a positive command turns what the axis carries, if the control computes with it. The
    /// wiring of the machine may differ.
    pub positive: Option<Sense>,
}

/// A remark on a setting of a control.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadinessFinding {
    /// Whether the setting prevents a measurement; otherwise the remark is information.
    pub hinders: bool,
    pub what: String,
    pub remedy: String,
}

impl ReadinessFinding {
    pub(in crate::controllers) fn hinders(what: impl Into<String>, remedy: &str) -> Self {
        Self { hinders: true, what: what.into(), remedy: remedy.to_owned() }
    }

    pub(in crate::controllers) fn note(what: impl Into<String>, remedy: &str) -> Self {
        Self { hinders: false, ..Self::hinders(what, remedy) }
    }
}

/// What the operator permits during the search for the reason why a control does not answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Leave {
    /// Passive search: nothing is sent but what the machine file itself prescribes.
    Listen,
    /// Active search: requests also at other baud rates, in the protocols of other controls, under other unit
    /// numbers. None of them is a command in the protocol that is tried; their effect on another device is
    /// unknown.
    Ask,
}

/// A possible cause of a fault.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnosis {
    /// Whether the cause was observed; otherwise it is suspected.
    pub seen: bool,
    /// Whether an active search could find out more.
    pub vague: bool,
    /// Description of the mistake.
    pub what: String,
    /// Evidence for the cause.
    pub because: String,
    /// What the operator should do, or the lines to write in the machine file.
    pub remedy: String,
}

impl fmt::Display for Diagnosis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { seen, what, because, .. } = self;
        let grade = if *seen { "" } else { "suspected: " };
        write!(f, "{grade}{what} ({because})")
    }
}
