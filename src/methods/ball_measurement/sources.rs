//! Uncertainty sources of the touches, as changes of the observations: X, Y, Z of each measurement (machine
//! frame, mm).

use nalgebra::{Rotation3, Vector3};

use super::effects::{nonzero_columns, nonzero_runs, shifts};
use super::interruptions;
use super::observe::{BallCentre, Observed, Touch};
use crate::identification::declared::{
    drift_mm_per_s, half_backlash_mm, linear_motion_patterns, lobing_patterns, repeatability_mm,
    resolution_mm,
};
use crate::identification::{Effect, EvaluationType, ObservationRun, Shape, UncertaintySource};
use machine::Axis;
use machine::record::plan::Plan;

/// Sources that act on the touches of every ball measurement, in this order: repeatability, resolution,
/// lobing, backlash, error motions of X, Y and Z, drift, interruptions. A source may have no draw.
pub fn touch_sources(plan: &Plan, observed: &Observed) -> Vec<UncertaintySource> {
    let centres = &observed.centres;
    let named = UncertaintySource::new;
    vec![
        UncertaintySource {
            evaluation: EvaluationType::A,
            ..named("repeatability of a touch", each_touch(centres, |_| repeatability_mm(plan)))
        },
        UncertaintySource {
            shape: Shape::Rectangular,
            ..named("resolution", each_touch(centres, |normal| resolution_mm(plan, normal)))
        },
        // Equal in all measurements: it does not change their relative weights.
        UncertaintySource { is_in_weights: false, ..named("probe lobing", lobing(plan, observed)) },
        UncertaintySource { is_in_weights: false, ..named("backlash", backlash(plan, centres)) },
        named("error motions of X, Y and Z", linear_axes(plan, centres)),
        named("thermal drift", drift(plan, centres)),
        // If the steps entered the weights, the measurements after an interruption would have less weight
        // than those before.
        UncertaintySource {
            is_in_weights: false,
            ..named("steps at interruptions", interruptions::steps(plan, centres))
        },
    ]
}

/// One draw per touch, of standard uncertainty `u` along its normal.
fn each_touch(centres: &[BallCentre], u: impl Fn(Vector3<f64>) -> f64) -> Effect {
    let of_centre = |(i, centre): (usize, &BallCentre)| -> Vec<ObservationRun> {
        let values = |touch: &Touch| (touch.gain * u(touch.normal)).as_slice().to_vec();
        let touches = centre.touches.iter();
        touches.map(|touch| ObservationRun { first: 3 * i, values: values(touch) }).collect()
    };
    nonzero_runs(centres.iter().enumerate().flat_map(of_centre))
}

/// Azimuths are computed in the spindle frame, because the probe turns with the spindle.
fn lobing(plan: &Plan, observed: &Observed) -> Effect {
    let sense = plan.machine.axes.get(&Axis::S).map_or(1.0, |spec| spec.positive.sign());
    let normals = observed.centres.iter().flat_map(|centre| {
        let spindle = sense * observed.places[centre.place].at(Axis::S);
        let into_spindle = Rotation3::from_axis_angle(&Vector3::z_axis(), -spindle);
        centre.touches.iter().map(move |touch| into_spindle * touch.normal)
    });
    let patterns = lobing_patterns(plan, &normals.collect::<Vec<_>>());
    let centres = &observed.centres;
    nonzero_columns(patterns.into_iter().map(|pattern| along_normals(centres, pattern.into_iter())))
}

/// Each axis lags behind the direction of the touch.
fn backlash(plan: &Plan, centres: &[BallCentre]) -> Effect {
    let half = half_backlash_mm(plan);
    let column = |k: usize| {
        let of_touch = |touch: &Touch| touch.gain * half[k] * touch.normal[k].abs();
        shifts(centres, |centre| centre.touches.iter().map(of_touch).sum())
    };
    nonzero_columns((0..3).map(column))
}

/// Evaluated at the touches, not at the centre, because the slope of a motion distorts the sphere.
fn linear_axes(plan: &Plan, centres: &[BallCentre]) -> Effect {
    let touches = || centres.iter().flat_map(|centre| &centre.touches);
    let points: Vec<Vector3<f64>> = touches().map(|touch| touch.point).collect();
    let patterns = linear_motion_patterns(plan, &points);
    let column = |pattern: &[f64], along: Axis| {
        let along = along.direction();
        let deviations = touches().zip(pattern).map(|(touch, by)| touch.normal.dot(&along) * by);
        along_normals(centres, deviations)
    };
    nonzero_columns(patterns.iter().flat_map(|pattern| Axis::LINEAR.map(|a| column(pattern, a))))
}

/// Drift of the table relative to the spindle at the declared rate, zero at the mean time of the
/// measurements: the estimate describes the machine at that time.
fn drift(plan: &Plan, centres: &[BallCentre]) -> Effect {
    let mean_s = centres.iter().map(|centre| centre.t_s).sum::<f64>() / centres.len().max(1) as f64;
    let rate = drift_mm_per_s(plan);
    let column =
        |axis: Axis| shifts(centres, |centre| axis.direction() * (rate * (centre.t_s - mean_s)));
    nonzero_columns(Axis::LINEAR.map(column))
}

/// A column of shifts of the measurements, from `deviations` of their touches along the normals, mm, one per
/// touch.
fn along_normals(centres: &[BallCentre], mut deviations: impl Iterator<Item = f64>) -> Vec<f64> {
    shifts(centres, |centre| {
        let touches = centre.touches.iter().zip(deviations.by_ref());
        touches.map(|(touch, deviation)| touch.gain * deviation).sum()
    })
}
