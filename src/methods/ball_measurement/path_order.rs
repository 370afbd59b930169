//! Order of the balls of an indexation and of the touches of each ball, from the times of the planned paths.

use super::setup::{BallVisit, MeasurementSetup, UNREACHABLE_BALL_REMEDY};
use super::touch_order::{BallPathTimes, TouchOrder, fastest_touch_orders};
use crate::MethodRefusal;
use machine::Position;
use machine::record::artefact::{Artefact, Balls};
use machine::record::motion::MotionBlock;
use machine::record::plan::{Plan, Step, StepKind};
use planning::{BlockStart, SafeHeights, TouchAccess, TouchedDirections, TravelTimes};
use planning::{machine_time_s, position_after_motions, step_blocks};
use rayon::prelude::*;

/// Number of balls nearest in XY travel time to which a path is planned; the times to farther balls are estimated
/// from XY.
const MAX_PLANNED_NEIGHBOURS: usize = 16;
/// Number of balls nearest to the machine position that are tried as the first of a visit; without a known position
/// (first visit) all balls are tried.
const TRIED_START_BALL_COUNT: usize = 4;
/// Number of touches of a measurement without a form check.
const TOUCH_COUNT_WITHOUT_FORM_CHECK: usize = 5;

/// Like [`super::order_balls_in_xy`], but with the time of each planned path, vertical motions included. This is worth
/// the computing time for many balls at different heights. The function also chooses the order of the touches of each
/// ball, except with a form check (more than five touches). Every ball counts as found at its stated position.
///
/// # Errors
/// A ball cannot be measured at its visit.
pub fn order_balls_by_path(
    setup: &MeasurementSetup<'_>,
    mut visits: Vec<BallVisit>,
) -> Result<Vec<BallVisit>, MethodRefusal> {
    let uncertainty_mm = setup.touch_settings.found_position_tolerance_mm();
    let found = Artefact::Balls(Balls { uncertainty_mm, ..setup.balls.clone() });
    let (access, clearance) = (setup.touch_access(&found)?, SafeHeights::above_artefact(setup.plan, &found)?);
    let planner = PathPlanner { plan: setup.plan, safe_heights: &clearance };
    let mut machine_position: Option<Position> = None;
    for visit in &mut visits {
        let balls = steps_of_slow_measurements(setup, &access, visit)?;
        let order = planner.fast_ball_order(&balls, machine_position.as_ref())?;
        visit.ball_indices = order.iter().filter_map(|place| visit.ball_indices.get(*place).copied()).collect();
        let balls: Vec<&Vec<Step>> = order.iter().filter_map(|place| balls.get(*place)).collect();
        let touch_orders = match setup.touch_settings.touch_count {
            TOUCH_COUNT_WITHOUT_FORM_CHECK => {
                fastest_touch_orders(&planner.ball_path_times(&balls, machine_position.as_ref())?)
            }
            _ => vec![TouchOrder::default(); balls.len()],
        };
        if let (Some(steps), Some(touch_order)) = (balls.last(), touch_orders.last()) {
            let steps = touch_order.apply(steps.iter().collect());
            machine_position = steps.last().map(|last| planner.end_position(last)).transpose()?;
        }
        visit.slow_touch_orders_by_ball_index = visit.ball_indices.iter().copied().zip(touch_orders).collect();
    }
    Ok(visits)
}

/// Steps of a slow measurement of each ball of the visit, in the order of `visit.ball_indices`, with the touches in
/// the default order.
fn steps_of_slow_measurements(
    setup: &MeasurementSetup<'_>,
    access: &TouchAccess,
    visit: &BallVisit,
) -> Result<Vec<Vec<Step>>, MethodRefusal> {
    let steps = |index: &usize| {
        let task = setup.ball_measurement_request(
            setup.balls.balls.get(*index)?,
            &visit.rotary_position,
            setup.slow_touch_mode(),
        );
        let steps = setup.ball_steps(access, &task, StepKind::Touch, str::to_owned);
        Some(steps.map_err(|refusal| MethodRefusal::new(refusal.reason, UNREACHABLE_BALL_REMEDY)))
    };
    visit.ball_indices.iter().filter_map(steps).collect()
}

/// Plans the paths to touches to compute their times and end positions.
struct PathPlanner<'a> {
    plan: &'a Plan,
    safe_heights: &'a SafeHeights,
}

