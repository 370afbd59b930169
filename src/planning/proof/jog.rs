//! A jog on its own: the text of one small move of one axis. While a machine is commissioned it is
//! not known yet which motor hangs at which drive, nor which way round. So nothing may stand within
//! the margin wherever that much of *any* axis, in either sense, would carry something.
//!
//! And the retract: one small step out of contact. No control executes a probing move while its probe
//! reads closed, so it is a feed move, which a contact does not stop. A person chooses axis and sense:
//! after an unexpected contact the machine may not be where the plan has it.

use super::proven::{ProvenBlock, Unproven, read_block, read_programs};
use super::refusal::{Reason, Refusal};
use super::scene::{Care, Scene};
use super::sweep::Way;
use super::{MARGIN_MM, rules};
use crate::gcode::rs274::{Frame, Kind, ReadMotion};
use crate::gcode::{Dialect, Transmission};
use machine::kinematics::Commands;
use machine::record::motion::Block;
use machine::record::plan::Plan;
use machine::record::proof::Clearance;
use machine::{Axis, Position};

/// No jog is longer, mm or degrees.
const LONGEST: f64 = 10.0;
/// No retract is longer, mm.
const LONGEST_RETRACT: f64 = 2.0;

/// The move that a text must say.
#[derive(Debug, Clone, Copy)]
pub struct JogRequest<'a> {
    /// Machine, probe and bodies.
    pub plan: &'a Plan,
    /// Where all axes stand.
    pub stands: &'a Position,
    pub axis: Axis,
    /// Where it goes, mm or rad.
    pub to: f64,
    /// mm or degrees a minute.
    pub feed_at_most: f64,
    pub dialect: &'a Dialect,
}

/// Render a jog as it is sent, and prove that it moves this axis alone, to this place, slowly, and that
/// nothing meets.
///
/// # Errors
/// What cannot be written; the first line that is wrong; whatever would come near.
pub fn prove_jog(
    request: &JogRequest<'_>,
    transmission: &Transmission,
    block: &Block,
) -> Result<ProvenBlock, Unproven> {
    prove(request, transmission, block, check_jog)
}

/// Render a retract as it is sent, and prove that it moves this linear axis alone, to this place, by a
/// short slow feed move, and that it approaches no declared body that is not already met at the start.
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

/// The smallest clearance, if there are bodies.
pub(super) fn check_jog(request: &JogRequest<'_>, programs: &[String]) -> Checked {
    let motion = one_move(request, programs)?;
    let refusal = |reason| Refusal { step: None, line: motion.line, reason };
    check_axis(request, &motion, LONGEST)
        .and_then(|()| check_held_back(request, &motion))
        .map_err(refusal)?;
    free(request, &motion).map_err(refusal)
}

/// As [`check_jog`], of a retract.
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

/// The move is of this axis alone, in machine coordinates, to its place, within the limits and not longer
/// than `longest`, mm or degrees.
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

/// Contact or its feed holds the move back.
fn check_held_back(request: &JogRequest<'_>, motion: &ReadMotion) -> Result<(), Reason> {
    let JogRequest { plan, axis, .. } = *request;
    match motion.kind {
        // Linear axes are guarded: contact stops them.
        Kind::Probe { must_touch: false } if axis.is_linear() => {
            rules::braking(motion, &plan.machine, &plan.probe)?;
        }
        Kind::Feed if !axis.is_linear() => {}
        _ => return Err(Reason::NotGuarded),
    }
    rules::feed_at_most("a jog", motion, request.feed_at_most)
}

/// Whatever the drives move in truth.
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
            let found = scene.look(&Way { from, to }, &Care::Apart(MARGIN_MM), most)?;
            if let Some((clearance_mm, between)) = found {
                nearest = Some(Clearance { step: 0, line: motion.line, clearance_mm, between });
            }
        }
    }
    Ok(nearest)
}

/// Nothing declared is approached where the machine is thought to be.
fn check_approaches_nothing(
    request: &JogRequest<'_>,
    motion: &ReadMotion,
) -> Result<Option<Clearance>, Reason> {
    let JogRequest { plan, stands, axis, to, .. } = *request;
    let scene = Scene::new(plan, &plan.artefact)?;
    let way =
        Way { from: commands(plan, stands)?, to: commands(plan, &stands.clone().with(axis, to))? };
    let found = scene.look(&way, &Care::Retracting, f64::INFINITY)?;
    let line = motion.line;
    Ok(found.map(|(clearance_mm, between)| Clearance { step: 0, line, clearance_mm, between }))
}

/// Of all axes; the spindle, which nobody has oriented, at zero.
fn commands(plan: &Plan, stands: &Position) -> Result<Commands, Reason> {
    let mut axes = plan.machine.axes.keys();
    match axes.find(|axis| **axis != Axis::S && stands.get(**axis).is_none()) {
        Some(axis) => Err(Reason::Unknown(*axis)),
        None => Ok(Axis::ALL.map(|axis| stands.at(axis))),
    }
}
