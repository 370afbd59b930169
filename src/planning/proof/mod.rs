//! Proof of a stage before it may move. The proof checks the *rendered text as read back* against the plan's steps,
//! not the planner's intent: it detects an error anywhere between step and text. It moves nothing.
//!
//! A proven text has these properties:
//! - Every motion belongs to the step whose turn it is, in machine coordinates, within the limits.
//! - Each step touches once: from its `from` to its `to`, at its feed, not longer than the probe's overtravel. At
//!   `from`, the stylus ball is clear of the artefact, wherever the artefact is within its uncertainty; contact
//!   with the nominal artefact occurs before `to`. Then the ball moves straight back to `from`.
//! - In an artefact of several bodies, the touch is aimed at the body that its line meets first. The touch meets
//!   that ball at every position within its uncertainty, and on the side of the step's `normal`. The full length of
//!   the touch avoids all other balls and stems.
//! - Each scan reaches its points one after the other, at its feed, and rests at each point where it takes samples.
//!   No part of it touches, and all of it keeps [`MIN_UNGUARDED_CLEARANCE_MM`] as a rapid does. If its sensors are on
//!   the table, the ball in the spindle may be as near to them as their range allows, at a feed from which a hold
//!   stops it within that range.
//! - A prompt is one stop (M0) and nothing else; after it, the position of the machine is unknown.
//! - There is no other feed move. Guarded moves (probing moves other than the touch) stay clear of everything, and
//!   stop within the overtravel if they meet an obstacle nevertheless.
//! - Until a scan, or touches along three independent normals, have verified the position of the machine, there is
//!   no rapid, and the whole approach to a step is careful ([`unverified_position_rules`]).
//! - Pairs of bodies whose contact the probe cannot detect stay half a millimetre apart on guarded moves and
//!   touches. The probe detects contact of the stylus ball and stylus stem with the artefact, including its stems.
//! - Rapids and turns of a rotary axis or the spindle keep [`MIN_UNGUARDED_CLEARANCE_MM`] from everything, and every
//!   step ends with that distance.
//!
//! Each body of the artefact is enlarged by its uncertainty. During a touch, only parts that move with the spindle
//! may be nearer, only to the touched body and its stem (which is displaced like its ball), and only as far as
//! contact allows ([`touch`]).
//!
//! Checked pairs: stylus ball, stem, probe body (or, in their place, the body of a sensor) and the solids of the
//! tool side against the artefact, keep-out boxes and the solids of the workpiece side and the bed; the workpiece
//! side against the bed; and on one side, all bodies that an axis moves relative to each other. Neighbours on one
//! side that are nearer than the margin with all axes at zero are *not* checked, because they are joined or built
//! close; the proof lists them (except the nose and the parts that it holds). Bodies that the same axes move do not
//! move relative to each other. Errors of the machine are far below the margin and are not considered. The
//! spindle's axis is Z; a spindle that cannot be oriented has the orientation at which `tool_mm` was measured.
//!
//! The conditioning of the identification is checked by the method: `Method::next_stage` refuses an unsolvable plan
//! before the first stage, and nothing is rendered.

mod body;
mod body_gap;
mod collision_pairs;
mod collision_scene;
#[doc(hidden)]
pub mod for_tests;
mod jog;
mod motion_rules;
mod program_check;
mod proven_blocks;
mod proven_mode_text;
mod refusal;
mod scan;
mod sweep;
mod touch;
mod unverified_position_rules;

#[cfg(test)]
mod ball_tests;
#[cfg(test)]
mod jog_tests;
#[cfg(test)]
mod scan_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod unverified_position_rules_tests;

pub use jog::{SingleMoveKind, SingleMoveProofRequest, prove_single_move};
pub use proven_blocks::{AlteredBlockError, ProvenBlock, ProvenUnit, StageProofError, prove_blocks};
pub use proven_mode_text::{ProvenModeText, render_and_prove_mode_text};
pub use refusal::{ProofRefusal, RefusalReason};

use crate::TouchedDirections;
use crate::gcode::Dialect;
use crate::gcode::rs274::ReadMotion;
use machine::Position;
use machine::record::artefact::Artefact;
use machine::record::plan::Plan;
use machine::record::stage_proof::StageProof;
use proven_blocks::read_back_programs;

/// Minimum clearance of rapids and turning axes from everything, mm.
pub const MIN_UNGUARDED_CLEARANCE_MM: f64 = 2.0;

/// The steps that a text must contain, and the state in which it begins.
#[derive(Debug, Clone, Copy)]
pub struct ProofRequest<'a> {
    pub plan: &'a Plan,
    /// Steps of each stage in the text, in order.
    pub stages: &'a [StageSteps<'a>],
    /// Position of the machine at the start, as far as it is known. Moves before the positions of all axes except the
    /// spindle are known are not checked for collisions, and the proof reports them.
    pub start_position: Option<&'a Position>,
    /// Directions in which touches have met the part since the machine was prepared or the operator was last
    /// prompted.
    pub touched_directions: TouchedDirections,
    pub dialect: &'a Dialect,
}

/// The steps of one stage.
#[derive(Debug, Clone, Copy)]
pub struct StageSteps<'a> {
    /// Ids of the steps, in the order of the run; the plan contains these steps.
    pub step_ids: &'a [u32],
    /// The artefact at its found position; `None`: at its position in the plan.
    pub found_artefact: Option<&'a Artefact>,
}

/// Proves that `programs` contain exactly the steps of the stages, and that no bodies collide. The programs are
/// executed one after the other; each sets the modes that it needs.
///
/// # Errors
/// The first line that is wrong or cannot be proven.
pub fn prove_programs(request: &ProofRequest<'_>, programs: &[String]) -> Result<StageProof, ProofRefusal> {
    prove_read_motions(request, read_back_programs(request.dialect, programs)?)
}

/// Like [`prove_programs`], for programs that were read back already.
fn prove_read_motions(request: &ProofRequest<'_>, motions: Vec<ReadMotion>) -> Result<StageProof, ProofRefusal> {
    program_check::ProgramCheck::begin(request, motions)?.check_all_motions()
}
