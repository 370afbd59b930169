//! Proof of a jog: the text of one small move of one axis. During commissioning, it is not known yet which motor is
//! connected to which drive, nor its sense. Therefore no body may be within the margin when *any* axis moves by
//! that amount, in either sense.
//!
//! Proof of a retract: one small step out of contact. No control executes a probing move while its probe reads
//! closed, so a retract is a feed move, which contact does not stop. The operator chooses axis and sense: after an
//! unexpected contact, the machine may not be at its position in the plan.

use super::collision_scene::{ClearanceRule, CollisionScene};
use super::motion_rules;
use super::proven_blocks::{ProvenBlock, StageProofError, read_back_block, read_back_programs};
use super::refusal::{ProofRefusal, RefusalReason};
use super::sweep::JointPath;
use crate::gcode::rs274::{MotionFrame, MotionKind, ReadMotion};
use crate::gcode::{Dialect, TransmissionForm};
use machine::record::motion::MotionBlock;
use machine::record::plan::Plan;
use machine::record::stage_proof::Clearance;
use machine::{Axis, Position};

/// Maximum length of a jog, mm or degrees.
const MAX_JOG_LENGTH_MM_OR_DEG: f64 = 10.0;
/// Maximum length of a retract, mm.
const MAX_RETRACT_LENGTH_MM: f64 = 2.0;

/// Kind of a move whose text is proven on its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SingleMoveKind {
    /// A slow move that keeps [`super::MIN_UNGUARDED_CLEARANCE_MM`] from every body, whichever axis except the
    /// spindle the drives actually move, in either sense. A move of a linear axis is guarded.
    Jog,
    /// A short slow feed move of a linear axis. Bodies nearer than [`super::MIN_UNGUARDED_CLEARANCE_MM`] at the start
    /// must not come nearer; pairs that intersect there are not checked.
    Retract,
}

/// The move that a text must contain.
#[derive(Debug, Clone, Copy)]
pub struct SingleMoveProofRequest<'a> {
    pub kind: SingleMoveKind,
    /// Machine, probe and bodies.
    pub plan: &'a Plan,
    /// Positions of all axes, mm and rad; only the spindle may be missing.
    pub start_position: &'a Position,
    pub axis: Axis,
    /// Target of the axis, mm or rad.
    pub target_mm_or_rad: f64,
    /// Maximum feed, mm/min or degrees/min; for a retract, the search feed of the probe is also a limit.
    pub max_feed_mm_or_deg_per_min: f64,
    pub dialect: &'a Dialect,
}

/// Renders a jog or retract for its transmission, and proves that it moves this axis alone, to this target, as
/// [`SingleMoveKind`] requires.
///
/// # Errors
/// The move cannot be rendered; the first line that is wrong; the bodies that would come too near.
pub fn prove_single_move(
    request: &SingleMoveProofRequest<'_>,
    transmission: &TransmissionForm,
    block: &MotionBlock,
) -> Result<ProvenBlock, StageProofError> {
    let axes: Vec<Axis> = request.plan.machine.axes.keys().copied().collect();
    let blocks = std::slice::from_ref(block);
    let sent = request.dialect.render_for_transmission(transmission, &axes, blocks)?;
    check_single_move(request, &sent.programs_to_read_back)?;
    read_back_block(block, request.start_position.clone(), request.dialect, transmission, sent)
}

/// Checks the line of a move against its request and the bodies. Returns the smallest clearance, if there are bodies.
pub(super) fn check_single_move(
    request: &SingleMoveProofRequest<'_>,
    programs: &[String],
) -> Result<Option<Clearance>, ProofRefusal> {
    let motions = read_back_programs(request.dialect, programs)?;
    let [motion] = motions.as_slice() else {
        return Err(RefusalReason::MotionCountIsNotOne(motions.len()).at_line(1));
    };
    let checked = match request.kind {
        SingleMoveKind::Jog => check_jog(request, motion),
        SingleMoveKind::Retract => check_retract(request, motion),
    };
    checked.map_err(|reason| reason.at_line(motion.line))
}

/// Smallest clearance on the checked paths; `None`: no pair of bodies counts.
type MinClearanceResult = Result<Option<Clearance>, RefusalReason>;

fn check_jog(request: &SingleMoveProofRequest<'_>, motion: &ReadMotion) -> MinClearanceResult {
    check_single_axis_move(request, motion, MAX_JOG_LENGTH_MM_OR_DEG)?;
    check_guard_and_feed(request, motion)?;
    check_clearance_of_any_axis(request, motion)
}

