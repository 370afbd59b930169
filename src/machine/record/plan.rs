//! The plan: the machine, the measurement and its steps. It is written stage by stage during a run. It is
//! self-contained: a program that simulates the machine needs no other file.

use serde::{Deserialize, Serialize};

use super::artefact::Artefact;
use super::estimate::Estimate;
use super::machine::{Keepout, Machine, Probe, Solid};
use super::report_data::ReportData;
use super::sensor::Sensor;
use super::watched_sensors::WatchedSensor;
use crate::{Axis, Position};

/// Version of the plan format, the value of the key `trued_plan`.
pub const PLAN_VERSION: u32 = 1;

/// First repeat number of steps that are measured again because their readings were outliers. These repeat numbers are
/// above the number of passes of any method and below [`FIRST_REPEAT_NUMBER_AFTER_STOP`].
pub const FIRST_OUTLIER_REPEAT_NUMBER: u32 = 500;

/// First repeat number of references that are measured again after a stop.
pub const FIRST_REPEAT_NUMBER_AFTER_STOP: u32 = 1000;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Version of the plan format, [`PLAN_VERSION`].
    pub trued_plan: u32,
    pub method: String,
    /// Settings of the method, complete with defaults.
    pub settings: serde_json::Value,
    pub machine: Machine,
    pub probe: Probe,
    /// Sensors that measure in addition to the probe, or in its place.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<Sensor>,
    #[serde(default)]
    pub keepout: Vec<Keepout>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub solids: Vec<Solid>,
    /// The artefact as the machine file states it; positions found later are in `Stage::found`.
    pub artefact: Artefact,
    /// Estimates of other runs that are used as known values.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub priors: Vec<Estimate>,
    /// Times on the clock of the readings, s, at which the measurement was interrupted: each is the time of the
    /// last reading before the interruption. Values before and after an interruption may differ systematically.
    #[serde(rename = "gaps_s", default, skip_serializing_if = "Vec::is_empty")]
    pub interruption_times_s: Vec<f64>,
    /// Keys that the machine file does not contain and whose values are assumed, e.g. `axes.X.backlash_um`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub assumed: Vec<String>,
    /// Compensations that are active in the control, by the control's own names.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub compensations_active: Vec<String>,
    /// Data for the report.
    #[serde(default, skip_serializing_if = "ReportData::is_empty")]
    pub report: ReportData,
    /// Steps of all stages planned so far, each once even if later stages repeat it.
    #[serde(default)]
    pub steps: Vec<Step>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StepKind {
    /// A rotary axis moves; nothing is measured.
    Index,
    #[default]
    Touch,
    Scan,
    /// A touch that is repeated to detect drift. A run can continue after a stop only with references. A method may
    /// also use it for the identification.
    Reference,
    /// The operator does what `text` says. Nothing moves: `from` equals `to`. Prompts come first in their stage.
    Prompt,
}

/// One step. A touch is the straight line `from` → `to` of the linear axes alone; rotary axes and spindle are
/// positioned as in `from`. Machine coordinates.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Unique in the plan; the first step has 0.
    pub id: u32,
    /// Id of the stage that adds the step; later stages may repeat the step.
    pub stage: u32,
    pub kind: StepKind,
    /// Label, e.g. `1a/C045`: test and angle.
    pub label: String,
    pub from: Position,
    pub to: Position,
    /// Feed of the touch or scan; in degrees per minute if a scan moves rotary axes only.
    pub feed_mm_min: f64,
    /// Names of the measuring sensors: `probe`, or sensors of the plan. In JSON, `sensor` is the only name, or
    /// empty; `sensors` is the list of several.
    #[serde(flatten, with = "super::sensor_names")]
    pub sensors: Vec<String>,
    /// Outward surface normal at the expected contact, machine frame; for a scan: the direction against the beam.
    pub normal: [f64; 3],
    #[serde(flatten, default, skip_serializing_if = "Option::is_none")]
    pub scan: Option<Scan>,
    /// Text of a prompt: what the operator must do.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
    /// For a prompt: mounting of the artefact from this step on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mount: Option<ArtefactMount>,
    /// For a prompt: sensors that are read while the operator works.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub watch: Vec<WatchedSensor>,
}

/// Mounting of the artefact.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ArtefactMount {
    /// Rotation relative to the first mounting, counter-clockwise seen from the tip of the artefact's axis.
    pub turn_deg: f64,
}

