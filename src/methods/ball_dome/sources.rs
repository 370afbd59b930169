//! Sources of uncertainty as changes of the observations of [`DomeModel`].

use super::model::DomeModel;
use crate::ball_measurement::{ObservedBalls, angular_source, nonzero_spans, rotary_source, touch_sources};
use crate::identification::KnownErrors;
use crate::identification::{Effect, ObservationModel as _, ObservationSpan, ResidualTreatment, UncertaintySource};
use machine::kinematics::KinematicChain;
use machine::record::artefact::Balls;
use machine::record::plan::Plan;

/// Sources of the readings alone; the weights follow from them.
pub fn reading_sources(plan: &Plan, chain: &KinematicChain, observed: &ObservedBalls) -> Vec<UncertaintySource> {
    let mut sources = touch_sources(plan, observed);
    sources.push(angular_source(plan, chain, observed));
    sources.push(rotary_source(plan, chain, observed));
    sources.retain(|source| source.draw_count() > 0);
    sources
}

/// Source of the certificate: each coordinate of each ball is independent, with the stated uncertainty.
pub fn certificate_source(model: &DomeModel<'_>, u_mm: f64) -> UncertaintySource {
    let coordinates = 3 * model.ball_count;
    let run = |k: usize| ObservationSpan { first_index: model.certified_index(0) + k, changes_mm: vec![u_mm] };
    UncertaintySource {
        in_residuals: ResidualTreatment::Expected,
        is_in_weights: false,
        ..UncertaintySource::new("certificate of the balls", nonzero_spans((0..coordinates).map(run)))
    }
}

/// Temperature of the artefact: if it is higher than stated, all distances between the balls are larger.
pub fn temperature_source(model: &DomeModel<'_>, balls: &Balls) -> UncertaintySource {
    let mut column = vec![0.0; model.observations()];
    let coordinates = balls.balls.iter().flat_map(|ball| ball.centre_mm);
    let certified = column.iter_mut().skip(model.certified_index(0));
    certified.zip(coordinates).for_each(|(change, mm)| *change = balls.relative_expansion()[1] * mm);
    UncertaintySource {
        in_residuals: ResidualTreatment::Expected,
        is_in_weights: false,
        ..UncertaintySource::new("temperature of the artefact", Effect::Joint(vec![column]))
    }
}

/// Source of the machine errors of the prior, with their covariance.
pub fn prior_source(model: &DomeModel<'_>, known: &KnownErrors<'_>) -> Option<UncertaintySource> {
    let column = |error: usize| {
        let mut column = vec![0.0; model.observations()];
        column[model.error_index(error)] = 1.0;
        column
    };
    let columns: Vec<Vec<f64>> = (0..known.errors.len()).map(column).collect();
    UncertaintySource::from_prior(known.estimate, &known.symbols, &columns)
}
