//! Order of the indexations, and of the balls at each.

use super::indexations::is_parallel_to_spindle;
use super::setup::{BallVisit, MeasurementSetup, SearchMode};
use crate::MethodRefusal;
use machine::record::machine::Machine;
use machine::{Axis, Position};
use planning::{TouchAccess, TravelTimes};

/// Orders the balls of each visit along a short path; the order of the visits does not change. If the balls
/// of a visit are searched for first, they are measured on the way back, and the visit ends at the ball where
/// it began.
///
/// # Errors
/// The position of a ball cannot be computed.
pub fn order_balls_in_xy(
    setup: &MeasurementSetup<'_>,
    access: &TouchAccess,
    mut visits: Vec<BallVisit>,
) -> Result<Vec<BallVisit>, MethodRefusal> {
    let back = setup.touch_settings.search_mode == SearchMode::Every;
    let mut machine_position: Option<Position> = None;
    for visit in &mut visits {
        let balls = visit.ball_indices.iter().filter_map(|index| setup.balls.balls.get(*index));
        let places = balls
            .map(|ball| access.axis_positions_at_ball_centre(ball, &visit.rotary_position))
            .collect::<Result<Vec<_>, _>>();
        let places =
            places.map_err(|error| MethodRefusal::new(error.to_string(), "correct [axes] in the machine file"))?;
        let order =
            TravelTimes::from_xy_positions(&places, machine_position.as_ref(), &setup.plan.machine).visiting_order(1);
        let end = if back { order.first() } else { order.last() };
        machine_position = end.and_then(|place| places.get(*place)).cloned().or(machine_position);
        visit.ball_indices = order.iter().filter_map(|place| visit.ball_indices.get(*place).copied()).collect();
    }
    Ok(visits)
}

/// Sorts by tilt. The axis parallel to the spindle sweeps forward at one tilt and backward at the next, so that
/// backlash and drift do not correlate with its angle. At each of its positions the spindle sweeps in the same way.
pub fn order_visits(machine: &Machine, mut visits: Vec<BallVisit>) -> Vec<BallVisit> {
    let mut axes: Vec<Axis> = machine.axes.keys().copied().filter(|a| !a.is_linear()).collect();
    axes.sort_by_key(|axis| (*axis == Axis::S, is_parallel_to_spindle(*axis, machine)));
    sort_alternating(&mut visits, &axes, &mut false);
    visits
}

/// Sorts by the first of `axes`, and within equal positions by the others, each group in the opposite direction to
/// the one before. `backward`: whether this group falls; inverted for the next.
fn sort_alternating(visits: &mut [BallVisit], axes: &[Axis], backward: &mut bool) {
    let Some((first, rest)) = axes.split_first() else { return };
    let at = |visit: &BallVisit| visit.rotary_position.get_or_zero(*first);
    visits.sort_by(|a, b| at(a).total_cmp(&at(b)));
    let mut inner = false;
    for run in visits.chunk_by_mut(|a, b| at(a) == at(b)) {
        sort_alternating(run, rest, &mut inner);
    }
    if *backward {
        visits.reverse();
    }
    *backward = !*backward;
}
