//! Sources of uncertainty as changes of the observations: X, Y, Z of each measurement (machine frame,
//! mm), then each certified length (mm).

use super::model::length_u_parts_mm;
use crate::ball_measurement::{
    Observed, angular_source, nonzero_runs, rotary_source, touch_sources,
};
use crate::identification::{InResiduals, ObservationRun, UncertaintySource};
use machine::kinematics::Chain;
use machine::record::artefact::Length;
use machine::record::plan::Plan;

/// Index of the rotary error motions in the list of sources: after those of the linear axes.
const ROTARY_PLACE: usize = 5;

/// Sources of the observations. Draws without effect are left out.
pub fn sources(
    plan: &Plan,
    chain: &Chain,
    observed: &Observed,
    lengths: &[Length],
) -> Vec<UncertaintySource> {
    let mut list = touch_sources(plan, observed);
    let rotary = rotary_source(plan, chain, observed);
    let angular = angular_source(plan, chain, observed);
    let place = ROTARY_PLACE.min(list.len());
    list.splice(place..place, [angular, rotary]);
    list.extend(certificates(observed.centres.len(), lengths));
    list.retain(|source| source.draws() > 0);
    list
}

fn certificates(centres: usize, lengths: &[Length]) -> [UncertaintySource; 2] {
    [("certified length", 0), ("temperature of the certified length", 1)].map(|(name, part)| {
        let runs = lengths.iter().enumerate().map(|(i, length)| ObservationRun {
            first: 3 * centres + i,
            values: vec![length_u_parts_mm(length)[part]],
        });
        UncertaintySource {
            // The error of a certificate scales all observations together, so few residuals contain it.
            in_residuals: InResiduals::Expected,
            is_in_weights: false,
            ..UncertaintySource::new(name, nonzero_runs(runs))
        }
    })
}
