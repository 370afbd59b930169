//! The measuring design: the balls at each indexation, their order, and the check that they suffice.

mod design_setup;
mod greedy_choice;
mod machine_information;
mod paper_design;
mod rank_check;

#[cfg(test)]
mod refusal_tests;
#[cfg(test)]
pub mod tests;

use std::collections::BTreeMap;

pub use self::design_setup::DesignSetup;
use self::greedy_choice::{MIN_VISITS_PER_BALL, choose_measurements};
use self::machine_information::CandidateMeasurement;
use super::settings::DesignKind;
use crate::MethodRefusal;
use crate::ball_measurement::{
    BallVisit, describe_rotary_axes_in_degrees, list_indexations, order_balls_in_xy, order_visits,
};
use machine::record::artefact::Ball;
use machine::{Axis, Position};
use planning::TouchAccess;

/// Maximum distance of a stylus from the spindle axis at which it counts as on the axis in the access checks,
/// mm.
const MAX_ON_AXIS_STYLUS_OFFSET_MM: f64 = 0.1;

/// All possible measurements: the rotary positions, and the balls that are accessible at each.
pub struct DesignCandidates {
    pub rotary_positions: Vec<Position>,
    pub measurements: Vec<CandidateMeasurement>,
}

/// The visits in measuring order, with rank and condition checked. `time_s` gives the machine time of visits,
/// s.
///
/// # Errors
/// The errors of [`DesignCandidates::new`]; the budget does not suffice; the machine or artefact does not allow the
/// paper's design; the design does not separate the errors of the machine. The text states the reason.
pub fn design_visits(
    setup: &DesignSetup<'_>,
    time_s: impl Fn(&[BallVisit]) -> Result<f64, MethodRefusal>,
) -> Result<Vec<BallVisit>, MethodRefusal> {
    let access = setup.measurement_setup().touch_access(&setup.plan.artefact)?;
    let candidates = DesignCandidates::new(setup, &access)?;
    let visits = match setup.settings.design {
        // The visits keep the order of the paper's design; only the balls of each visit are ordered by travel time.
        DesignKind::Paper => {
            order_balls_in_xy(&setup.measurement_setup(), &access, paper_design::paper_visits(setup, &candidates)?)?
        }
        DesignKind::Optimal => choose_optimal_visits(setup, &candidates, &access, time_s)?,
    };
    rank_check::check_rank_and_condition(setup, &visits)?;
    Ok(visits)
}

/// The greedy choice, as far as the time limit in minutes allows (0: no limit).
fn choose_optimal_visits(
    setup: &DesignSetup<'_>,
    candidates: &DesignCandidates,
    access: &TouchAccess,
    time_s: impl Fn(&[BallVisit]) -> Result<f64, MethodRefusal>,
) -> Result<Vec<BallVisit>, MethodRefusal> {
    let (balls, settings) = (setup.balls.balls.len(), setup.settings);
    let chosen = choose_measurements(&candidates.measurements, balls, setup.length_information(), settings)?;
    let first_visits = |count: usize| {
        let indices = chosen.candidate_indices.get(..count).unwrap_or_default();
        let visits = order_visits(&setup.plan.machine, candidates.visits_of_chosen(indices));
        order_balls_in_xy(&setup.measurement_setup(), access, visits)
    };
    if settings.minutes == 0.0 {
        return first_visits(chosen.candidate_indices.len());
    }
    let limit_s = settings.minutes * 60.0;
    let min_time_s = time_s(&first_visits(chosen.count_with_min_visits)?)?;
    if min_time_s > limit_s {
        return Err(MethodRefusal {
            reason: format!(
                "minutes = {} is too short: the measurement of every ball at {MIN_VISITS_PER_BALL} \
                 indexations takes {:.1} minutes of machine time",
                settings.minutes,
                min_time_s / 60.0
            ),
            remedy: "increase minutes, choose find = \"once\", or remove balls from [artefact]".to_owned(),
        });
    }
    // Bisection: `fits` measurements are within the time limit, `exceeds` measurements are not.
    let (mut fits, mut exceeds) = (chosen.count_with_min_visits, chosen.candidate_indices.len() + 1);
    while exceeds - fits > 1 {
        let middle = (fits + exceeds) / 2;
        if time_s(&first_visits(middle)?)? <= limit_s { fits = middle } else { exceeds = middle }
    }
    first_visits(fits)
}

