//! Proof of a jog: the text of one small move of one axis. During commissioning, it is not known yet which motor is
//! connected to which drive, nor its sense. Therefore no body may be within the margin when *any* axis moves by
//! that amount, in either sense.
//!
//! Proof of a retract: one small step out of contact. No control executes a probing move while its probe reads
//! closed, so a retract is a feed move, which contact does not stop. The operator chooses axis and sense: after an
//! unexpected contact, the machine may not be at its position in the plan.

use super::proven::{ProvenBlock, Unproven, read_block, read_programs};
use super::refusal::{Reason, Refusal};
use super::scene::{ClearanceRule, Scene};
use super::sweep::Way;
use super::{MARGIN_MM, rules};
use crate::gcode::rs274::{Frame, Kind, ReadMotion};
use crate::gcode::{Dialect, Transmission};
use machine::kinematics::Commands;
use machine::record::motion::Block;
use machine::record::plan::Plan;
use machine::record::proof::Clearance;
use machine::{Axis, Position};

/// Maximum length of a jog, mm or degrees.
const LONGEST: f64 = 10.0;
/// Maximum length of a retract, mm.
const LONGEST_RETRACT: f64 = 2.0;

/// The move that a text must contain.
#[derive(Debug, Clone, Copy)]
pub struct JogRequest<'a> {
    /// Machine, probe and bodies.
    pub plan: &'a Plan,
    /// Positions of all axes.
    pub stands: &'a Position,
    pub axis: Axis,
    /// Target of the axis, mm or rad.
    pub to: f64,
    /// Maximum feed, mm/min or degrees/min.
    pub feed_at_most: f64,
    pub dialect: &'a Dialect,
}

/// Renders a jog for its transmission, and proves that it moves this axis alone, to this target, slowly, and
/// without a collision.
///
/// # Errors
/// The jog cannot be rendered; the first line that is wrong; the bodies that would come too near.
pub fn prove_jog(
    request: &JogRequest<'_>,
    transmission: &Transmission,
    block: &Block,
) -> Result<ProvenBlock, Unproven> {
    prove(request, transmission, block, check_jog)
}

/// Renders a retract for its transmission, and proves that it moves this linear axis alone, to this target, by a
/// short slow feed move, and that it approaches no declared body except those in contact at the start.
///
/// # Errors
/// As [`prove_jog`].
pub fn prove_retract(
    request: &JogRequest<'_>,
    transmission: &Transmission,
    block: &Block,
) -> Result<ProvenBlock, Unproven> {
    prove(request, transmission, block, check_retract)
}

type Checked = Result<Option<Clearance>, Refusal>;

