//! A jog on its own: the text of one small move of one axis. While a machine is commissioned it is
//! not known yet which motor hangs at which drive, nor which way round. So nothing may stand within
//! the margin wherever that much of *any* axis, in either sense, would carry something.

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
    let axes: Vec<Axis> = request.plan.machine.axes.keys().copied().collect();
    let blocks = std::slice::from_ref(block);
    let sent = request.dialect.transmitted(transmission, &axes, blocks)?;
    check_jog(request, &sent.programs)?;
    read_block(block, request.stands.clone(), request.dialect, transmission, sent)
}

/// The smallest clearance, if there are bodies.
pub(super) fn check_jog(
    request: &JogRequest<'_>,
    programs: &[String],
) -> Result<Option<Clearance>, Refusal> {
    let at = |line| move |reason| Refusal { step: None, line, reason };
    let motions = read_programs(request.dialect, programs)?;
    let [motion] = motions.as_slice() else {
        return Err(at(1)(Reason::NotOneMove(motions.len())));
    };
    said(request, motion).map_err(at(motion.line))?;
    free(request, motion).map_err(at(motion.line))
}

/// The words of the move.
fn said(request: &JogRequest<'_>, motion: &ReadMotion) -> Result<(), Reason> {
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
    if by > LONGEST {
        return Err(Reason::LongJog { by, most: LONGEST });
    }
    let clamped = plan.machine.axes.get(&axis).is_some_and(|spec| spec.clamp.is_some());
    match motion.kind {
        // Linear axes are guarded: contact stops them.
        Kind::Probe { must_touch: false } if axis.is_linear() => {
            rules::braking(motion, &plan.machine, &plan.probe)?;
        }
        Kind::Feed if !axis.is_linear() => {}
        // A clamp opens for rapids alone.
        Kind::Rapid if clamped => return Ok(()),
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

/// Of all axes; the spindle, which nobody has oriented, at zero.
fn commands(plan: &Plan, stands: &Position) -> Result<Commands, Reason> {
    let mut axes = plan.machine.axes.keys();
    match axes.find(|axis| **axis != Axis::S && stands.get(**axis).is_none()) {
        Some(axis) => Err(Reason::Unknown(*axis)),
        None => Ok(Axis::ALL.map(|axis| stands.at(axis))),
    }
}
