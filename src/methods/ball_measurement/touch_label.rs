//! Label of a step, such as `slow/007/3/+45`: pass, number of the visit's indexation, ball, touch.

use std::fmt;
use std::str::FromStr;

use machine::record::plan::{Plan, Step};

/// Purpose of a touch of a ball.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum MeasurementPurpose {
    /// Fast touches to find the ball.
    Find,
    /// Slow touches along the normals, which are known by then. The identification uses them.
    Slow,
    /// As `Slow`, before the first slow touches, to check whether the machine is at rest. The identification does not
    /// use them.
    RestCheck,
    /// As `Slow`, to check whether the machine has moved. The identification uses them as well, except that of
    /// `ball-plate`.
    Reference,
}

/// One touch of one measurement of a ball. All steps that share purpose, indexation and ball are one measurement,
/// with the same position of the rotary axes.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TouchLabel {
    pub purpose: MeasurementPurpose,
    /// Index of the visit's indexation, or of the round of a reference or of the rest check, from 0. The text and the
    /// messages for users count from 1.
    pub indexation_index: u32,
    /// Id of the ball in the artefact.
    pub ball: String,
    /// Name of the touch by azimuth in degrees, e.g. `+45`, `-135`, or `pole`; by azimuth and elevation for further
    /// touches, e.g. `+117^35`.
    pub touch: String,
}

/// First part of the label text for each purpose.
const PURPOSE_LABELS: [(MeasurementPurpose, &str); 4] = [
    (MeasurementPurpose::Find, "find"),
    (MeasurementPurpose::Slow, "slow"),
    (MeasurementPurpose::RestCheck, "watch"),
    (MeasurementPurpose::Reference, "reference"),
];

impl TouchLabel {
    /// Number of the indexation or of the round, counted from 1.
    pub fn indexation_number(&self) -> u32 {
        self.indexation_index.saturating_add(1)
    }

    /// Common part of the labels of a measurement, e.g. `slow/007/3`.
    pub fn measurement_label(&self) -> String {
        let text = self.to_string();
        text.rsplit_once('/').map_or(text.clone(), |(measurement, _)| measurement.to_owned())
    }
}

/// The steps of the plan that touch a ball, with their labels.
pub fn touch_steps_with_labels(plan: &Plan) -> impl Iterator<Item = (&Step, TouchLabel)> {
    plan.steps.iter().filter_map(|step| Some((step, step.label.parse().ok()?)))
}

impl fmt::Display for TouchLabel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = PURPOSE_LABELS.iter().find(|(pass, _)| *pass == self.purpose).map_or("", |(_, name)| name);
        write!(f, "{name}/{:03}/{}/{}", self.indexation_number(), self.ball, self.touch)
    }
}

/// Holds the text that is not a touch label.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a label of a ball measurement, such as slow/007/3/+45")]
pub struct InvalidTouchLabel(pub String);

impl FromStr for TouchLabel {
    type Err = InvalidTouchLabel;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let unknown = || InvalidTouchLabel(text.to_owned());
        let [pass, indexation, ball, touch] = text.split('/').collect::<Vec<_>>().try_into().map_err(|_| unknown())?;
        let number: u32 = indexation.parse().map_err(|_| unknown())?;
        let named = PURPOSE_LABELS.iter().find(|(_, name)| *name == pass);
        Ok(Self {
            purpose: named.ok_or_else(unknown)?.0,
            indexation_index: number.checked_sub(1).ok_or_else(unknown)?,
            ball: ball.to_owned(),
            touch: touch.to_owned(),
        })
    }
}
