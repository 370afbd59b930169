//! Each ball at each indexation as a measurement for the outlier check.

use nalgebra::Vector3;

use super::observe::ObservedBalls;
use super::setup::describe_rotary_axes_in_degrees;
use crate::identification::MeasurementToCheck;

/// One [`MeasurementToCheck`] per measured ball centre, in the order of `observed.centres`. `of_centre`: from the
/// index of a centre its residual, mm, the index of the first of its three residual rows, and the standard
/// uncertainty of a coordinate, mm.
pub fn measurements_for_outlier_check(
    observed: &ObservedBalls,
    of_centre: impl Fn(usize) -> (Vector3<f64>, usize, f64),
) -> Vec<MeasurementToCheck> {
    let measurement = |centre: usize| {
        let (residual, first, u_mm) = of_centre(centre);
        let measured = &observed.centres[centre];
        let (label, at) =
            (&measured.label, &observed.commanded_rotary_positions[measured.commanded_rotary_position_index]);
        let (ball, number) = (&label.ball, label.indexation_number());
        MeasurementToCheck {
            label: label.measurement_label(),
            description: format!("ball {ball} at indexation {number} ({})", describe_rotary_axes_in_degrees(at)),
            residual_rows: first..first + 3,
            residual_mm: residual.norm(),
            u_mm,
            mean_time_s: measured.mean_time_s,
        }
    };
    (0..observed.centres.len()).map(measurement).collect()
}
