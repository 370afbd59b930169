//! Sources of uncertainty as changes of the observations of [`DomeModel`].

use super::model::DomeModel;
use crate::ball_measurement::{
    ObservedBalls, angular_and_rotary_motion_sources, certified_size_source, effect_of_nonzero_spans, touch_sources,
};
use crate::identification::{
    KnownErrors, ObservationEffect, ObservationModel as _, ObservationSpanChange, UncertaintySource, slope_of_unknown,
};
use machine::kinematics::KinematicChain;
use machine::record::artefact::Balls;
use machine::record::plan::Plan;

/// Sources of the readings alone; the weights follow from them.
pub fn reading_sources(plan: &Plan, chain: &KinematicChain, observed: &ObservedBalls) -> Vec<UncertaintySource> {
    let mut sources = touch_sources(plan, observed);
    sources.extend(angular_and_rotary_motion_sources(plan, chain, observed));
    sources.retain(|source| source.draw_count() > 0);
    sources
}

/// Source of the certificate: each coordinate of each ball is independent, with the stated uncertainty.
pub fn certificate_source(model: &DomeModel<'_>, u_mm: f64) -> UncertaintySource {
    let coordinates = 3 * model.ball_count;
    let span = |k: usize| ObservationSpanChange {
        first_index: model.first_certified_observation_index(0) + k,
        changes_mm: vec![u_mm],
    };
    certified_size_source("certificate of the balls", effect_of_nonzero_spans((0..coordinates).map(span)))
}

/// Source of the artefact temperature: all distances between the balls change by the same relative amount.
pub fn temperature_source(model: &DomeModel<'_>, balls: &Balls) -> UncertaintySource {
    let mut column = vec![0.0; model.observation_count()];
    let coordinates = balls.balls.iter().flat_map(|ball| ball.centre_mm);
    let certified = column.iter_mut().skip(model.first_certified_observation_index(0));
    certified.zip(coordinates).for_each(|(change, mm)| *change = balls.relative_expansion_and_u()[1] * mm);
    certified_size_source("temperature of the artefact", ObservationEffect::Joint(vec![column]))
}

/// Source of the machine errors of the prior, with their covariance.
pub fn prior_source(model: &DomeModel<'_>, known: &KnownErrors<'_>) -> Option<UncertaintySource> {
    let column = |error: usize| slope_of_unknown(model.error_observation_index(error), model.observation_count());
    let columns: Vec<Vec<f64>> = (0..known.errors.len()).map(column).collect();
    UncertaintySource::from_prior(known.estimate, &known.symbols, &known.columns_by_parameters(&columns))
}