impl PathPlanner<'_> {
    /// Motion blocks of the step, with the machine at `from` and its position verified in all directions.
    fn plan_step_blocks(&self, from: &Position, step: &Step) -> Result<Vec<MotionBlock>, MethodRefusal> {
        let start = BlockStart { position: Some(from), touched_directions: TouchedDirections::all() };
        Ok(step_blocks(self.plan, step, 0, start, self.safe_heights)?)
    }

    /// Position of the machine after a touch.
    fn end_position(&self, step: &Step) -> Result<Position, MethodRefusal> {
        let blocks = self.plan_step_blocks(&step.from, step)?;
        Ok(position_after_motions(blocks.iter().flat_map(|block| &block.motions), &step.from))
    }

    /// Order of short duration, as indices into `balls` (not of the artefact), each ball with its touches in the
    /// default order.
    fn fast_ball_order(
        &self,
        balls: &[Vec<Step>],
        machine_position: Option<&Position>,
    ) -> Result<Vec<usize>, MethodRefusal> {
        let ends = balls.iter().filter_map(|steps| steps.last()).map(|last| self.end_position(last));
        let ends = ends.collect::<Result<Vec<_>, _>>()?;
        let from = |from: &Position| self.path_times_to_balls_s(from, balls);
        let between = ends.par_iter().map(from).collect::<Result<Vec<_>, _>>()?;
        let from_start_s = machine_position.map(from).transpose()?;
        Ok(TravelTimes { pairwise_s: between, from_start_s }.visiting_order(TRIED_START_BALL_COUNT))
    }

    /// Path times for each of `balls` in the given order; those of the first ball start at `machine_position`.
    fn ball_path_times(
        &self,
        balls: &[&Vec<Step>],
        machine_position: Option<&Position>,
    ) -> Result<Vec<BallPathTimes>, MethodRefusal> {
        let ends = |steps: &&Vec<Step>| steps.iter().map(|step| self.end_position(step)).collect();
        let ends = balls.par_iter().map(ends).collect::<Result<Vec<Vec<Position>>, MethodRefusal>>()?;
        let of_ball = |number: usize| {
            let row = |from: &Position| -> Result<Vec<f64>, MethodRefusal> {
                balls[number].iter().map(|step| self.path_time_s(from, step)).collect()
            };
            let rows = |from: &[Position]| from.iter().map(row).collect::<Result<Vec<_>, _>>();
            let entering = match number.checked_sub(1) {
                Some(before) => rows(&ends[before])?,
                None => machine_position.map(row).transpose()?.into_iter().collect(),
            };
            Ok(BallPathTimes { from_previous_ball_s: entering, between_touches_s: rows(&ends[number])? })
        };
        (0..balls.len()).into_par_iter().map(of_ball).collect()
    }

    /// Path times to the first contact of each ball, s. Only the paths to the nearest balls in XY are planned,
    /// because a short tour rarely goes to farther ones; for a farther ball: XY travel time plus the longest planned
    /// time.
    fn path_times_to_balls_s(&self, from: &Position, balls: &[Vec<Step>]) -> Result<Vec<f64>, MethodRefusal> {
        let places: Vec<Position> =
            balls.iter().filter_map(|steps| steps.first()).map(|step| step.from.clone()).collect();
        let from_xy_positions = TravelTimes::from_xy_positions(&places, Some(from), &self.plan.machine).from_start_s;
        let mut seconds = from_xy_positions.unwrap_or_default();
        let mut order: Vec<usize> = (0..seconds.len()).collect();
        order.sort_by(|a, b| seconds[*a].total_cmp(&seconds[*b]));
        let (near, far) = order.split_at(MAX_PLANNED_NEIGHBOURS.min(order.len()));
        let mut longest = 0.0_f64;
        for ball in near {
            let Some(first) = balls[*ball].first() else { continue };
            seconds[*ball] = self.path_time_s(from, first)?;
            longest = longest.max(seconds[*ball]);
        }
        far.iter().for_each(|ball| seconds[*ball] += longest);
        Ok(seconds)
    }

    /// Path time to the contact of a touch, s.
    fn path_time_s(&self, from: &Position, step: &Step) -> Result<f64, MethodRefusal> {
        let (mut seconds, mut machine_position) = (0.0, from.clone());
        for block in self.plan_step_blocks(from, step)? {
            seconds += machine_time_s(&block, &machine_position, &self.plan.machine);
            machine_position = position_after_motions(&block.motions, &machine_position);
        }
        Ok(seconds)
    }
}
