//! Uncertainty sources of a run, and the weights that follow from them.

use super::observe::PlateMeasurements;
use crate::ball_measurement::{effect_of_nonzero_columns, shift_column, touch_sources};
use crate::identification::declared_sources::drift_rate_sd_mm_per_s;
use crate::identification::{UncertaintySource, block_covariances};
use machine::Axis;
use machine::record::plan::Plan;

/// A smaller standard uncertainty of a coordinate is replaced by this one in the weights, mm.
const COORDINATE_STD_U_FLOOR_MM: f64 = 1e-6;
/// Assumed time constant of a machine that approaches thermal equilibrium, s: it sets how much the declared
/// drift rate changes within a run.
const THERMAL_TIME_CONSTANT_S: f64 = 7200.0;

/// Sources of a run with an effect: those of the touches and a change of the drift rate; both drifts are kept out of
/// the weights. Constant errors of X, Y and Z are part of the measuring positions and therefore no source.
pub fn uncertainty_sources(plan: &Plan, measured: &PlateMeasurements) -> Vec<UncertaintySource> {
    let centres = &measured.observed_balls.centres;
    let mut list = touch_sources(plan, &measured.observed_balls);
    let first_s = centres.first().map_or(0.0, |centre| centre.mean_time_s);
    // Displacement by a drift whose rate decays. The fitted polynomial absorbs a constant rate.
    let settled = |t_s: f64| THERMAL_TIME_CONSTANT_S * (1.0 - (-(t_s - first_s) / THERMAL_TIME_CONSTANT_S).exp());
    let rate = drift_rate_sd_mm_per_s(plan);
    let column = |axis: Axis| {
        shift_column(centres.iter().map(|centre| axis.nominal_direction() * (rate * settled(centre.mean_time_s))))
    };
    list.push(UncertaintySource::new("change of the drift rate", effect_of_nonzero_columns(Axis::LINEAR.map(column))));
    let is_drift =
        |source: &&mut UncertaintySource| ["thermal drift", "change of the drift rate"].contains(&source.name.as_str());
    for source in list.iter_mut().filter(is_drift) {
        source.is_in_weights = false;
    }
    list.retain(|source| source.draw_count() > 0);
    list
}

/// Standard uncertainty of each coordinate of each observation, from the sources that enter the weights, mm.
pub fn coordinate_sigmas(sources: &[UncertaintySource], observations: usize) -> Vec<f64> {
    let blocks = block_covariances::<3>(sources, observations);
    let of_block = |block: &nalgebra::Matrix3<f64>| {
        [0, 1, 2].map(|axis| block[(axis, axis)].sqrt().max(COORDINATE_STD_U_FLOOR_MM))
    };
    blocks.iter().flat_map(of_block).collect()
}