impl Plan {
    /// Numbers the steps of a stage, continuing after the last step of the plan.
    pub fn number_steps(&self, stage: u32, steps: Vec<Step>) -> Vec<Step> {
        let first = self.steps.last().map_or(0, |step| step.id + 1);
        (first..).zip(steps).map(|(id, step)| Step { id, stage, ..step }).collect()
    }
}

impl Step {
    /// A prompt without step number.
    pub fn prompt(label: String, text: String) -> Self {
        Self { kind: StepKind::Prompt, label, text: Some(text), ..Self::default() }
    }

    /// A touch of the probe from `from` to `to` against `normal`, without step number and feed.
    pub fn probe_touch(label: String, from: Position, to: Position, normal: [f64; 3]) -> Self {
        Self { label, from, to, sensors: vec!["probe".to_owned()], normal, ..Self::default() }
    }

    /// A scan from the first to the last point of its path, without step number, feed and sensors.
    pub fn scan(label: String, scan: Scan) -> Self {
        let end = |point: Option<&Position>| point.cloned().unwrap_or_default();
        let (from, to) = (end(scan.path.first()), end(scan.path.last()));
        Self { kind: StepKind::Scan, label, from, to, scan: Some(scan), ..Self::default() }
    }

    /// Name of the first sensor; empty if there is none.
    pub fn first_sensor(&self) -> &str {
        self.sensors.first().map_or("", String::as_str)
    }
}

/// Path and sampling of a scan: straight segments from point to point, at the feed of the step. `from` of the step
/// is the first point, `to` the last. Angles of rotary axes are unwrapped: from 0 to 1080° are three revolutions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scan {
    pub path: Vec<Position>,
    #[serde(flatten)]
    pub sampling: Sampling,
}

impl Scan {
    /// Whether the scan moves rotary axes only; its feed is then in degrees per minute.
    pub fn is_rotary_only(&self) -> bool {
        self.moved_axes().next().is_some() && self.moved_axes().all(|axis| !axis.is_linear())
    }

    /// The rotary axis that the scan turns, if it moves no other axis.
    pub fn single_rotary_axis(&self) -> Option<Axis> {
        let mut moved = self.moved_axes();
        moved.next().filter(|axis| !axis.is_linear() && moved.next().is_none())
    }

    /// Index of the point of the path that is nearest to `position`, over the axes of the point. `None`: no path.
    pub fn nearest_point_index(&self, position: &Position) -> Option<usize> {
        let distance = |point: &Position| -> f64 {
            point.iter().map(|(axis, at)| (position.get_or_zero(axis) - at).powi(2)).sum()
        };
        (0..self.path.len()).min_by(|a, b| distance(&self.path[*a]).total_cmp(&distance(&self.path[*b])))
    }

    /// Axes of the first point whose position changes along the path.
    fn moved_axes(&self) -> impl Iterator<Item = Axis> {
        let axes_at = |axis: Axis| self.path.iter().map(move |point| point.get(axis));
        let axes = self.path.first().into_iter().flat_map(Position::iter).map(|(axis, _)| axis);
        axes.filter(move |axis| axes_at(*axis).any(|value| Some(value) != axes_at(*axis).next()))
    }
}

/// Sampling of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Sampling {
    /// At each point: the axes rest for `dwell_s`, then `samples` samples are taken at standstill.
    Dwell { dwell_s: f64, samples: u32 },
    /// During the motion, at most `rate_hz` samples per second, with positions from a control that stamps them.
    Continuous {
        rate_hz: f64,
        /// For a turn of one rotary axis: the number of equal angles per revolution, from 0° on, to which the
        /// samples are filtered. The filtered values are the readings: all samples are used, also above `rate_hz`.
        /// Absent: every sample is a reading.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        per_revolution: Option<usize>,
    },
}

/// A part of the plan that is proven and run as a whole; the method receives its readings before it plans the next
/// stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    pub id: u32,
    pub name: String,
    /// Code of the pass: the number of earlier measurements of each step, 0 in the first pass. From
    /// [`FIRST_OUTLIER_REPEAT_NUMBER`] on: measured again because the value was an outlier, one number per such stage.
    /// From [`FIRST_REPEAT_NUMBER_AFTER_STOP`] on: references measured again after a stop, one number per stop.
    pub repeat: u32,
    /// Ids of the steps to run, in order; the steps themselves are in `Plan::steps`.
    pub steps: Vec<u32>,
    /// The artefact at the position found by earlier stages; proofs use it from this stage on. Absent: not found yet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub found: Option<Artefact>,
}
