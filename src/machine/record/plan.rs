//! The plan: what is measured, on which machine, step by step. It is written stage by stage while
//! a run goes on, and it alone is enough for somebody else's program to play the machine.

use serde::{Deserialize, Serialize};

use super::artefact::Artefact;
use super::estimate::Estimate;
use super::machine::{Keepout, Machine, Probe, Solid};
use super::sensor::Sensor;
use super::watch::WatchedSensor;
use crate::{Axis, Position};

/// Version of the plan format, the value of the key `trued_plan`.
pub const PLAN_VERSION: u32 = 1;

/// Repeats from here on, and below [`REPEAT_AFTER_STOP`], are measured again because all others contradict what was
/// read; no method counts its passes so far.
pub const REPEAT_OF_SUSPECTS: u32 = 500;

/// Repeats from here on are references measured again after a stop.
pub const REPEAT_AFTER_STOP: u32 = 1000;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    pub trued_plan: u32,
    pub method: String,
    /// The method's own settings, complete (defaults filled in).
    pub settings: serde_json::Value,
    pub machine: Machine,
    pub probe: Probe,
    /// What measures besides the probe, or in its place.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<Sensor>,
    #[serde(default)]
    pub keepout: Vec<Keepout>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub solids: Vec<Solid>,
    pub artefact: Artefact,
    /// Estimates of other runs that are taken as known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub priors: Vec<Estimate>,
    /// Times of the readings' clock, s, at which the measurement was interrupted: each is that of the
    /// last reading before. What was measured before and after may lie apart.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gaps_s: Vec<f64>,
    /// Keys of the machine file that it does not state and whose values are assumed, e.g.
    /// `axes.X.backlash_um`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub assumed: Vec<String>,
    /// Compensations of the control that are active, in its maker's words.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub compensations_active: Vec<String>,
    #[serde(default)]
    pub steps: Vec<Step>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StepKind {
    Index,
    Touch,
    Scan,
    /// A touch that is measured again to see drift; a run can go on after a stop only with references. A
    /// method may identify from it too.
    Reference,
    /// A person does what its `text` says. Nothing moves: `from` is `to`. It stands at the head of its
    /// stage.
    Prompt,
}

/// One step. A touch is the straight line `from` → `to`, linear axes alone moving; rotary axes and
/// spindle stand as `from` says. Machine coordinates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Step {
    pub id: u32,
    pub stage: u32,
    pub kind: StepKind,
    /// e.g. `1a/C045`: test and angle.
    pub label: String,
    pub from: Position,
    pub to: Position,
    pub feed_mm_min: f64,
    /// Names of what measures: `probe`, or of the plan's sensors. In JSON `sensor` is the only one, or empty;
    /// `sensors` is the list of several.
    #[serde(flatten, with = "super::one_or_many")]
    pub sensors: Vec<String>,
    /// Outward surface normal where contact is expected, machine frame; of a scan: against the beam.
    pub normal: [f64; 3],
    #[serde(flatten, default, skip_serializing_if = "Option::is_none")]
    pub scan: Option<Scan>,
    /// What a prompt asks a person to do.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
    /// Of a prompt: how the artefact is mounted from here on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mount: Option<ArtefactMount>,
    /// Of a prompt: sensors that are read while the person works.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub watch: Vec<WatchedSensor>,
}

/// How the artefact is mounted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ArtefactMount {
    /// Against its first mounting, counter-clockwise seen from the tip of its axis.
    pub turn_deg: f64,
}

impl Plan {
    /// Steps of a stage, numbered on from the last step of the plan.
    pub fn numbered(&self, stage: u32, steps: Vec<Step>) -> Vec<Step> {
        let first = self.steps.last().map_or(0, |step| step.id + 1);
        (first..).zip(steps).map(|(id, step)| Step { id, stage, ..step }).collect()
    }
}

impl Step {
    /// A prompt, not yet numbered.
    pub fn prompt(label: String, text: String) -> Self {
        Self {
            id: 0,
            stage: 0,
            kind: StepKind::Prompt,
            label,
            from: Position::new(),
            to: Position::new(),
            feed_mm_min: 0.0,
            sensors: Vec::new(),
            normal: [0.0; 3],
            scan: None,
            text: Some(text),
            mount: None,
            watch: Vec::new(),
        }
    }

    /// A scan from the first to the last point of its path, not yet numbered and without feed and sensors.
    pub fn scan(label: String, scan: Scan) -> Self {
        let end = |point: Option<&Position>| point.cloned().unwrap_or_default();
        let (from, to) = (end(scan.path.first()), end(scan.path.last()));
        let (kind, scan) = (StepKind::Scan, Some(scan));
        Self { kind, from, to, scan, text: None, ..Self::prompt(label, String::new()) }
    }

    /// The first of its sensors; empty where it has none.
    pub fn sensor(&self) -> &str {
        self.sensors.first().map_or("", String::as_str)
    }
}

/// What a scan adds to its step: straight segments from point to point, at the step's feed. `from` of
/// the step is the first point, `to` the last. Angles of rotary axes are unwrapped: from 0 to 1080° are
/// three revolutions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scan {
    pub path: Vec<Position>,
    #[serde(flatten)]
    pub sampling: Sampling,
}

impl Scan {
    /// Whether its linear axes stand still and others turn: its feed is in degrees a minute then.
    pub fn turns_only(&self) -> bool {
        self.moved_axes().next().is_some() && self.moved_axes().all(|axis| !axis.is_linear())
    }

    /// The rotary axis that it turns, where it moves no other axis.
    pub fn turned_axis(&self) -> Option<Axis> {
        let mut moved = self.moved_axes();
        moved.next().filter(|axis| !axis.is_linear() && moved.next().is_none())
    }

    fn moved_axes(&self) -> impl Iterator<Item = Axis> {
        let at = |axis: Axis| self.path.iter().map(move |point| point.get(axis));
        let axes = self.path.first().into_iter().flat_map(Position::iter).map(|(axis, _)| axis);
        axes.filter(move |axis| at(*axis).any(|value| Some(value) != at(*axis).next()))
    }
}

/// When samples are taken.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Sampling {
    /// At each point: it rests so long, then so many samples are taken while it stands.
    Dwell { dwell_s: f64, samples: u32 },
    /// All the way, so many a second, with positions from a control that stamps them.
    Continuous {
        rate_hz: f64,
        /// Of a turn of one rotary axis: the samples are filtered to so many equal angles a revolution, from
        /// 0° on, and these are the readings: all samples are used, also more than `rate_hz`. Without it, every
        /// sample is a reading.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        per_revolution: Option<usize>,
    },
}

/// A part of the plan that is proven and run as a whole; the method sees its readings before it
/// writes the next.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    pub id: u32,
    pub name: String,
    /// How often each step has been measured before: 0 in the first pass. From [`REPEAT_OF_SUSPECTS`] on: measured
    /// again because it was far off, counted by such stages; from [`REPEAT_AFTER_STOP`] on: references measured again
    /// after a stop, counted by stops.
    pub repeat: u32,
    /// Ids of the steps to run, in order. They stand in the plan.
    pub steps: Vec<u32>,
    /// Where the artefact was found, if earlier stages have found it: from here on, proofs look at
    /// this one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub found: Option<Artefact>,
}
