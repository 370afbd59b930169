//! The measuring design: all accessible balls at each indexation.

use std::collections::BTreeMap;

use super::settings::Settings;
use crate::Refused;
use crate::ball_measurement::{
    Find, MeasurementSetup, Visit, balls, balls_by_planned_ways, balls_in_order, in_order,
    indexations,
};
use machine::kinematics::Chain;
use machine::record::plan::Plan;

/// # Errors
/// Settings or artefact are unusable; the balls have no certified positions.
pub fn setup<'a>(plan: &'a Plan, settings: &Settings) -> Result<MeasurementSetup<'a>, Refused> {
    settings.check()?;
    let set = balls(super::NAME, &plan.artefact)?;
    Refused::unless(
        set.certificate_u_mm.is_some(),
        "the places of the balls have no certificate: there is nothing to compare with",
        "state certificate_u_mm in [artefact], the standard uncertainty of a coordinate, or measure with samba",
    )?;
    let known = |id: &String| set.balls.iter().any(|ball| ball.id == *id);
    Refused::unless(
        settings.tool_ball.is_empty() || known(&settings.tool_ball),
        format!("tool_ball names {}, which is no ball of the artefact", settings.tool_ball),
        "name one of the balls of [artefact], or leave tool_ball out",
    )?;
    Ok(MeasurementSetup { method: super::NAME, plan, balls: set, touch: settings.touch() })
}

/// Visits in measuring order.
///
/// # Errors
/// An indexation is outside the limits; a ball is accessible at no indexation.
pub fn visits(setup: &MeasurementSetup<'_>, settings: &Settings) -> Result<Vec<Visit>, Refused> {
    let chain = Chain::new(&setup.plan.machine)?;
    let places = indexations(super::NAME, &setup.plan.machine, &chain, &settings.positions())?;
    let access = setup.access(&setup.plan.artefact)?;
    let approach = setup.search(setup.balls.uncertainty_mm);
    let mut seen = vec![false; setup.balls.balls.len()];
    let mut why_not: BTreeMap<usize, String> = BTreeMap::new();
    let mut visits = Vec::new();
    for at in places {
        let mut balls = Vec::new();
        for (index, ball) in setup.balls.balls.iter().enumerate() {
            match access.accessible(&setup.task(ball, &at, approach)) {
                Ok(_) => {
                    balls.push(index);
                    seen[index] = true;
                }
                Err(why) => drop(why_not.insert(index, why.to_string())),
            }
        }
        if !balls.is_empty() {
            visits.push(Visit::new(at, balls));
        }
    }
    if let Some(hidden) = seen.iter().position(|seen| !seen) {
        let why = why_not.get(&hidden).map_or("", String::as_str);
        return Err(Refused::new(
            format!("ball {} is accessible at no indexation: {why}", setup.balls.balls[hidden].id),
            "add positions to tilt_deg or turn_deg, or take the ball out of [artefact]",
        ));
    }
    let visits = in_order(&setup.plan.machine, visits);
    match setup.touch.find {
        Find::Once => balls_by_planned_ways(setup, visits),
        // The path goes there and back, so the path in X and Y counts twice.
        Find::Every => balls_in_order(setup, &access, visits),
    }
}