fn prove(
    request: &JogRequest<'_>,
    transmission: &Transmission,
    block: &Block,
    check: fn(&JogRequest<'_>, &[String]) -> Checked,
) -> Result<ProvenBlock, Unproven> {
    let axes: Vec<Axis> = request.plan.machine.axes.keys().copied().collect();
    let blocks = std::slice::from_ref(block);
    let sent = request.dialect.transmitted(transmission, &axes, blocks)?;
    check(request, &sent.programs)?;
    read_block(block, request.stands.clone(), request.dialect, transmission, sent)
}

/// Checks a jog. Returns the smallest clearance, if there are bodies.
pub(super) fn check_jog(request: &JogRequest<'_>, programs: &[String]) -> Checked {
    let motion = one_move(request, programs)?;
    let refusal = |reason| Refusal { step: None, line: motion.line, reason };
    check_axis(request, &motion, LONGEST)
        .and_then(|()| check_held_back(request, &motion))
        .map_err(refusal)?;
    free(request, &motion).map_err(refusal)
}

/// Checks a retract, like [`check_jog`].
pub(super) fn check_retract(request: &JogRequest<'_>, programs: &[String]) -> Checked {
    let motion = one_move(request, programs)?;
    let refusal = |reason| Refusal { step: None, line: motion.line, reason };
    check_axis(request, &motion, LONGEST_RETRACT).map_err(refusal)?;
    if motion.kind != Kind::Feed || !request.axis.is_linear() {
        return Err(refusal(Reason::NotARetract));
    }
    let feed_at_most = request.feed_at_most.min(request.plan.probe.search_feed_mm_min);
    rules::feed_at_most("a retract", &motion, feed_at_most).map_err(refusal)?;
    check_approaches_nothing(request, &motion).map_err(refusal)
}

fn one_move(request: &JogRequest<'_>, programs: &[String]) -> Result<ReadMotion, Refusal> {
    let motions = read_programs(request.dialect, programs)?;
    <[ReadMotion; 1]>::try_from(motions).map(|[motion]| motion).map_err(|motions| Refusal {
        step: None,
        line: 1,
        reason: Reason::NotOneMove(motions.len()),
    })
}

/// Checks that the move is of this axis alone, in machine coordinates, to its target, within the limits, and not
/// longer than `longest`, mm or degrees.
fn check_axis(request: &JogRequest<'_>, motion: &ReadMotion, longest: f64) -> Result<(), Reason> {
    let JogRequest { plan, axis, dialect, .. } = *request;
    if let Frame::Work(slot) = &motion.frame {
        return Err(Reason::Frame(slot.clone()));
    }
    if let Some((other, _)) = motion.target.iter().find(|(other, _)| *other != axis) {
        return Err(Reason::OtherAxis(other));
    }
    let meant = Position::new().with(axis, request.to);
    if let Some(off) = rules::differs(&motion.target, &meant, dialect) {
        return Err(off.reason(Reason::NotTo));
    }
    rules::limits(motion, &plan.machine, dialect)?;
    let by = axis.to_edge((request.to - request.stands.at(axis)).abs());
    if by > longest {
        return Err(Reason::LongJog { by, most: longest });
    }
    Ok(())
}

/// Checks that contact stops the move, or that its feed is limited.
fn check_held_back(request: &JogRequest<'_>, motion: &ReadMotion) -> Result<(), Reason> {
    let JogRequest { plan, axis, .. } = *request;
    match motion.kind {
        // Moves of linear axes are guarded: contact stops them.
        Kind::Probe { must_touch: false } if axis.is_linear() => {
            rules::braking(motion, &plan.machine, &plan.probe)?;
        }
        Kind::Feed if !axis.is_linear() => {}
        _ => return Err(Reason::NotGuarded),
    }
    rules::feed_at_most("a jog", motion, request.feed_at_most)
}

/// Checks the clearance for every axis that the drives may actually move.
fn free(request: &JogRequest<'_>, motion: &ReadMotion) -> Result<Option<Clearance>, Reason> {
    let JogRequest { plan, stands, axis, .. } = *request;
    let scene = Scene::new(plan, &plan.artefact)?;
    let from = commands(plan, stands)?;
    let by = axis.to_edge((request.to - stands.at(axis)).abs());
    let mut nearest: Option<Clearance> = None;
    for moved in plan.machine.axes.keys().copied().filter(|moved| *moved != Axis::S) {
        for sense in [-1.0, 1.0] {
            let mut to = from;
            if let Some(command) = to.get_mut(moved as usize) {
                *command += sense * moved.from_edge(by);
            }
            let most = nearest.as_ref().map_or(f64::INFINITY, |nearest| nearest.clearance_mm);
            let found = scene.look(&Way { from, to }, &ClearanceRule::Apart(MARGIN_MM), most)?;
            if let Some((clearance_mm, between)) = found {
                nearest = Some(Clearance { step: 0, line: motion.line, clearance_mm, between });
            }
        }
    }
    Ok(nearest)
}

/// Checks that no declared body is approached, at the assumed position of the machine.
fn check_approaches_nothing(
    request: &JogRequest<'_>,
    motion: &ReadMotion,
) -> Result<Option<Clearance>, Reason> {
    let JogRequest { plan, stands, axis, to, .. } = *request;
    let scene = Scene::new(plan, &plan.artefact)?;
    let way =
        Way { from: commands(plan, stands)?, to: commands(plan, &stands.clone().with(axis, to))? };
    let found = scene.look(&way, &ClearanceRule::Retracting, f64::INFINITY)?;
    let line = motion.line;
    Ok(found.map(|(clearance_mm, between)| Clearance { step: 0, line, clearance_mm, between }))
}

/// Commands of all axes; the spindle, if not oriented, is at zero.
fn commands(plan: &Plan, stands: &Position) -> Result<Commands, Reason> {
    let mut axes = plan.machine.axes.keys();
    match axes.find(|axis| **axis != Axis::S && stands.get(**axis).is_none()) {
        Some(axis) => Err(Reason::Unknown(*axis)),
        None => Ok(Axis::ALL.map(|axis| stands.at(axis))),
    }
}