impl DesignCandidates {
    /// # Errors
    /// An indexation is outside the limits; a ball is accessible at fewer than three indexations.
    pub fn new(setup: &DesignSetup<'_>, access: &TouchAccess) -> Result<Self, MethodRefusal> {
        let settings = match setup.settings.design {
            DesignKind::Optimal => setup.settings.clone(),
            DesignKind::Paper => paper_design::paper_settings(setup.settings),
        };
        let positions = settings.candidate_positions(setup.is_spindle_oriented);
        let chain = setup.model.chain();
        let at = list_indexations(crate::samba::METHOD_NAME, &setup.plan.machine, chain, &positions)?;
        let mut measurements = Vec::new();
        for (index, ball) in setup.balls.balls.iter().enumerate() {
            let (mut count, mut reasons_by_position) = (0, BTreeMap::<String, &Position>::new());
            for (indexation, free) in ball_access_by_indexation(setup, access, &at, ball).into_iter().enumerate() {
                let Some(at) = at.get(indexation) else { continue };
                match free {
                    Ok(()) => {
                        measurements.push(setup.candidate_measurement(indexation, at, index, ball)?);
                        count += 1;
                    }
                    Err(why) => drop(reasons_by_position.entry(why).or_insert(at)),
                }
            }
            if count < MIN_VISITS_PER_BALL {
                return Err(refuse_unreachable_ball(&ball.id, count, at.len(), &reasons_by_position));
            }
        }
        Ok(Self { rotary_positions: at, measurements })
    }

    /// The measurements with the indices `chosen`, grouped by indexation.
    pub fn visits_of_chosen(&self, chosen: &[usize]) -> Vec<BallVisit> {
        let mut by_indexation: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for measurement in chosen.iter().filter_map(|index| self.measurements.get(*index)) {
            by_indexation.entry(measurement.indexation_index).or_default().push(measurement.ball_index);
        }
        let visit = |(indexation, balls): (usize, Vec<usize>)| {
            Some(BallVisit::new(self.rotary_positions.get(indexation)?.clone(), balls))
        };
        by_indexation.into_iter().filter_map(visit).collect()
    }
}

/// For each indexation, `Ok` if the ball can be measured there, otherwise the reason. The check uses the search at the
/// stated position, enlarged by the position uncertainty; the ball can then be measured wherever it is found.
fn ball_access_by_indexation(
    setup: &DesignSetup<'_>,
    access: &TouchAccess,
    rotary_positions: &[Position],
    ball: &Ball,
) -> Vec<Result<(), String>> {
    let mode = setup.measurement_setup().search_touch_mode(setup.balls.uncertainty_mm);
    // A stylus on the spindle axis occupies the same space at every spindle angle.
    let is_central = setup.tip.mm.xy().norm() < MAX_ON_AXIS_STYLUS_OFFSET_MM;
    let mut last: Option<(Position, Result<(), String>)> = None;
    let mut all = Vec::with_capacity(rotary_positions.len());
    for position in rotary_positions {
        let rotary = if is_central { position.filter_axes(|axis| axis != Axis::S) } else { position.clone() };
        let result = match last.take().filter(|(before, _)| *before == rotary) {
            Some((_, result)) => result,
            None => {
                let request = setup.measurement_setup().ball_measurement_request(ball, position, mode);
                access.accessible_touches(&request).map(drop).map_err(|error| error.to_string())
            }
        };
        all.push(result.clone());
        last = Some((rotary, result));
    }
    all
}

fn refuse_unreachable_ball(
    id: &str,
    count: usize,
    total: usize,
    reasons_by_position: &BTreeMap<String, &Position>,
) -> MethodRefusal {
    let reasons: Vec<String> = reasons_by_position
        .iter()
        .take(2)
        .map(|(why, at)| format!("at {} {why}", describe_rotary_axes_in_degrees(at)))
        .collect();
    let accessible = match count {
        0 => "is accessible at none".to_owned(),
        some => format!("is accessible at only {some}"),
    };
    MethodRefusal::new(
        format!(
            "ball {id} {accessible} of {total} indexations, {MIN_VISITS_PER_BALL} are needed: {}",
            reasons.join("; ")
        ),
        "mount the ball at another position or with another stem, choose other positions in tilt_deg and turn_deg, \
        or remove the ball from [artefact]",
    )
}
