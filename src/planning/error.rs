//! Errors of planning, and what the operator should change. Nothing has moved.

use machine::Axis;
use machine::kinematics::KinematicsError;

/// Error of planning. Lengths in mm; `value`, `min` and `max` in mm or degrees.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlanningError {
    #[error(transparent)]
    Kinematics(#[from] KinematicsError),
    #[error("Z would have to rise to {needed:.3} mm to pass over the part, but ends at {max} mm")]
    NoRoomAbove { needed: f64, max: f64 },
    #[error("a positive Z command does not lift the tool off the part")]
    ZDown,
    #[error("step {step}: {axis} would go to {value}, outside [{min}, {max}]")]
    OutOfTravel { step: u32, axis: Axis, value: f64, min: f64, max: f64 },
    #[error("step {step} moves {axis}, which the machine does not have")]
    NoAxis { step: u32, axis: Axis },
    #[error("step {step}: the spindle does not stand upright; balls are touched from above only")]
    Tilted { step: u32 },
    #[error("step {step} is no touch")]
    NotATouch { step: u32 },
    #[error("step {step} is no scan that can be run: {why}")]
    NotAScan { step: u32, why: &'static str },
    #[error("step {step} asks a person when its stage has moved already")]
    LatePrompt { step: u32 },
    #[error("step {step} is no prompt that can be asked: {why}")]
    NotAPrompt { step: u32, why: &'static str },
    #[error(
        "step {step}: with Z at its upper end `{body}` is within the range of `{sensor}`, so an early \
         distance would not show that the machine stands elsewhere"
    )]
    InRangeAtTop { step: u32, sensor: String, body: String },
    #[error("step {step} does not say where {axis} stands")]
    Incomplete { step: u32, axis: Axis },
    #[error("step {step} turns {axis} during the touch")]
    Turns { step: u32, axis: Axis },
    #[error("step {step}: the touch has no length")]
    NoLength { step: u32 },
    #[error(
        "step {step}: the touch is {length:.3} mm long, so its unguarded back-off could be longer than the probe's overtravel of {overtravel} mm"
    )]
    TooLong { step: u32, length: f64, overtravel: f64 },
    #[error(
        "braking from the guarded feed of {feed} mm/min takes {way:.2} mm, more than the probe's overtravel of {overtravel} mm"
    )]
    GuardTooFast { feed: f64, way: f64, overtravel: f64 },
}

impl PlanningError {
    /// What the operator should do next.
    pub fn remedy(&self) -> String {
        let text = match self {
            Self::Kinematics(_) => "correct [machine] and [axes] in the machine file",
            Self::NoRoomAbove { .. } => {
                "use a shorter stylus or a lower part, or correct [axes.Z] max, [artefact] height_mm, tool_mm"
            }
            Self::ZDown => "state Z after ISO 841: positive away from the part ([axes.Z] positive)",
            Self::OutOfTravel { .. } => {
                "move the part nearer to the middle, or correct the limits in [axes]"
            }
            Self::NoAxis { .. } => "describe the axis in [axes] and in the topology",
            Self::InRangeAtTop { .. } => {
                "lower the artefact, or take the body away; or correct [axes.Z] max, zero_mm and range_mm of \
                 the [[sensor]]"
            }
            Self::Tilted { .. } => {
                "measure with the axis of the head where the spindle stands along Z"
            }
            Self::NotATouch { .. } => "this version plans touches and scans only",
            Self::LatePrompt { .. } => "put the prompts of a stage before whatever moves in it",
            Self::NotAPrompt { .. } => {
                "correct the step in the plan: a `text`, and the same in `from` and `to`"
            }
            Self::NotAScan { .. } => {
                "correct the step in the plan: a `path` from `from` to `to`, `dwell_s` and `samples` at \
                 each of its points, and the name of a [[sensor]]"
            }
            Self::Incomplete { .. } | Self::Turns { .. } | Self::NoLength { .. } => {
                "correct the step in the plan; `from` names all axes, `to` moves linear ones alone"
            }
            Self::TooLong { .. } => {
                "lower [artefact] uncertainty_mm (set the part up nearer to where the file says) or the method's distances"
            }
            Self::GuardTooFast { .. } => "lower [probe] guarded_feed_mm_min",
        };
        text.to_owned()
    }
}
