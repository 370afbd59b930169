//! What a control says of itself, and what may be the matter where it says nothing that makes sense.

use std::collections::BTreeMap;
use std::fmt;

use machine::Axis;
use machine::record::machine::Sense;

/// What a control says of itself: as its own settings have it, whatever the machine file says.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Introduction {
    /// Name and version as reported.
    pub identity: String,
    /// Every axis that it drives.
    pub axes: BTreeMap<Axis, AxisSays>,
    /// Settings of it with which it cannot measure, or with which a person should reckon.
    pub remarks: Vec<Remark>,
    /// How a person turns the sense of the probe's input there, where the control can do it.
    pub polarity: Option<String>,
}

/// One axis, in the units of [`AxisSpec`](machine::record::machine::AxisSpec): mm, degrees, minutes and
/// seconds. `None`: the control does not tell it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct AxisSays {
    /// Its travel in machine coordinates.
    pub min: Option<f64>,
    pub max: Option<f64>,
    /// Its length, where the control tells that but not its ends.
    pub travel: Option<f64>,
    /// Whether the control homes it.
    pub homes: Option<bool>,
    pub rapid_per_min: Option<f64>,
    pub acceleration_per_s2: Option<f64>,
    /// Smallest step that the control can command or show, mm or degrees.
    pub step: Option<f64>,
    /// How a positive command turns what the axis carries, where the control computes with it. Whether the
    /// machine is wired so is another matter.
    pub positive: Option<Sense>,
}

/// Something about a control's settings.
#[derive(Debug, Clone, PartialEq)]
pub struct Remark {
    /// It must not measure so; otherwise it is good to know.
    pub hinders: bool,
    pub what: String,
    pub remedy: String,
}

impl Remark {
    pub(in crate::controllers) fn hinders(what: impl Into<String>, remedy: &str) -> Self {
        Self { hinders: true, what: what.into(), remedy: remedy.to_owned() }
    }

    pub(in crate::controllers) fn note(what: impl Into<String>, remedy: &str) -> Self {
        Self { hinders: false, ..Self::hinders(what, remedy) }
    }
}

/// What a person has agreed to while it is being found out why a control does not answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Leave {
    /// Look and listen. Nothing is sent but what the machine file itself would have had sent.
    Listen,
    /// Ask in other ways too: at other speeds, in the languages of other controls, under other unit
    /// numbers. Nothing of it is a command in the language that is tried; what another device takes it
    /// for, nobody knows.
    Ask,
}

/// What may be the matter.
#[derive(Debug, Clone, PartialEq)]
pub struct Suspicion {
    /// Seen to be so; otherwise suspected.
    pub seen: bool,
    /// With leave to ask, more could be found out.
    pub vague: bool,
    /// The mistake, in words.
    pub what: String,
    /// What speaks for it.
    pub because: String,
    /// What to do, or the lines to write in the machine file.
    pub remedy: String,
}

impl fmt::Display for Suspicion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { seen, what, because, .. } = self;
        let grade = if *seen { "" } else { "suspected: " };
        write!(f, "{grade}{what} ({because})")
    }
}
