//! In which order the indexations follow each other, and the balls at each.

use super::indexations::is_parallel;
use super::setup::{Find, MeasurementSetup, Visit, describe_position};
use crate::Refused;
use machine::record::machine::Machine;
use machine::record::motion::Block;
use machine::record::plan::{Plan, Step, StepKind};
use machine::{Axis, Position};
use planning::{Access, Approach, Clearance, Confirmed, Start, Ways};
use planning::{end_of, machine_time_s, step_blocks};
use rayon::prelude::*;

/// The balls of each visit on a short way, the visits as they stand. Where a visit's balls are searched
/// for first they are measured on the way back, and the visit ends at the ball where it began.
///
/// # Errors
/// A ball whose place cannot be computed.
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
        let order = Ways::in_xy(&places, stands.as_ref(), &setup.plan.machine).tour(1);
        let end = if back { order.first() } else { order.last() };
        stands = end.and_then(|place| places.get(*place)).cloned().or(stands);
        visit.balls = order.iter().filter_map(|place| visit.balls.get(*place).copied()).collect();
    }
    Ok(visits)
}

/// So many neighbours of a ball are considered by the times of their planned ways.
const NEAR: usize = 16;
/// So many balls are tried as the first of a visit.
const FIRSTS: usize = 4;

/// As [`balls_in_order`], by the time that each way takes as it is planned, with all its heights: worth its time for many
/// balls that stand at different heights.
///
/// # Errors
/// A ball that cannot be measured at its visit.
pub fn balls_by_planned_ways(
    setup: &MeasurementSetup<'_>,
    access: &Access,
    mut visits: Vec<Visit>,
) -> Result<Vec<Visit>, Refused> {
    let clearance = Clearance::known(setup.plan, None)?;
    let mut stands: Option<Position> = None;
    for visit in &mut visits {
        let balls = balls_touched(setup, access, visit)?;
        let planner = WayPlanner { plan: setup.plan, clearance: &clearance };
        let ends = balls.iter().map(|steps| planner.end(steps)).collect::<Result<Vec<_>, _>>()?;
        let from = |from: &Position| planner.ways_s(from, &balls);
        let between = ends.par_iter().map(from).collect::<Result<Vec<_>, _>>()?;
        let from_stand = stands.as_ref().map(from).transpose()?;
        let order = Ways { between, from_stand }.tour(FIRSTS);
        stands = order.last().and_then(|last| ends.get(*last)).cloned().or(stands);
        visit.balls = order.iter().filter_map(|place| visit.balls.get(*place).copied()).collect();
    }
    Ok(visits)
}

/// Steps of a slow measurement of each ball of the visit.
fn balls_touched(
    setup: &MeasurementSetup<'_>,
    access: &Access,
    visit: &Visit,
) -> Result<Vec<Vec<Step>>, Refused> {
    let approach =
        Approach::Slow { standoff_mm: setup.touch.standoff_mm, search_mm: setup.touch.search_mm };
    let steps = |index: &usize| {
        let ball = setup.balls.balls.get(*index)?;
        let task = setup.task(ball, &visit.at, approach);
        let steps = access.steps(&task, &setup.plan.probe, StepKind::Touch, (0, 0), str::to_owned);
        Some(steps.map_err(|why| {
            Refused::new(
                format!("ball {} at {}: {why}", ball.id, describe_position(&visit.at)),
                "take the position out of tilt_deg and turn_deg, or set the ball up elsewhere",
            )
        }))
    };
    visit.balls.iter().filter_map(steps).collect()
}

struct WayPlanner<'a> {
    plan: &'a Plan,
    clearance: &'a Clearance,
}

impl WayPlanner<'_> {
    fn blocks(&self, from: &Position, step: &Step) -> Result<Vec<Block>, Refused> {
        let start = Start { stands: Some(from), confirmed: Confirmed::all() };
        Ok(step_blocks(self.plan, step, 0, start, self.clearance)?)
    }

    /// Where the machine stands after the touches of a ball.
    fn end(&self, steps: &[Step]) -> Result<Position, Refused> {
        let Some(last) = steps.last() else { return Ok(Position::new()) };
        let blocks = self.blocks(&last.from, last)?;
        Ok(end_of(blocks.iter().flat_map(|block| &block.motions), &last.from))
    }

    /// To the first contact of each ball. Ways to the nearest are planned, seen from above; a tour takes few others.
    fn ways_s(&self, from: &Position, balls: &[Vec<Step>]) -> Result<Vec<f64>, Refused> {
        let places: Vec<Position> =
            balls.iter().filter_map(|steps| steps.first()).map(|step| step.from.clone()).collect();
        let in_xy = Ways::in_xy(&places, Some(from), &self.plan.machine).from_stand;
        let mut seconds = in_xy.unwrap_or_default();
        let mut order: Vec<usize> = (0..seconds.len()).collect();
        order.sort_by(|a, b| seconds[*a].total_cmp(&seconds[*b]));
        let (near, far) = order.split_at(NEAR.min(order.len()));
        let mut longest = 0.0_f64;
        for ball in near {
            seconds[*ball] = self.way_s(from, &balls[*ball])?;
            longest = longest.max(seconds[*ball]);
        }
        far.iter().for_each(|ball| seconds[*ball] += longest);
        Ok(seconds)
    }

    /// To the first contact of a ball.
    fn way_s(&self, from: &Position, steps: &[Step]) -> Result<f64, Refused> {
        let Some(first) = steps.first() else { return Ok(0.0) };
        let (mut seconds, mut stands) = (0.0, from.clone());
        for block in self.blocks(from, first)? {
            seconds += machine_time_s(&block, &stands, &self.plan.machine);
            stands = end_of(&block.motions, &stands);
        }
        Ok(seconds)
    }
}

/// Sorted by tilt; the axis parallel to the spindle sweeps forward at one tilt and back at the next,
/// so that backlash and drift do not side with its angle, and the spindle likewise within it.
pub fn in_order(machine: &Machine, visits: Vec<Visit>) -> Vec<Visit> {
    let mut axes: Vec<Axis> = machine.axes.keys().copied().filter(|a| !a.is_linear()).collect();
    axes.sort_by_key(|axis| (*axis == Axis::S, is_parallel(*axis, machine)));
    let mut sorted = visits;
    sweep(&mut sorted, &axes, &mut false);
    sorted
}

/// Sorts by the first of `axes`, and within equal positions by the others, each run the other way
/// round than the one before.
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
