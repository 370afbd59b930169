//! Sources of uncertainty as changes of the observations: X, Y, Z of each measurement (machine frame,
//! mm), then each certified length (mm).

mod interruptions;
mod rotary;

use nalgebra::{Rotation3, Vector3};

use super::model::length_u_parts_mm;
use super::observe::{Observed, Sight, Touch};
use crate::identification::declared::{
    drift_mm_per_s, linear_motion_patterns, lobing_patterns, repeatability_mm, resolution_mm,
};
use crate::identification::{
    Effect, EvaluationType, InResiduals, ObservationRun, Shape, UncertaintySource,
};
use machine::Axis;
use machine::kinematics::Chain;
use machine::record::artefact::Length;
use machine::record::plan::Plan;

/// Draws that change nothing are left out.
pub fn sources(
    plan: &Plan,
    chain: &Chain,
    observed: &Observed,
    lengths: &[Length],
) -> Vec<UncertaintySource> {
    let sights = &observed.sights;
    let named = UncertaintySource::new;
    let mut list = vec![
        UncertaintySource {
            evaluation: EvaluationType::A,
            ..named("repeatability of a touch", each_touch(sights, |_| repeatability_mm(plan)))
        },
        UncertaintySource {
            shape: Shape::Rectangular,
            ..named("resolution", each_touch(sights, |normal| resolution_mm(plan, normal)))
        },
        // Alike in all measurements: none has less weight for it.
        UncertaintySource { is_in_weights: false, ..named("probe lobing", lobing(plan, observed)) },
        named("error motions of X, Y and Z", linear_axes(plan, sights)),
        named("error motions of rotary axes", rotary::error_motions(plan, chain, observed)),
        named("thermal drift", drift(plan, sights)),
        // In the weights it would set the measurements after an interruption below those before.
        UncertaintySource {
            is_in_weights: false,
            ..named("steps at interruptions", interruptions::steps(plan, sights))
        },
    ];
    list.extend(certificates(sights.len(), lengths));
    list.retain(|source| source.draws() > 0);
    list
}

/// One draw a touch, of standard uncertainty `u` along its normal.
fn each_touch(sights: &[Sight], u: impl Fn(Vector3<f64>) -> f64) -> Effect {
    let of_sight = |(i, sight): (usize, &Sight)| -> Vec<ObservationRun> {
        let values = |touch: &Touch| (touch.gain * u(touch.normal)).as_slice().to_vec();
        let touches = sight.touches.iter();
        touches.map(|touch| ObservationRun { first: 3 * i, values: values(touch) }).collect()
    };
    nonzero_runs(sights.iter().enumerate().flat_map(of_sight))
}

/// The probe turns with the spindle.
fn lobing(plan: &Plan, observed: &Observed) -> Effect {
    let sense = plan.machine.axes.get(&Axis::S).map_or(1.0, |spec| spec.positive.sign());
    let normals = observed.sights.iter().flat_map(|sight| {
        let spindle = sense * observed.places[sight.place].at(Axis::S);
        let into_spindle = Rotation3::from_axis_angle(&Vector3::z_axis(), -spindle);
        sight.touches.iter().map(move |touch| into_spindle * touch.normal)
    });
    let patterns = lobing_patterns(plan, &normals.collect::<Vec<_>>());
    let sights = &observed.sights;
    nonzero_columns(patterns.into_iter().map(|pattern| along_normals(sights, pattern.into_iter())))
}

/// At the touches, not at the centre: the slope of a motion changes the sphere.
fn linear_axes(plan: &Plan, sights: &[Sight]) -> Effect {
    let touches = || sights.iter().flat_map(|sight| &sight.touches);
    let points: Vec<Vector3<f64>> = touches().map(|touch| touch.point).collect();
    let patterns = linear_motion_patterns(plan, &points);
    let column = |pattern: &[f64], along: Axis| {
        let along = along.direction();
        let deviations = touches().zip(pattern).map(|(touch, by)| touch.normal.dot(&along) * by);
        along_normals(sights, deviations)
    };
    nonzero_columns(patterns.iter().flat_map(|pattern| Axis::LINEAR.map(|a| column(pattern, a))))
}

/// The table against the spindle at the declared rate, zero at the mean time of the measurements: the
/// estimate is the machine at that time.
fn drift(plan: &Plan, sights: &[Sight]) -> Effect {
    let mean_s = sights.iter().map(|sight| sight.t_s).sum::<f64>() / sights.len().max(1) as f64;
    let rate = drift_mm_per_s(plan);
    let column =
        |axis: Axis| shifts(sights, |sight| axis.direction() * (rate * (sight.t_s - mean_s)));
    nonzero_columns(Axis::LINEAR.map(column))
}

fn certificates(sights: usize, lengths: &[Length]) -> [UncertaintySource; 2] {
    [("certified length", 0), ("temperature of the certified length", 1)].map(|(name, part)| {
        let runs = lengths.iter().enumerate().map(|(i, length)| ObservationRun {
            first: 3 * sights + i,
            values: vec![length_u_parts_mm(length)[part]],
        });
        UncertaintySource {
            // The error of a certificate scales all together: few residuals contain it.
            in_residuals: InResiduals::Expected,
            is_in_weights: false,
            ..UncertaintySource::new(name, nonzero_runs(runs))
        }
    })
}

/// A column: shifts of the measurements by `deviations` of their touches along the normals, mm, one a
/// touch.
fn along_normals(sights: &[Sight], mut deviations: impl Iterator<Item = f64>) -> Vec<f64> {
    shifts(sights, |sight| {
        let touches = sight.touches.iter().zip(deviations.by_ref());
        touches.map(|(touch, deviation)| touch.gain * deviation).sum()
    })
}

/// A column: the `shift` of each measurement.
fn shifts(sights: &[Sight], shift: impl FnMut(&Sight) -> Vector3<f64>) -> Vec<f64> {
    let shifts: Vec<[f64; 3]> = sights.iter().map(shift).map(Into::into).collect();
    shifts.into_flattened()
}

fn nonzero_columns(columns: impl IntoIterator<Item = Vec<f64>>) -> Effect {
    Effect::Joint(columns.into_iter().filter(|column| !is_zero(column)).collect())
}

fn nonzero_runs(runs: impl Iterator<Item = ObservationRun>) -> Effect {
    Effect::Runs(runs.filter(|run| !is_zero(&run.values)).collect())
}

fn is_zero(changes: &[f64]) -> bool {
    changes.iter().all(|change| *change == 0.0)
}
