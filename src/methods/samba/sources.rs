//! Sources of uncertainty as changes of the observations: X, Y, Z of each measurement (machine frame,
//! mm), then each certified length (mm).

use super::geometry_model::certificate_and_temperature_u_mm;
use crate::ball_measurement::{
    ObservedBalls, angular_and_rotary_motion_sources, certified_size_source, effect_of_nonzero_spans, touch_sources,
};
use crate::identification::{ObservationSpanChange, UncertaintySource};
use machine::kinematics::KinematicChain;
use machine::record::artefact::CertifiedLength;
use machine::record::plan::Plan;

/// Index of the rotary error motions in the list of sources: after those of the linear axes.
const ROTARY_SOURCE_INDEX: usize = 5;

/// Sources of the observations. Draws without effect are left out.
pub fn uncertainty_sources(
    plan: &Plan,
    chain: &KinematicChain,
    observed: &ObservedBalls,
    lengths: &[CertifiedLength],
) -> Vec<UncertaintySource> {
    let mut list = touch_sources(plan, observed);
    let index = ROTARY_SOURCE_INDEX.min(list.len());
    list.splice(index..index, angular_and_rotary_motion_sources(plan, chain, observed));
    list.extend(certificate_sources(observed.centres.len(), lengths));
    list.retain(|source| source.draw_count() > 0);
    list
}

fn certificate_sources(centre_count: usize, lengths: &[CertifiedLength]) -> [UncertaintySource; 2] {
    [("certified length", 0), ("temperature of the certified length", 1)].map(|(name, part)| {
        let spans = lengths.iter().enumerate().map(|(i, length)| ObservationSpanChange {
            first_index: 3 * centre_count + i,
            changes_mm: vec![certificate_and_temperature_u_mm(length)[part]],
        });
        certified_size_source(name, effect_of_nonzero_spans(spans))
    })
}
