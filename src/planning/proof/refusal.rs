//! Refusals of a proof, and what the operator should do. Nothing has moved.

use super::MIN_UNGUARDED_CLEARANCE_MM;
use crate::gcode::rs274::LineError;
use machine::Axis;
use machine::kinematics::KinematicsError;

/// Step, line and reason of a refusal.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{}line {line}: {reason}", step_prefix(.step))]
pub struct ProofRefusal {
    /// Id and label of the current step. `None`: before the first step, or the refusal concerns the text as a whole
    /// or a single move.
    pub step: Option<(u32, String)>,
    /// Line of the text, from 1, counted through all programs; 1 if the refusal concerns no single line.
    pub line: usize,
    pub reason: RefusalReason,
}

/// Present and intended position of an axis; mm or degrees.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{axis} at {actual} instead of {expected}")]
pub struct PositionMismatch {
    pub axis: Axis,
    pub actual: f64,
    pub expected: f64,
}

fn step_prefix(step: &Option<(u32, String)>) -> String {
    step.as_ref().map_or(String::new(), |(id, label)| format!("step {id} ({label}), "))
}

/// Reason of a refusal. Lengths in mm, feeds in mm/min, or degrees/min if only rotary axes move; `value`, `min`,
/// `max`, and length and limit of `MoveTooLong` in mm or degrees.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RefusalReason {
    #[error(transparent)]
    UnreadableLine(LineError),
    #[error("the program differs from the plan: {0}")]
    TextMismatch(String),
    #[error("the line is longer than the control's line buffer: `{0}`")]
    LineTooLong(String),
    #[error(transparent)]
    Kinematics(#[from] KinematicsError),
    #[error("the solid `{solid}` is on an axis that the machine does not have")]
    UnknownCarrier { solid: String },
    #[error("the plan has no step {0}")]
    StepNotInPlan(u32),
    /// A motion without an N word, after the last block, or in a text that must not contain motions.
    #[error("the motion has no step number (N word)")]
    UnassignedMotion,
    /// Step ids; `expected`: the next step, `None` if all steps are complete.
    #[error("a motion of step {found} is out of order{}", next_step_note(.expected))]
    WrongStepOrder { found: u32, expected: Option<u32> },
    /// Contains the missing part, such as `the touch`.
    #[error("the step ends without {0}")]
    StepIncomplete(&'static str),
    #[error("the program ends before step {0}")]
    ProgramEndsBeforeStep(u32),
    #[error("the motion is in {0}, not in machine coordinates")]
    MotionInWorkFrame(String),
    #[error("the motion moves {0}, but the machine has no axis {0}")]
    UnknownAxis(Axis),
    #[error("the target {axis} {value} is outside the limits [{min}, {max}]")]
    OutsideLimits { axis: Axis, value: f64, min: f64, max: f64 },
    #[error("the feed of {motion_name} is {feed} mm/min; required: {limit} mm/min")]
    WrongFeed { motion_name: &'static str, feed: f64, limit: String },
    #[error(
        "the braking distance from {feed} mm/min is {distance_mm:.2} mm, more than the probe's overtravel of {overtravel} mm"
    )]
    BrakingDistanceTooLong { feed: f64, distance_mm: f64, overtravel: f64 },
    #[error("the touch begins with {0}")]
    WrongTouchStart(PositionMismatch),
    #[error("the move ends with {0}")]
    WrongTarget(PositionMismatch),
    #[error("the touch is {length:.3} mm long, more than the probe's overtravel of {overtravel} mm")]
    TouchTooLong { length: f64, overtravel: f64 },
    #[error("the probing move requires contact (G38.2), but is not the touch of the step")]
    UnexpectedProbingMove,
    #[error("the step contains a second touch")]
    SecondTouchInStep,
    #[error("the stylus ball does not reach the artefact before the touch ends")]
    TouchWithoutContact,
    #[error("the touch would miss {body} if the position of {body} is off by {uncertainty} mm (uncertainty_mm)")]
    TouchCanMiss { body: String, uncertainty: f64 },
    #[error("the touch meets {body} {off_deg:.0}° away from the contact direction of the step (`normal`)")]
    WrongContactSide { body: String, off_deg: f64 },
    #[error("the position of {0} is unknown")]
    UnknownAxisPosition(Axis),
    #[error("another motion comes between the touch and its back-off")]
    MissingBackOff,
    #[error("the back-off from contact must end at the start of the touch, but ends with {0}")]
    WrongBackOffTarget(PositionMismatch),
    #[error("the feed move (G1) is not the back-off from a touch")]
    UnexpectedFeedMove,
    #[error("a rapid before touches have verified the machine position")]
    RapidBeforePositionVerified,
    #[error("a probing move turns an axis before touches have verified the machine position")]
    TurnBeforePositionVerified,
    /// Contains the position of Z and its upper limit.
    #[error(
        "a sideways move or a turn with {0}: until touches have verified the machine position, only Z \
         may move while Z is below its upper limit"
    )]
    SidewaysMoveBelowTopZ(PositionMismatch),
    #[error("a probing move in a scan: a scan must not touch")]
    ProbingMoveInScan,
    #[error("a dwell in a continuous scan")]
    DwellInContinuousScan,
    #[error("a motion in the scan is not part of the path of the scan")]
    OffScanPath,
    #[error("the scan move ends with {0}")]
    WrongScanPoint(PositionMismatch),
    #[error("a stop (M0) outside a prompt")]
    UnexpectedProgramStop,
    #[error("a prompt contains a motion other than a stop (M0)")]
    MotionInPrompt,
    #[error("the program has {0} motions instead of one")]
    MotionCountIsNotOne(usize),
    #[error("the motion moves {0}, which is not the requested axis")]
    MovesUnrequestedAxis(Axis),
    #[error("the move is {length} mm or degrees long, more than the limit of {limit}")]
    MoveTooLong { length: f64, limit: f64 },
    #[error("the jog is neither a guarded move of a linear axis nor a feed move of a rotary axis")]
    UnguardedJog,
    #[error("the retract is not a feed move (G1) of one linear axis")]
    InvalidRetract,
    /// `clearance`: lower bound, at least 0; `min_clearance_mm`: the required clearance.
    #[error(
        "{} would come within {clearance:.3} mm of {}{}", .between[0], .between[1], clearance_note(*.min_clearance_mm)
    )]
    ClearanceTooSmall { between: [String; 2], clearance: f64, min_clearance_mm: f64 },
}

