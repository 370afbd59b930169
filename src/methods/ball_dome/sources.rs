//! Sources of uncertainty as changes of the observations of [`DomeModel`].

use super::model::DomeModel;
use crate::ball_measurement::{
    Observed, angular_source, nonzero_runs, rotary_source, touch_sources,
};
use crate::identification::KnownErrors;
use crate::identification::{
    Effect, InResiduals, ObservationModel as _, ObservationRun, UncertaintySource,
};
use machine::kinematics::Chain;
use machine::record::artefact::Balls;
use machine::record::plan::Plan;

/// Sources of the readings alone; the weights follow from them.
pub fn of_readings(plan: &Plan, chain: &Chain, observed: &Observed) -> Vec<UncertaintySource> {
    let mut sources = touch_sources(plan, observed);
    sources.push(angular_source(plan, chain, observed));
    sources.push(rotary_source(plan, chain, observed));
    sources.retain(|source| source.draws() > 0);
    sources
}

/// Source of the certificate: each coordinate of each ball is independent, with the stated uncertainty.
pub fn certificate(model: &DomeModel<'_>, u_mm: f64) -> UncertaintySource {
    let coordinates = 3 * model.balls;
    let run = |k: usize| ObservationRun { first: model.certified_at(0) + k, values: vec![u_mm] };
    UncertaintySource {
        in_residuals: InResiduals::Expected,
        is_in_weights: false,
        ..UncertaintySource::new(
            "certificate of the balls",
            nonzero_runs((0..coordinates).map(run)),
        )
    }
}

/// Temperature of the artefact: if it is higher than stated, all distances between the balls are larger.
pub fn temperature(model: &DomeModel<'_>, balls: &Balls) -> UncertaintySource {
    let mut column = vec![0.0; model.observations()];
    let coordinates = balls.balls.iter().flat_map(|ball| ball.centre_mm);
    let certified = column.iter_mut().skip(model.certified_at(0));
    certified.zip(coordinates).for_each(|(change, mm)| *change = balls.expansion()[1] * mm);
    UncertaintySource {
        in_residuals: InResiduals::Expected,
        is_in_weights: false,
        ..UncertaintySource::new("temperature of the artefact", Effect::Joint(vec![column]))
    }
}

/// Source of the machine errors of the prior, with their covariance.
pub fn prior(model: &DomeModel<'_>, known: &KnownErrors<'_>) -> Option<UncertaintySource> {
    let column = |error: usize| {
        let mut column = vec![0.0; model.observations()];
        column[model.error_at(error)] = 1.0;
        column
    };
    let columns: Vec<Vec<f64>> = (0..known.errors.len()).map(column).collect();
    UncertaintySource::of_prior(known.estimate, &known.symbols, &columns)
}
