//! Uncertainty sources of the touches, as changes of the observations: X, Y, Z of each measurement (machine
//! frame, mm).

use estimation::whitening::whitening_matrix;
use nalgebra::{Matrix3, Rotation3, Vector3};

use super::interruptions::interruption_effect;
use super::observation_effects::{effect_of_nonzero_columns, effect_of_nonzero_spans, shift_column};
use super::observe::{BallCentre, FittedTouch, ObservedBalls};
use crate::identification::declared_sources::{
    drift_rate_sd_mm_per_s, half_backlash_mm, linear_motion_patterns, lobing_patterns, repeatability_mm,
    resolution_u_mm,
};
use crate::identification::{
    DrawDistribution, EvaluationType, ObservationEffect, ObservationSpanChange, ResidualTreatment, UncertaintySource,
    block_covariances,
};
use machine::Axis;
use machine::record::plan::Plan;

/// Standard uncertainty added in quadrature to that of each coordinate in the weights, mm.
const ADDED_COORDINATE_STD_U_MM: f64 = 1e-6;

/// Whitening matrix of each measured centre, from the sources that enter the weights. The correlation between
/// measurements that a source changes together is ignored.
pub fn whitening_matrices(sources: &[UncertaintySource], centre_count: usize) -> impl Iterator<Item = Matrix3<f64>> {
    let min = Matrix3::from_diagonal_element(ADDED_COORDINATE_STD_U_MM.powi(2));
    block_covariances::<3>(sources, centre_count).into_iter().map(move |covariance| whitening_matrix(min + covariance))
}

/// A source of certified size. Its error changes many observations together, so few residuals contain it.
pub fn certified_size_source(name: &str, effect: ObservationEffect) -> UncertaintySource {
    UncertaintySource {
        residual_treatment: ResidualTreatment::InExpectedChi2,
        is_in_weights: false,
        ..UncertaintySource::new(name, effect)
    }
}

/// Sources that act on the touches of every ball measurement, in this order: repeatability, resolution,
/// lobing, backlash, error motions of X, Y and Z, drift, interruptions. The list always contains all of them; a source
/// that the plan declares as zero has an empty effect.
pub fn touch_sources(plan: &Plan, observed: &ObservedBalls) -> Vec<UncertaintySource> {
    let centres = &observed.centres;
    let named = UncertaintySource::new;
    vec![
        UncertaintySource {
            evaluation: EvaluationType::A,
            ..named("repeatability of a touch", per_touch_effect(centres, |_| repeatability_mm(plan)))
        },
        UncertaintySource {
            draw_distribution: DrawDistribution::Rectangular,
            ..named("resolution", per_touch_effect(centres, |normal| resolution_u_mm(plan, normal)))
        },
        // Lobing and backlash are equal in all measurements: they do not change the relative weights.
        UncertaintySource { is_in_weights: false, ..named("probe lobing", lobing_effect(plan, observed)) },
        UncertaintySource { is_in_weights: false, ..named("backlash", backlash_effect(plan, centres)) },
        named("error motions of X, Y and Z", linear_error_motion_effect(plan, centres)),
        named("thermal drift", drift_effect(plan, centres)),
        // In the weights, the steps would give the measurements after an interruption less weight than those before it.
        UncertaintySource {
            is_in_weights: false,
            ..named("steps at interruptions", interruption_effect(plan, centres))
        },
    ]
}

/// One draw per touch, of standard uncertainty `u` along its normal.
fn per_touch_effect(centres: &[BallCentre], u: impl Fn(Vector3<f64>) -> f64) -> ObservationEffect {
    let of_centre = |(i, centre): (usize, &BallCentre)| -> Vec<ObservationSpanChange> {
        let values = |touch: &FittedTouch| (touch.centre_gain * u(touch.normal)).as_slice().to_vec();
        let touches = centre.touches.iter();
        touches.map(|touch| ObservationSpanChange { first_index: 3 * i, changes_mm: values(touch) }).collect()
    };
    effect_of_nonzero_spans(centres.iter().enumerate().flat_map(of_centre))
}

/// Effect of the lobing patterns of the probe. Azimuths are computed in the spindle frame, because the probe turns
/// with the spindle.
fn lobing_effect(plan: &Plan, observed: &ObservedBalls) -> ObservationEffect {
    let sense = plan.machine.axes.get(&Axis::S).map_or(1.0, |spec| spec.positive.direction_sign());
    let normals = observed.centres.iter().flat_map(|centre| {
        let spindle =
            sense * observed.measured_rotary_positions[centre.measured_rotary_position_index].get_or_zero(Axis::S);
        let into_spindle = Rotation3::from_axis_angle(&Vector3::z_axis(), -spindle);
        centre.touches.iter().map(move |touch| into_spindle * touch.normal)
    });
    let patterns = lobing_patterns(plan, &normals.collect::<Vec<_>>());
    let centres = &observed.centres;
    effect_of_nonzero_columns(
        patterns.into_iter().map(|pattern| shift_column_from_touches(centres, pattern.into_iter())),
    )
}

/// One column per linear axis, with one draw for all measurements: half its backlash times the magnitude of the
/// component of the normal, because each axis lags behind the direction of the touch.
fn backlash_effect(plan: &Plan, centres: &[BallCentre]) -> ObservationEffect {
    let half = half_backlash_mm(plan);
    let column = |k: usize| {
        let of_touch = |touch: &FittedTouch| touch.centre_gain * half[k] * touch.normal[k].abs();
        shift_column(centres.iter().map(|centre| centre.touches.iter().map(of_touch).sum()))
    };
    effect_of_nonzero_columns((0..3).map(column))
}

/// Error motions are evaluated at the touches, not at the centre, because their slope distorts the sphere.
fn linear_error_motion_effect(plan: &Plan, centres: &[BallCentre]) -> ObservationEffect {
    let touches = || centres.iter().flat_map(|centre| &centre.touches);
    let points: Vec<Vector3<f64>> = touches().map(|touch| touch.axis_positions_mm).collect();
    let patterns = linear_motion_patterns(plan, &points);
    let column = |pattern: &[f64], along: Axis| {
        let along = along.nominal_direction();
        let deviations = touches().zip(pattern).map(|(touch, by)| touch.normal.dot(&along) * by);
        shift_column_from_touches(centres, deviations)
    };
    effect_of_nonzero_columns(patterns.iter().flat_map(|pattern| Axis::LINEAR.map(|a| column(pattern, a))))
}

/// One column per linear axis: drift of the table relative to the spindle at the declared rate, zero at the mean time
/// of the measurements, because the estimate describes the machine at that time.
fn drift_effect(plan: &Plan, centres: &[BallCentre]) -> ObservationEffect {
    let mean_s = centres.iter().map(|centre| centre.mean_time_s).sum::<f64>() / centres.len().max(1) as f64;
    let rate = drift_rate_sd_mm_per_s(plan);
    let shift = |axis: Axis| {
        centres.iter().map(move |centre| axis.nominal_direction() * (rate * (centre.mean_time_s - mean_s)))
    };
    effect_of_nonzero_columns(Axis::LINEAR.map(|axis| shift_column(shift(axis))))
}

/// A column of shifts of the measurements, from `deviations` of their touches along the normals, mm, one per
/// touch.
fn shift_column_from_touches(centres: &[BallCentre], mut deviations: impl Iterator<Item = f64>) -> Vec<f64> {
    shift_column(centres.iter().map(|centre| {
        let touches = centre.touches.iter().zip(deviations.by_ref());
        touches.map(|(touch, deviation)| touch.centre_gain * deviation).sum()
    }))
}