impl RefusalReason {
    /// Refusal of a line outside any step.
    pub(super) fn at_line(self, line: usize) -> ProofRefusal {
        ProofRefusal { step: None, line, reason: self }
    }
}

fn next_step_note(expected: &Option<u32>) -> String {
    match expected {
        Some(step) => format!("; the next step is {step}"),
        None => "; all steps are complete".to_owned(),
    }
}

fn clearance_note(min_clearance_mm: f64) -> String {
    if min_clearance_mm >= MIN_UNGUARDED_CLEARANCE_MM {
        format!("; required for an unguarded or rotary move: {min_clearance_mm} mm")
    } else if min_clearance_mm > 0.0 {
        format!("; required, because the probe does not detect this contact: {min_clearance_mm:.2} mm")
    } else {
        String::new()
    }
}

impl ProofRefusal {
    /// What the operator should do next.
    pub fn remedy(&self) -> &'static str {
        match self.reason {
            RefusalReason::ClearanceTooSmall { .. } => {
                "if the machine is near an obstacle, move it clear by hand; otherwise correct \
                 [artefact], [[solid]], [[keepout]], tool_mm or [probe] in the machine file, or move \
                 the part away"
            }
            RefusalReason::OutsideLimits { .. } => {
                "move the part nearer to the middle of the travel, or correct the limits in [axes]"
            }
            RefusalReason::TouchWithoutContact => "correct [artefact] in the machine file, or locate the part first",
            RefusalReason::TouchCanMiss { .. } => "increase the method's search_mm, or lower [artefact] uncertainty_mm",
            RefusalReason::TouchTooLong { .. } => {
                "set the part up nearer to its position in the machine file and lower [artefact] \
                 uncertainty_mm, or lower the method's distances"
            }
            RefusalReason::BrakingDistanceTooLong { .. } => "lower this feed in [probe] of the machine file",
            RefusalReason::Kinematics(_) | RefusalReason::UnknownCarrier { .. } => {
                "correct [machine], [axes] and [[solid]] in the machine file"
            }
            _ => "the program differs from the plan; report this error with the plan",
        }
    }
}
