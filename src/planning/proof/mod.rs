//! What must hold before a stage may move. It looks at the *rendered text as read back*
//! and at the plan's steps, never at what the planner meant: a slip anywhere between step and text
//! is seen here. It moves nothing.
//!
//! It holds of a proven text that
//! - every motion belongs to the step whose turn it is, in machine coordinates, within the limits;
//! - each step touches once: from its `from` to its `to`, at its feed, no longer than the probe's
//!   overtravel; the ball stands clear of the artefact at `from`, wherever within its uncertainty
//!   that is, and contact with the nominal artefact comes before `to`; then straight back to `from`;
//! - of an artefact of several bodies the touch means the one that its line meets first. A ball is met
//!   wherever within its uncertainty it stands, and on the side that the step's `normal` says; all
//!   other balls and stems are strangers, whom the full length of the touch passes;
//! - each scan goes through its points one after the other, at its feed, and rests at each where it
//!   takes samples; nothing of it touches, and all of it keeps [`MARGIN_MM`] as a rapid does; where its
//!   sensors are on the table, the ball in the spindle comes as near to them as their range allows, so slowly
//!   that a hold stops it there;
//! - a prompt is one stop (M0) and nothing else; from there on it is not known where the machine stands;
//! - there is no other feed move; guarded moves (probing moves that are not the touch) stay clear of
//!   everything and stop within the overtravel if they should meet something all the same;
//! - until touches along three independent normals have confirmed where the machine stands, or a scan
//!   has, there is no rapid, and all of the way to a step is careful ([`careful`]);
//! - what the probe is not there to feel stays half a millimetre apart on guarded moves and touches:
//!   it feels the artefact, stems included, with the ball and the stem of its stylus alone;
//! - rapids and turns of a rotary axis or the spindle keep [`MARGIN_MM`] from everything, and every
//!   step ends that far away.
//!
//! The artefact is grown by its uncertainty, each of its bodies. During a touch only what rides on
//! the spindle may be nearer, only to the body that is meant and its stem (which stands off as its
//! ball does), and only as far as contact lets it come ([`touch`]).
//!
//! Bodies: stylus ball, stem, probe body (or, in their place, the body of a sensor) and the solids of the tool side against artefact, keep-out
//! boxes and the solids of the workpiece side and the bed; workpiece side against bed; and on one
//! side whatever an axis moves against each other. Neighbours on one side that with all axes at zero
//! stand nearer than the margin are *not* looked at: they are joined or built close, and the proof
//! names them (but for the nose and what it holds). What the same axes move stands still against
//! each other. Errors of the machine are far below the margin and not looked at either. The spindle's
//! axis is Z; a spindle that nobody orients stands as `tool_mm` was measured.
//!
//! Whether the identification is well-posed is the method's matter: `Method::next` refuses what it
//! could not solve before the first stage, and nothing is rendered.

mod body;
mod careful;
#[doc(hidden)]
pub mod for_tests;
mod gap;
mod jog;
mod modes;
mod pairs;
mod proven;
mod refusal;
mod rules;
mod scan;
mod scene;
mod sweep;
mod touch;
mod walk;

#[cfg(test)]
mod ball_tests;
#[cfg(test)]
mod careful_tests;
#[cfg(test)]
mod jog_tests;
#[cfg(test)]
mod scan_tests;
#[cfg(test)]
mod tests;

pub use jog::{JogRequest, prove_jog, prove_retract};
pub use modes::{ProvenModes, prove_modes};
pub use proven::{Altered, ProvenBlock, ProvenUnit, StageRequest, Unproven, prove_blocks};
pub use refusal::{Reason, Refusal};

use crate::Confirmed;
use crate::gcode::Dialect;
use crate::gcode::rs274::ReadMotion;
use machine::Position;
use machine::record::artefact::Artefact;
use machine::record::plan::Plan;
use machine::record::proof::Proof;
use proven::read_programs;

/// Distance that rapids and turning axes keep from everything, mm.
pub const MARGIN_MM: f64 = 2.0;

/// A text, and what it must say.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    pub plan: &'a Plan,
    /// One for each stage in the text, in order.
    pub stages: &'a [Staged<'a>],
    /// Where the machine stands at the start, as far as it is known. What moves before X, Y and Z
    /// are known is not looked at, and the proof says so.
    pub stands: Option<&'a Position>,
    /// What was confirmed since the machine was prepared.
    pub confirmed: Confirmed,
    pub dialect: &'a Dialect,
    /// Programs that are executed one after the other; each sets the modes that it needs.
    pub programs: &'a [String],
}

/// The steps of one stage.
#[derive(Debug, Clone, Copy)]
pub struct Staged<'a> {
    /// Ids in the order in which they must be run; they stand in the plan.
    pub steps: &'a [u32],
    /// Where the artefact was found; `None`: where the plan says.
    pub found: Option<&'a Artefact>,
}

/// Does the text do what the steps say, and does nothing meet that must not?
///
/// # Errors
/// The first line that is wrong or cannot be shown to be right.
pub fn prove(request: &Request<'_>) -> Result<Proof, Refusal> {
    prove_motions(request, read_programs(request.dialect, request.programs)?)
}

/// As [`prove`], of the programs as they were read back.
fn prove_motions(request: &Request<'_>, motions: Vec<ReadMotion>) -> Result<Proof, Refusal> {
    walk::Walk::begin(request, motions)?.through()
}
