//! The measuring design: all accessible balls at each indexation.

use std::collections::BTreeMap;

use super::settings::BallDomeSettings;
use crate::MethodRefusal;
use crate::ball_measurement::{
    BallVisit, MeasurementSetup, SearchMode, ball_index, list_indexations, order_balls_by_path, order_balls_in_xy,
    order_visits, require_balls,
};
use machine::kinematics::KinematicChain;
use machine::record::plan::Plan;

/// # Errors
/// Settings or artefact are unusable; the balls have no certified positions.
pub fn dome_setup<'a>(plan: &'a Plan, settings: &BallDomeSettings) -> Result<MeasurementSetup<'a>, MethodRefusal> {
    settings.check()?;
    let set = require_balls(super::METHOD_NAME, &plan.artefact)?;
    MethodRefusal::require(
        set.certificate_u_mm.is_some(),
        "the positions of the balls have no certificate, which this comparison requires",
        "set certificate_u_mm in [artefact] to the standard uncertainty of a coordinate, or measure with \
        samba",
    )?;
    MethodRefusal::require(
        settings.tool_ball.is_empty() || ball_index(set, &settings.tool_ball).is_some(),
        format!("tool_ball = {} is not a ball of the artefact", settings.tool_ball),
        "choose one of the balls of [artefact], or remove tool_ball",
    )?;
    Ok(MeasurementSetup { method: super::METHOD_NAME, plan, balls: set, touch_settings: settings.touch_settings() })
}

/// Visits in measuring order, one for each indexation, with the balls that are accessible there. An indexation without
/// accessible balls is left out.
///
/// # Errors
/// An indexation is outside the limits; a ball is accessible at no indexation.
pub fn design_visits(
    setup: &MeasurementSetup<'_>,
    settings: &BallDomeSettings,
) -> Result<Vec<BallVisit>, MethodRefusal> {
    let chain = KinematicChain::new(&setup.plan.machine)?;
    let places = list_indexations(super::METHOD_NAME, &setup.plan.machine, &chain, &settings.rotary_positions())?;
    let access = setup.touch_access(&setup.plan.artefact)?;
    let mode = setup.search_touch_mode(setup.balls.uncertainty_mm);
    let mut seen = vec![false; setup.balls.balls.len()];
    let mut why_not: BTreeMap<usize, String> = BTreeMap::new();
    let mut visits = Vec::new();
    for at in places {
        let mut balls = Vec::new();
        for (index, ball) in setup.balls.balls.iter().enumerate() {
            match access.accessible_touches(&setup.ball_measurement_request(ball, &at, mode)) {
                Ok(_) => {
                    balls.push(index);
                    seen[index] = true;
                }
                Err(reason) => drop(why_not.insert(index, reason.to_string())),
            }
        }
        if !balls.is_empty() {
            visits.push(BallVisit::new(at, balls));
        }
    }
    if let Some(hidden) = seen.iter().position(|seen| !seen) {
        let reason = why_not.get(&hidden).map_or("", String::as_str);
        return Err(MethodRefusal::new(
            format!("ball {} is accessible at no indexation: {reason}", setup.balls.balls[hidden].id),
            "add positions to tilt_deg or turn_deg, or remove the ball from [artefact]",
        ));
    }
    let visits = order_visits(&setup.plan.machine, visits);
    match setup.touch_settings.search_mode {
        SearchMode::Once => order_balls_by_path(setup, visits),
        // Each visit takes the path twice: search forward, slow measurement backward.
        SearchMode::Every => order_balls_in_xy(setup, &access, visits),
    }
}