fn check_retract(request: &SingleMoveProofRequest<'_>, motion: &ReadMotion) -> MinClearanceResult {
    check_single_axis_move(request, motion, MAX_RETRACT_LENGTH_MM)?;
    if motion.kind != MotionKind::Feed || !request.axis.is_linear() {
        return Err(RefusalReason::InvalidRetract);
    }
    let max_feed = request.max_feed_mm_or_deg_per_min.min(request.plan.probe.search_feed_mm_min);
    motion_rules::check_max_feed("the retract", motion, max_feed)?;
    check_retract_clearance(request, motion)
}

/// Checks that the move is of this axis alone, in machine coordinates, to its target, within the limits, and not
/// longer than `longest`, mm or degrees.
fn check_single_axis_move(
    request: &SingleMoveProofRequest<'_>,
    motion: &ReadMotion,
    longest: f64,
) -> Result<(), RefusalReason> {
    let SingleMoveProofRequest { plan, axis, dialect, .. } = *request;
    if let MotionFrame::Work(slot) = &motion.frame {
        return Err(RefusalReason::MotionInWorkFrame(slot.clone()));
    }
    if let Some((other, _)) = motion.target.iter().find(|(other, _)| *other != axis) {
        return Err(RefusalReason::MovesUnrequestedAxis(other));
    }
    let meant = Position::new().with(axis, request.target_mm_or_rad);
    if let Some(off) = motion_rules::find_axis_mismatch(&motion.target, &meant, dialect) {
        return Err(off.into_refusal_reason(RefusalReason::WrongTarget));
    }
    motion_rules::check_axis_limits(motion, &plan.machine, dialect)?;
    let by = axis.to_mm_or_deg((request.target_mm_or_rad - request.start_position.get_or_zero(axis)).abs());
    if by > longest {
        return Err(RefusalReason::MoveTooLong { length: by, limit: longest });
    }
    Ok(())
}

/// Checks the feed, and that a linear axis makes a guarded move that stops within the overtravel, a rotary axis a feed
/// move.
fn check_guard_and_feed(request: &SingleMoveProofRequest<'_>, motion: &ReadMotion) -> Result<(), RefusalReason> {
    let SingleMoveProofRequest { plan, axis, .. } = *request;
    match motion.kind {
        // Moves of linear axes are guarded: contact stops them.
        MotionKind::Probe { must_touch: false } if axis.is_linear() => {
            motion_rules::braking_distance_within_overtravel_mm(motion, &plan.machine, &plan.probe)?;
        }
        MotionKind::Feed if !axis.is_linear() => {}
        _ => return Err(RefusalReason::UnguardedJog),
    }
    motion_rules::check_max_feed("the jog", motion, request.max_feed_mm_or_deg_per_min)
}

/// Checks the clearance for every axis that the drives may actually move, in both senses; the spindle is left out.
fn check_clearance_of_any_axis(request: &SingleMoveProofRequest<'_>, motion: &ReadMotion) -> MinClearanceResult {
    let SingleMoveProofRequest { plan, start_position: position, axis, .. } = *request;
    let scene = CollisionScene::new(plan, &plan.artefact)?;
    let from = motion_rules::axis_commands(&plan.machine, position)?;
    let by = axis.to_mm_or_deg((request.target_mm_or_rad - position.get_or_zero(axis)).abs());
    let mut nearest: Option<Clearance> = None;
    for moved in plan.machine.axes.keys().copied().filter(|moved| *moved != Axis::S) {
        for sense in [-1.0, 1.0] {
            let mut to = from;
            to[moved as usize] += sense * moved.to_mm_or_rad(by);
            let most = nearest.as_ref().map_or(f64::INFINITY, |nearest| nearest.clearance_mm);
            let nearest_pair =
                scene.check_path_and_find_nearest_pair(&JointPath { from, to }, &ClearanceRule::UnguardedMove, most)?;
            if let Some((clearance_mm, between)) = nearest_pair {
                nearest = Some(Clearance { step: 0, line: motion.line, clearance_mm, between });
            }
        }
    }
    Ok(nearest)
}

/// Checks the rule [`ClearanceRule::Retract`] at the assumed position of the machine.
fn check_retract_clearance(request: &SingleMoveProofRequest<'_>, motion: &ReadMotion) -> MinClearanceResult {
    let SingleMoveProofRequest { plan, start_position: position, axis, target_mm_or_rad: to, .. } = *request;
    let scene = CollisionScene::new(plan, &plan.artefact)?;
    let joint_path = JointPath {
        from: motion_rules::axis_commands(&plan.machine, position)?,
        to: motion_rules::axis_commands(&plan.machine, &position.clone().with(axis, to))?,
    };
    let nearest_pair = scene.check_path_and_find_nearest_pair(&joint_path, &ClearanceRule::Retract, f64::INFINITY)?;
    let line = motion.line;
    Ok(nearest_pair.map(|(clearance_mm, between)| Clearance { step: 0, line, clearance_mm, between }))
}
