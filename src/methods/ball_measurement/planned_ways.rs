//! Order of the balls of an indexation and of the touches of each ball, from the times of the planned paths.

use super::setup::{MeasurementSetup, Visit, describe_position};
use super::touch_order::{BallWays, TouchOrder, quickest};
use crate::Refused;
use machine::Position;
use machine::record::artefact::{Artefact, Balls};
use machine::record::motion::Block;
use machine::record::plan::{Plan, Step, StepKind};
use planning::{Access, Approach, Clearance, Confirmed, Start, TravelTimes};
use planning::{end_of, machine_time_s, step_blocks};
use rayon::prelude::*;

/// Number of nearest neighbours of a ball for which paths are planned.
const PLANNED_NEIGHBOURS: usize = 16;
/// Number of balls that are tried as the first of a visit.
const MAX_START_BALLS: usize = 4;
/// Number of touches of a measurement without a form check.
const TOUCHES_WITHOUT_FORM: usize = 5;

/// As [`super::balls_in_order`], but from the time of each planned path with all its heights. This is worth
/// the computing time for many balls at different heights. It then chooses the order of the touches of each
/// ball; a form check, with more than five touches, keeps its order. Every ball counts as found at its stated
/// position.
///
/// # Errors
/// A ball cannot be measured at its visit.
pub fn balls_by_planned_ways(
    setup: &MeasurementSetup<'_>,
    mut visits: Vec<Visit>,
) -> Result<Vec<Visit>, Refused> {
    let uncertainty_mm = setup.touch.found_within_mm();
    let found = Artefact::Balls(Balls { uncertainty_mm, ..setup.balls.clone() });
    let (access, clearance) = (setup.access(&found)?, Clearance::over(setup.plan, &found)?);
    let planner = WayPlanner { plan: setup.plan, clearance: &clearance };
    let mut stands: Option<Position> = None;
    for visit in &mut visits {
        let balls = balls_touched(setup, &access, visit)?;
        let order = planner.order(&balls, stands.as_ref())?;
        visit.balls = order.iter().filter_map(|place| visit.balls.get(*place).copied()).collect();
        let balls: Vec<&Vec<Step>> = order.iter().filter_map(|place| balls.get(*place)).collect();
        let around = match setup.touch.touches {
            TOUCHES_WITHOUT_FORM => quickest(&planner.ball_ways(&balls, stands.as_ref())?),
            _ => vec![TouchOrder::default(); balls.len()],
        };
        if let (Some(steps), Some(around)) = (balls.last(), around.last()) {
            let steps = around.applied(steps.iter().collect());
            stands = steps.last().map(|last| planner.end(last)).transpose()?;
        }
        visit.around = visit.balls.iter().copied().zip(around).collect();
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

    /// Position of the machine after a touch.
    fn end(&self, step: &Step) -> Result<Position, Refused> {
        let blocks = self.blocks(&step.from, step)?;
        Ok(end_of(blocks.iter().flat_map(|block| &block.motions), &step.from))
    }

    /// Indices of the balls in an order of short duration, each with its touches in the default order.
    fn order(&self, balls: &[Vec<Step>], stands: Option<&Position>) -> Result<Vec<usize>, Refused> {
        let ends = balls.iter().filter_map(|steps| steps.last()).map(|last| self.end(last));
        let ends = ends.collect::<Result<Vec<_>, _>>()?;
        let from = |from: &Position| self.ways_s(from, balls);
        let between = ends.par_iter().map(from).collect::<Result<Vec<_>, _>>()?;
        let from_stand = stands.map(from).transpose()?;
        Ok(TravelTimes { between, from_stand }.tour(MAX_START_BALLS))
    }

    /// Path times of the balls in their order, from the current position of the machine.
    fn ball_ways(
        &self,
        balls: &[&Vec<Step>],
        stands: Option<&Position>,
    ) -> Result<Vec<BallWays>, Refused> {
        let ends = |steps: &&Vec<Step>| steps.iter().map(|step| self.end(step)).collect();
        let ends = balls.par_iter().map(ends).collect::<Result<Vec<Vec<Position>>, Refused>>()?;
        let of_ball = |number: usize| {
            let row = |from: &Position| -> Result<Vec<f64>, Refused> {
                balls[number].iter().map(|step| self.way_s(from, step)).collect()
            };
            let rows = |from: &[Position]| from.iter().map(row).collect::<Result<Vec<_>, _>>();
            let entering = match number.checked_sub(1) {
                Some(before) => rows(&ends[before])?,
                None => stands.map(row).transpose()?.into_iter().collect(),
            };
            Ok(BallWays { entering, within: rows(&ends[number])? })
        };
        (0..balls.len()).into_par_iter().map(of_ball).collect()
    }

    /// Path times to the first contact of each ball, s. Paths are planned only to the nearest balls in XY,
    /// because a tour uses few others.
    fn ways_s(&self, from: &Position, balls: &[Vec<Step>]) -> Result<Vec<f64>, Refused> {
        let places: Vec<Position> =
            balls.iter().filter_map(|steps| steps.first()).map(|step| step.from.clone()).collect();
        let in_xy = TravelTimes::in_xy(&places, Some(from), &self.plan.machine).from_stand;
        let mut seconds = in_xy.unwrap_or_default();
        let mut order: Vec<usize> = (0..seconds.len()).collect();
        order.sort_by(|a, b| seconds[*a].total_cmp(&seconds[*b]));
        let (near, far) = order.split_at(PLANNED_NEIGHBOURS.min(order.len()));
        let mut longest = 0.0_f64;
        for ball in near {
            let Some(first) = balls[*ball].first() else { continue };
            seconds[*ball] = self.way_s(from, first)?;
            longest = longest.max(seconds[*ball]);
        }
        far.iter().for_each(|ball| seconds[*ball] += longest);
        Ok(seconds)
    }

    /// Path time to the contact of a touch, s.
    fn way_s(&self, from: &Position, step: &Step) -> Result<f64, Refused> {
        let (mut seconds, mut stands) = (0.0, from.clone());
        for block in self.blocks(from, step)? {
            seconds += machine_time_s(&block, &stands, &self.plan.machine);
            stands = end_of(&block.motions, &stands);
        }
        Ok(seconds)
    }
}
