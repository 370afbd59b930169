//! Refusals of a proof, and what the operator should do. Nothing has moved.

use super::MARGIN_MM;
use machine::Axis;
use machine::kinematics::KinematicsError;

/// Step, line and reason of a refusal.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{}line {line}: {reason}", of_step(.step))]
pub struct Refusal {
    /// Id and label of the current step; `None` before the first.
    pub step: Option<(u32, String)>,
    /// Line of the text, from 1.
    pub line: usize,
    pub reason: Reason,
}

/// Present and intended position of an axis; mm or degrees.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{axis} at {is}, not at {meant}")]
pub struct Place {
    pub axis: Axis,
    pub is: f64,
    pub meant: f64,
}

fn of_step(step: &Option<(u32, String)>) -> String {
    step.as_ref().map_or(String::new(), |(id, label)| format!("step {id} ({label}), "))
}

/// Reason of a refusal. Lengths in mm, feeds in mm/min; `value`, `min`, `max` in mm or degrees.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Reason {
    #[error("{0}")]
    Unreadable(String),
    #[error("it does not say what was planned: {0}")]
    Differs(String),
    #[error("a line is longer than the control's buffer: `{0}`")]
    LongLine(String),
    #[error(transparent)]
    Kinematics(#[from] KinematicsError),
    #[error("the solid `{solid}` stands on an axis that the machine does not have")]
    Carrier { solid: String },
    #[error("the plan has no step {0}")]
    NoSuchStep(u32),
    #[error("a motion that belongs to no step (no N word)")]
    NoStep,
    #[error("a motion of step {found}, whose turn it is not{}", after(.expected))]
    OutOfTurn { found: u32, expected: Option<u32> },
    #[error("the step ends here without {0}")]
    Unfinished(&'static str),
    #[error("the program ends before step {0} has its turn")]
    Missing(u32),
    #[error("it does not move in machine coordinates, but in {0}")]
    Frame(String),
    #[error("it moves {0}, which the machine does not have")]
    NoAxis(Axis),
    #[error("{axis} would go to {value}, outside [{min}, {max}]")]
    Limit { axis: Axis, value: f64, min: f64, max: f64 },
    #[error("{what} at {feed} mm/min, not {limit} mm/min")]
    Feed { what: &'static str, feed: f64, limit: String },
    #[error(
        "braking from {feed} mm/min takes {way:.2} mm, more than the probe's overtravel of {overtravel} mm"
    )]
    Braking { feed: f64, way: f64, overtravel: f64 },
    #[error("the touch begins with {0}")]
    NotAtFrom(Place),
    #[error("the touch goes to {0}")]
    NotTo(Place),
    #[error("the touch is {length:.3} mm long, the probe's overtravel {overtravel} mm")]
    TooLong { length: f64, overtravel: f64 },
    #[error("a probing move that must make contact (G38.2) but is not the touch of its step")]
    NotATouch,
    #[error("the step touches a second time")]
    SecondTouch,
    #[error("the ball would not reach the artefact before the touch ends")]
    NoContact,
    #[error(
        "the touch would miss {body} where that stands {uncertainty} mm off (its uncertainty_mm)"
    )]
    Misses { body: String, uncertainty: f64 },
    #[error("the touch meets {body}, {off:.0}° away from where its step expects contact")]
    NotAimed { body: String, off: f64 },
    #[error("it is not known where {0} stands")]
    Unknown(Axis),
    #[error("between the touch and its way back something else happens")]
    NotBack,
    #[error("the way back from contact goes to {0} where the touch began")]
    NotBackAt(Place),
    #[error("a feed move (G1) that is not the way back from a touch")]
    FeedMove,
    #[error("a rapid before touches have confirmed where the machine stands")]
    RapidUnconfirmed,
    #[error(
        "a probing move that turns an axis before touches have confirmed where the machine stands"
    )]
    TurnsUnconfirmed,
    #[error(
        "a move aside or a turn with {0}: before touches have confirmed where the machine stands only Z \
         moves below its upper end"
    )]
    AsideBelowTop(Place),
    #[error("a probing move in a scan, where nothing can be touched")]
    ProbeInScan,
    #[error("a rest in a scan whose samples are taken on the way")]
    RestInScan,
    #[error("something else between two points of a scan")]
    OffPath,
    #[error("the scan goes to {0}")]
    NotAtPoint(Place),
    #[error("a stop (M0) where no person is asked")]
    StopsElsewhere,
    #[error("something else than a stop (M0) where a person is asked")]
    MovesInPrompt,
    #[error("{0} motions where one jog is meant")]
    NotOneMove(usize),
    #[error("it moves {0}, which is not the axis that is jogged")]
    OtherAxis(Axis),
    #[error("a jog of {by} mm or degrees; at most {most} are allowed")]
    LongJog { by: f64, most: f64 },
    #[error("a jog that neither contact nor its feed holds back")]
    NotGuarded,
    #[error("a retract that is not a feed move (G1) of one linear axis")]
    NotARetract,
    #[error(
        "{} would come within {clearance:.3} mm of {}{}", .between[0], .between[1], margin(*.need)
    )]
    Near { between: [String; 2], clearance: f64, need: f64 },
}

fn after(expected: &Option<u32>) -> String {
    match expected {
        Some(step) => format!("; step {step} is next"),
        None => "; all steps have had theirs".to_owned(),
    }
}

fn margin(need: f64) -> String {
    if need >= MARGIN_MM {
        format!("; an unguarded or turning move keeps {need} mm")
    } else if need > 0.0 {
        format!("; the probe would not feel it, so {need:.2} mm are kept")
    } else {
        String::new()
    }
}

impl Refusal {
    /// What the operator should do next.
    pub fn remedy(&self) -> &'static str {
        match self.reason {
            Reason::Near { .. } => {
                "if the machine stands near something, move it clear by hand; otherwise correct \
                 [artefact], [[solid]], [[keepout]], tool_mm or [probe] in the machine file, or move \
                 the part away"
            }
            Reason::Limit { .. } => {
                "move the part nearer to the middle, or correct the limits in [axes]"
            }
            Reason::NoContact => {
                "correct [artefact] in the machine file, or let the part be located first"
            }
            Reason::Misses { .. } => {
                "let the touch go further (the method's search_mm), or state a smaller [artefact] \
                 uncertainty_mm"
            }
            Reason::TooLong { .. } => {
                "lower [artefact] uncertainty_mm (set the part up nearer to where the file says) or \
                 the method's distances"
            }
            Reason::Braking { .. } => "lower the feed named, in [probe] of the machine file",
            Reason::Kinematics(_) | Reason::Carrier { .. } => {
                "correct [machine], [axes] and [[solid]] in the machine file"
            }
            _ => "the program does not say what the plan means: please report this with the plan",
        }
    }
}
