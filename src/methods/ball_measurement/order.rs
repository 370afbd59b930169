//! Order of the indexations, and of the balls at each.

use super::indexations::is_parallel;
use super::setup::{Find, MeasurementSetup, Visit};
use crate::Refused;
use machine::record::machine::Machine;
use machine::{Axis, Position};
use planning::{Access, TravelTimes};

/// Orders the balls of each visit along a short path; the order of the visits does not change. If the balls
/// of a visit are searched for first, they are measured on the way back, and the visit ends at the ball where
/// it began.
///
/// # Errors
/// The position of a ball cannot be computed.
pub fn balls_in_order(
    setup: &MeasurementSetup<'_>,
    access: &Access,
    mut visits: Vec<Visit>,
) -> Result<Vec<Visit>, Refused> {
    let back = setup.touch.find == Find::Every;
    let mut stands: Option<Position> = None;
    for visit in &mut visits {
        let balls = visit.balls.iter().filter_map(|index| setup.balls.balls.get(*index));
        let places =
            balls.map(|ball| access.centre(ball, &visit.at)).collect::<Result<Vec<_>, _>>();
        let places = places.map_err(|error| Refused {
            why: error.to_string(),
            instead: "correct [axes] in the machine file".to_owned(),
        })?;
        let order = TravelTimes::in_xy(&places, stands.as_ref(), &setup.plan.machine).tour(1);
        let end = if back { order.first() } else { order.last() };
        stands = end.and_then(|place| places.get(*place)).cloned().or(stands);
        visit.balls = order.iter().filter_map(|place| visit.balls.get(*place).copied()).collect();
    }
    Ok(visits)
}

/// Sorts by tilt. The axis parallel to the spindle sweeps forward at one tilt and backward at the next, so
/// that backlash and drift do not correlate with its angle. The spindle does the same within it.
pub fn in_order(machine: &Machine, visits: Vec<Visit>) -> Vec<Visit> {
    let mut axes: Vec<Axis> = machine.axes.keys().copied().filter(|a| !a.is_linear()).collect();
    axes.sort_by_key(|axis| (*axis == Axis::S, is_parallel(*axis, machine)));
    let mut sorted = visits;
    sweep(&mut sorted, &axes, &mut false);
    sorted
}

/// Sorts by the first of `axes`, and within equal positions by the others, each group in the opposite
/// direction to the one before.
fn sweep(visits: &mut [Visit], axes: &[Axis], backward: &mut bool) {
    let Some((first, rest)) = axes.split_first() else { return };
    let at = |visit: &Visit| visit.at.at(*first);
    visits.sort_by(|a, b| at(a).total_cmp(&at(b)));
    let mut inner = false;
    for run in visits.chunk_by_mut(|a, b| at(a) == at(b)) {
        sweep(run, rest, &mut inner);
    }
    if *backward {
        visits.reverse();
    }
    *backward = !*backward;
}
