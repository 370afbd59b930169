//! Errors of planning, and what the operator should change. Nothing has moved.

use machine::Axis;
use machine::kinematics::KinematicsError;

/// Error of planning. Lengths in mm; `value`, `min` and `max` in mm or degrees.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlanningError {
    #[error(transparent)]
    Kinematics(#[from] KinematicsError),
    /// The Z command `needed` to clear all bodies is above `max`, the upper end of Z.
    #[error("Z travel is too short to pass over the part: Z {needed:.3} mm is required, the upper limit is {max} mm")]
    InsufficientZTravel { needed: f64, max: f64 },
    #[error("a positive Z command does not move the tool away from the part")]
    InvertedZ,
    #[error("step {step}: the target {axis} {value} is outside the limits [{min}, {max}]")]
    OutOfTravel { step: u32, axis: Axis, value: f64, min: f64, max: f64 },
    #[error("step {step} moves {axis}, but the machine has no axis {axis}")]
    UnknownAxis { step: u32, axis: Axis },
    #[error("step {step}: the spindle is tilted; balls can be touched only with the spindle axis along Z")]
    SpindleTilted { step: u32 },
    /// The step is to be planned as a touch, but is neither a touch nor a reference touch.
    #[error("step {step} is not a touch")]
    NotATouch { step: u32 },
    #[error("step {step} is an invalid scan: {reason}")]
    InvalidScan { step: u32, reason: &'static str },
    #[error("step {step} is a prompt after a motion of the same stage")]
    PromptAfterMotion { step: u32 },
    #[error("step {step} is an invalid prompt: {reason}")]
    InvalidPrompt { step: u32, reason: &'static str },
    #[error(
        "step {step}: with Z at its upper limit, `{body}` is within the range of `{sensor}`; a reading \
         before the scan could then not reveal a wrong machine position"
    )]
    BodyInSensorRangeAtTopOfZ { step: u32, sensor: String, body: String },
    #[error("step {step} has no position of {axis}")]
    MissingAxisPosition { step: u32, axis: Axis },
    #[error("step {step} moves the rotary axis {axis} during the touch")]
    RotaryMotionInTouch { step: u32, axis: Axis },
    #[error("step {step}: the touch has zero length")]
    ZeroLengthTouch { step: u32 },
    /// The touch is longer than the probe's overtravel. The limit protects the probe in the unguarded back-off.
    #[error(
        "step {step}: the touch is {length:.3} mm long; its unguarded back-off could exceed the probe's overtravel of {overtravel} mm"
    )]
    TouchTooLong { step: u32, length: f64, overtravel: f64 },
    /// The braking distance from the guarded feed, mm/min, on the slowest linear axis is longer than the probe's
    /// overtravel.
    #[error(
        "the braking distance from the guarded feed of {feed} mm/min is {distance_mm:.2} mm, more than the probe's overtravel of {overtravel} mm"
    )]
    GuardedFeedTooFast { feed: f64, distance_mm: f64, overtravel: f64 },
}

impl PlanningError {
    /// What the operator should do next.
    pub fn remedy(&self) -> String {
        let text = match self {
            Self::Kinematics(_) => "correct [machine] and [axes] in the machine file",
            Self::InsufficientZTravel { .. } => {
                "use a shorter stylus or a lower part, or correct [axes.Z] max, [artefact] height_mm, tool_mm"
            }
            Self::InvertedZ => "correct [axes.Z] positive: by ISO 841, positive Z is away from the part",
            Self::OutOfTravel { .. } => {
                "move the part nearer to the middle of the travel, or correct the limits in [axes]"
            }
            Self::UnknownAxis { .. } => "add the axis to [axes] and to the topology in the machine file",
            PlanningError::BodyInSensorRangeAtTopOfZ { .. } => {
                "lower the artefact, remove the body, or correct [axes.Z] max, and zero_mm and range_mm of \
                 the [[sensor]]"
            }
            Self::SpindleTilted { .. } => "move the axis of the head to the angle at which the spindle axis is along Z",
            Self::NotATouch { .. } => "correct the step in the plan: only touches and scans can be planned",
            Self::PromptAfterMotion { .. } => "put the prompts of the stage before its motions in the plan",
            Self::InvalidPrompt { .. } => "correct the step in the plan: add a `text`, and make `from` and `to` equal",
            Self::InvalidScan { .. } => {
                "correct the step in the plan: a scan requires a `path` from `from` to `to`, either `dwell_s` \
                 and `samples` or `rate_hz`, and the name of a [[sensor]]"
            }
            Self::MissingAxisPosition { .. } | Self::RotaryMotionInTouch { .. } | Self::ZeroLengthTouch { .. } => {
                "correct the step in the plan: `from` must contain all axes, `to` must move linear axes only"
            }
            Self::TouchTooLong { .. } => {
                "set the part up nearer to its position in the machine file and lower [artefact] uncertainty_mm, or lower the method's distances"
            }
            Self::GuardedFeedTooFast { .. } => "lower [probe] guarded_feed_mm_min",
        };
        text.to_owned()
    }
}
