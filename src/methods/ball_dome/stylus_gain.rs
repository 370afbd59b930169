//! The stylus for which the positions of each ball at many indexations agree best. The certificate is not
//! used (paper 4, section 7, N2 to S3).

use nalgebra::{Matrix3, Vector3};

/// Minimum ratio of smallest to largest singular value of the equations; below it the stylus is not
/// determined.
const MIN_SINGULAR_VALUE_RATIO: f64 = 1e-6;

/// Gain of the stylus for a change of each point in the table frame: the change of the stylus is the sum of
/// gain·change.
pub type StylusGain = Vec<Matrix3<f64>>;

/// The least-squares gain; zero for points of balls that are not included. `point_derivatives`: derivative of each
/// point by the stylus; `ball_indices`: ball of each point. `None`: the indexations do not determine the stylus.
pub fn stylus_gain(
    point_derivatives: &[Matrix3<f64>],
    ball_indices: &[usize],
    includes_ball: impl Fn(usize) -> bool,
) -> Option<StylusGain> {
    let balls = ball_indices.iter().max().map_or(0, |last| last + 1);
    let (mut sums, mut numbers) = (vec![Matrix3::zeros(); balls], vec![0.0; balls]);
    for (ball, column) in ball_indices.iter().zip(point_derivatives) {
        sums[*ball] += column;
        numbers[*ball] += 1.0;
    }
    // The mean position of each ball is an unknown too.
    let centred = |(ball, column): (&usize, &Matrix3<f64>)| match includes_ball(*ball) {
        true => column - sums[*ball] / numbers[*ball],
        false => Matrix3::zeros(),
    };
    let centred: Vec<Matrix3<f64>> = ball_indices.iter().zip(point_derivatives).map(centred).collect();
    let normal: Matrix3<f64> = centred.iter().map(|column| column.transpose() * column).sum();
    let singular = normal.symmetric_eigenvalues();
    let is_determined = singular.min() > MIN_SINGULAR_VALUE_RATIO.powi(2) * singular.max();
    let inverse = normal.try_inverse().filter(|_| is_determined)?;
    Some(centred.iter().map(|column| -inverse * column.transpose()).collect())
}

/// The change of the stylus from the changes of the points.
pub fn stylus_change(gain: &StylusGain, changes: &[Vector3<f64>]) -> Vector3<f64> {
    gain.iter().zip(changes).map(|(gain, change)| gain * change).sum()
}
