//! One touch as a safe sequence of motions.

use super::careful::{UnconfirmedApproach, near_feed};
use super::confirmed::Start;
use super::path::{Path, SAME, height};
use super::{Clearance, PlanningError, limits, over_balls};
use machine::record::motion::{Block, Motion};
use machine::record::plan::{Plan, Step, StepKind};
use machine::{Axis, Position};

/// The motions of one touch: up to a safe height, turn the rotary axes and the spindle, move above the start,
/// guarded down to `from`, dwell if the probe requires it, touch towards `to`, back off to `from`, guarded up
/// again. A move to the present position is omitted. Near the artefact, all moves but the back-off are guarded.
/// Until touches have confirmed the position of the machine, all moves are careful ([`super::careful`]), and near
/// the artefact they use the search feed.
///
/// Between two touches of a round part, the path leads over its top. Between two touches of a ball, it leads round
/// the ball, or otherwise as high as necessary ([`super::over_balls`]); the block ends beside the ball, or above
/// all near obstacles.
///
/// The back-off ends at `from`, the only point that is certainly out of contact. So that the back-off is never
/// longer than the probe's overtravel, the touch must not be longer either.
///
/// # Errors
/// The step is not a complete touch; the touch is longer than the overtravel; a position is out of travel; for
/// balls, the spindle is not upright.
pub fn touch_block(
    plan: &Plan,
    step: &Step,
    repeat: u32,
    start: Start<'_>,
    clearance: &Clearance,
) -> Result<Block, PlanningError> {
    check_step(plan, step)?;
    check_guarded_feed(plan)?;
    let (near_feed, back_feed) = (near_feed(plan, start.confirmed), plan.probe.search_feed_mm_min);
    let (from, to) = (&step.from, &step.to);
    let mut path = Path::from(start.stands, near_feed);
    let end = match clearance.over_all {
        Some(safe_z) => over_the_part(&mut path, (plan, step), start, (clearance, safe_z)),
        None => over_balls::approach(&mut path, (plan, step), start, clearance)?,
    };
    path.guarded(&height(from.at(Axis::Z)));
    if plan.probe.settle_s > 0.0 {
        path.motions.push(Motion::Dwell { seconds: plan.probe.settle_s });
    }
    path.feed(&to.only(Axis::is_linear), |to| Motion::Probe { to, feed_mm_min: step.feed_mm_min });
    path.feed(&from.only(Axis::is_linear), |to| Motion::BackOff { to, feed_mm_min: back_feed });
    path.guarded(&end);

    let block = Block { step: step.id, repeat, motions: path.motions };
    limits::check(&block, &plan.machine)?;
    Ok(block)
}

/// Plans the path above the start of the touch. Returns the position at which the block ends.
fn over_the_part(
    path: &mut Path,
    (plan, step): (&Plan, &Step),
    start: Start<'_>,
    (clearance, safe_z): (&Clearance, f64),
) -> Position {
    let (from, to) = (&step.from, &step.to);
    let safe_z = safe_z.max(from.at(Axis::Z)).max(to.at(Axis::Z));
    if !start.confirmed.is_all() {
        UnconfirmedApproach::new(plan, clearance, safe_z, start.confirmed).over(path, from);
        return height(safe_z);
    }
    match path.stands.get(Axis::Z) {
        Some(z) if z >= safe_z => {}
        Some(_) => path.guarded(&height(safe_z)),
        None => path.rapid(&height(clearance.top_z.max(safe_z))),
    }
    path.rapid(&from.only(|axis| !axis.is_linear() && axis != Axis::S));
    path.orient(from.get(Axis::S));
    path.rapid(&from.only(|axis| matches!(axis, Axis::X | Axis::Y)));
    path.rapid(&height(safe_z));
    height(safe_z)
}

fn check_step(plan: &Plan, step: &Step) -> Result<(), PlanningError> {
    let id = step.id;
    if !matches!(step.kind, StepKind::Touch | StepKind::Reference) {
        return Err(PlanningError::NotATouch { step: id });
    }
    let named = |position: &Position, axis: Axis| {
        position.get(axis).ok_or(PlanningError::Incomplete { step: id, axis })
    };
    let mut square = 0.0;
    for axis in Axis::LINEAR {
        square += (named(&step.to, axis)? - named(&step.from, axis)?).powi(2);
    }
    for axis in plan.machine.axes.keys().filter(|axis| !axis.is_linear() && **axis != Axis::S) {
        named(&step.from, *axis)?;
    }
    let turned = step.to.iter().find(|(axis, value)| {
        !axis.is_linear() && step.from.get(*axis).is_none_or(|from| (from - value).abs() > SAME)
    });
    if let Some((axis, _)) = turned {
        return Err(PlanningError::Turns { step: id, axis });
    }
    let (length, overtravel) = (square.sqrt(), plan.probe.overtravel_mm);
    if length > overtravel + SAME {
        return Err(PlanningError::TooLong { step: id, length, overtravel });
    }
    if length > SAME { Ok(()) } else { Err(PlanningError::NoLength { step: id }) }
}

/// A guarded move that meets an obstacle must stop within the probe's overtravel, for every linear axis.
fn check_guarded_feed(plan: &Plan) -> Result<(), PlanningError> {
    let (feed, overtravel) = (plan.probe.guarded_feed_mm_min, plan.probe.overtravel_mm);
    let axes = plan.machine.axes.iter().filter(|(axis, _)| axis.is_linear());
    let weakest = axes.map(|(_, spec)| spec.acceleration_per_s2).fold(f64::INFINITY, f64::min);
    let way = (feed / 60.0).powi(2) / (2.0 * weakest);
    if way <= overtravel {
        Ok(())
    } else {
        Err(PlanningError::GuardTooFast { feed, way, overtravel })
    }
}
