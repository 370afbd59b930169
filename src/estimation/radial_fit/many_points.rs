//! Circle or sphere fit of very many points: the initial value comes from a subset, each step from sums over all
//! points. The gradient is summed from small numbers (deviations; directions less their mean, rotated to their
//! principal axes), so the normal equations lose no digits by squaring, even for a narrow cap.

use faer::{Mat, Side};
use rayon::prelude::*;

use super::gauss_newton::fit_gauss_newton;
use super::point_sums::{PointSums, StepFrame, compute_residuals, sum_points};
use super::{RadialFit, STEP_TOLERANCE};

/// Minimum number of points. Fewer are fitted by [`fit_gauss_newton`].
const MIN_POINT_COUNT_FOR_SUMS: usize = 1024;
/// Minimum number of points, evenly spaced in their order, for the initial value.
const INITIAL_FIT_POINT_COUNT: usize = 256;
/// Maximum number of steps. Points that resemble a circle or sphere need no more.
const MAX_STEP_COUNT: usize = 12;
/// Number of points per parallel sum. The sums are added in order, so the result does not depend on the threads.
const POINTS_PER_BLOCK: usize = 4096;

/// Gauss–Newton fit for many points: each step needs only sums over the points, which are computed in parallel.
/// `None`: too few points, or the fit fails; the caller then uses [`fit_gauss_newton`].
pub(super) fn fit_many_points<const D: usize>(points: &[[f64; D]]) -> Option<RadialFit<D>> {
    if points.len() < MIN_POINT_COUNT_FOR_SUMS {
        return None;
    }
    let mut frame = initial_frame(points)?;
    let tolerance = STEP_TOLERANCE * (points.len() as f64).sqrt();
    let mut before = f64::INFINITY;
    for _ in 0..MAX_STEP_COUNT {
        let all = sum_all_points(points, &frame);
        let step = FitStep::new(&all, &frame, points.len())?;
        // The step does not become smaller: Gauss–Newton without step control does not converge.
        if step.size_in_uncertainties >= before {
            return None;
        }
        before = step.size_in_uncertainties;
        frame = step.applied_to(&frame);
        if step.size_in_uncertainties <= tolerance {
            return Some(finish_fit(points, &frame, step));
        }
    }
    None
}

/// Frame of the first step: centre, radius and directions from a subset of the points.
fn initial_frame<const D: usize>(points: &[[f64; D]]) -> Option<StepFrame<D>> {
    let few: Vec<[f64; D]> = points.iter().step_by(points.len() / INITIAL_FIT_POINT_COUNT).copied().collect();
    let start = fit_gauss_newton(&few).ok()?;
    let origin = *points.first()?;
    let mut frame = StepFrame {
        origin,
        centre_from_origin: std::array::from_fn(|k| start.centre[k] - origin[k]),
        radius: start.radius,
        rotation: std::array::from_fn(|i| std::array::from_fn(|k| f64::from(u8::from(i == k)))),
        mean_direction: [0.0; D],
    };
    let subset_sums = sum_points(&few, &frame);
    let count = few.len() as f64;
    let mean = subset_sums.direction_sum.map(|v| v / count);
    let scatter =
        Mat::from_fn(D, D, |i, j| subset_sums.direction_product_sum[i.min(j)][i.max(j)] / count - mean[i] * mean[j]);
    let own = scatter.self_adjoint_eigen(Side::Lower).ok()?;
    frame.rotation = std::array::from_fn(|i| std::array::from_fn(|k| own.U()[(k, i)]));
    frame.mean_direction = frame.rotation.map(|row| (0..D).map(|k| row[k] * mean[k]).sum());
    Some(frame)
}

fn sum_all_points<const D: usize>(points: &[[f64; D]], frame: &StepFrame<D>) -> PointSums<D> {
    let parts: Vec<PointSums<D>> = points.par_chunks(POINTS_PER_BLOCK).map(|block| sum_points(block, frame)).collect();
    parts.into_iter().fold(PointSums::ZERO, |all, part| all.plus(&part))
}

/// Gauss–Newton step of centre and radius, computed from sums over all points.
struct FitStep<const D: usize> {
    /// Step of the centre, in the rotated frame.
    centre_step: [f64; D],
    radius_step: f64,
    /// Covariance of the rotated centre and the radius, for a standard uncertainty of 1 of each radial deviation.
    covariance: Mat<f64>,
    /// Largest step, in standard uncertainties for a radial standard deviation of one radius.
    size_in_uncertainties: f64,
}

impl<const D: usize> FitStep<D> {
    /// Computes the step. The radius is eliminated as the mean. D nearly independent equations remain.
    fn new(all: &PointSums<D>, frame: &StepFrame<D>, count: usize) -> Option<Self> {
        let n = count as f64;
        let mean = all.direction_sum.map(|v| v / n);
        let square =
            |i: usize, j: usize| all.direction_product_sum[i.min(j)][i.max(j)] - all.direction_sum[i] * mean[j];
        let scale: [f64; D] = std::array::from_fn(|i| square(i, i).sqrt());
        let scaled = Mat::from_fn(D, D, |i, j| square(i, j) / (scale[i] * scale[j]));
        let own = scaled.self_adjoint_eigen(Side::Lower).ok()?;
        let inverse = |i: usize, j: usize| -> f64 {
            let part = |k: usize| own.U()[(i, k)] * own.U()[(j, k)] / own.S()[k];
            (0..D).map(part).sum::<f64>() / (scale[i] * scale[j])
        };
        let pull: [f64; D] = std::array::from_fn(|i| all.direction_residual_sum[i] - mean[i] * all.residual_sum);
        let centre: [f64; D] = std::array::from_fn(|i| (0..D).map(|j| inverse(i, j) * pull[j]).sum());
        // The directions relative to 0, not relative to their mean.
        let whole: [f64; D] = std::array::from_fn(|i| frame.mean_direction[i] + mean[i]);
        let radius = all.residual_sum / n - (0..D).map(|i| whole[i] * centre[i]).sum::<f64>();
        let covariance = step_covariance(inverse, &whole, n);
        let size = |j: usize| {
            let moved = centre.get(j).copied().unwrap_or(radius);
            moved.abs() / covariance[(j, j)].sqrt() / frame.radius
        };
        let size = (0..=D).map(size).try_fold(0.0, |most: f64, size| size.is_finite().then_some(most.max(size)))?;
        Some(Self { centre_step: centre, radius_step: radius, covariance, size_in_uncertainties: size })
    }

    fn applied_to(&self, frame: &StepFrame<D>) -> StepFrame<D> {
        let back = |k: usize| (0..D).map(|i| frame.rotation[i][k] * self.centre_step[i]).sum::<f64>();
        StepFrame {
            centre_from_origin: std::array::from_fn(|k| frame.centre_from_origin[k] + back(k)),
            radius: frame.radius + self.radius_step,
            ..*frame
        }
    }
}

/// Covariance of the rotated centre and the radius.
fn step_covariance<const D: usize>(
    inverse: impl Fn(usize, usize) -> f64,
    mean_direction: &[f64; D],
    count: f64,
) -> Mat<f64> {
    let with = |i: usize| (0..D).map(|k| inverse(i, k) * mean_direction[k]).sum::<f64>();
    Mat::from_fn(D + 1, D + 1, |i, j| match (i < D, j < D) {
        (true, true) => inverse(i, j),
        (true, false) => -with(i),
        (false, true) => -with(j),
        (false, false) => 1.0 / count + (0..D).map(|k| mean_direction[k] * with(k)).sum::<f64>(),
    })
}

/// Computes the residuals of all points, and turns the covariance back to the frame of the points.
fn finish_fit<const D: usize>(points: &[[f64; D]], frame: &StepFrame<D>, step: FitStep<D>) -> RadialFit<D> {
    let mut residuals = vec![0.0; points.len()];
    let blocks = points.par_chunks(POINTS_PER_BLOCK).zip(residuals.par_chunks_mut(POINTS_PER_BLOCK));
    blocks.for_each(|(points, part)| compute_residuals(points, frame, part));
    let turn = Mat::from_fn(D + 1, D + 1, |i, k| match (i < D, k < D) {
        (true, true) => frame.rotation[i][k],
        _ => f64::from(u8::from(i == k)),
    });
    let centre = std::array::from_fn(|k| frame.origin[k] + frame.centre_from_origin[k]);
    let covariance = turn.transpose() * step.covariance * &turn;
    RadialFit { centre, radius: frame.radius, residuals, covariance }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::random;
    use rand::RngExt;

    /// Points on a spherical cap about an inclined axis, far from the origin, with radial deviations up to `noise`.
    fn spherical_cap_points(count: usize, half_angle_rad: f64, noise: f64) -> Vec<[f64; 3]> {
        let mut stream = random::seeded_stream(7, &[count as u64]);
        let axis = nalgebra::Vector3::new(0.6, -0.3, 0.7).normalize();
        let u = axis.cross(&nalgebra::Vector3::x()).normalize();
        let v = axis.cross(&u);
        let point = |_| {
            let z: f64 = stream.random_range(half_angle_rad.cos()..1.0);
            let (sin, cos) = stream.random_range(0.0..TAU).sin_cos();
            let level = (1.0 - z * z).sqrt();
            let radius = 10.0 + noise * stream.random_range(-1.0..1.0);
            let offset = (u * (level * cos) + v * (level * sin) + axis * z) * radius;
            (nalgebra::Vector3::new(1e3, -200.0, 500.0) + offset).into()
        };
        (0..count).map(point).collect()
    }

    /// The fit by sums succeeds and agrees with the Gauss–Newton fit.
    #[test]
    fn sphere_by_sums_agrees_with_gauss_newton() {
        for (half, noise) in [(1.5, 1e-3), (0.5, 0.1), (0.02, 1e-6), (0.5, 0.0)] {
            let points = spherical_cap_points(5000, half, noise);
            let (by_sums, by_care) = (fit_many_points(&points).unwrap(), fit_gauss_newton(&points).unwrap());
            let spread = (5000.0 * by_care.covariance[(3, 3)]).sqrt();
            let rounding = 4.0 * f64::EPSILON * (10.0 * spread + 1e3);
            let pairs = by_sums.centre.iter().zip(&by_care.centre);
            let worst = pairs
                .chain([(&by_sums.radius, &by_care.radius)])
                .map(|(one, other)| (one - other).abs())
                .fold(0.0, f64::max);
            assert!(worst < rounding, "{half} {noise}: {worst:e} {rounding:e}");
            for i in 0..4 {
                for j in 0..4 {
                    let scale = (by_care.covariance[(i, i)] * by_care.covariance[(j, j)]).sqrt();
                    let off = by_sums.covariance[(i, j)] - by_care.covariance[(i, j)];
                    assert!(off.abs() < 1e-9 * scale, "{half} {noise}: {off:e} of {scale:e}");
                }
            }
        }
    }

    #[test]
    fn unsuitable_points_are_left_to_gauss_newton() {
        assert!(fit_many_points(&spherical_cap_points(1000, 0.5, 1e-3)).is_none());
        let mut points = spherical_cap_points(5000, 0.5, 1e-3);
        points[4321][1] = f64::NAN;
        assert!(fit_many_points(&points).is_none());
        let flat: Vec<[f64; 3]> = spherical_cap_points(5000, 0.5, 1e-3).iter().map(|p| [p[0], p[1], 3.0]).collect();
        assert!(fit_many_points(&flat).is_none());
        // Points that do not resemble a sphere: a cube filled at random.
        let mut stream = random::seeded_stream(8, &[]);
        let mut side = || stream.random_range(-1.0..1.0);
        let cube: Vec<[f64; 3]> = (0..5000).map(|_| [side(), side(), side()]).collect();
        if let Some(found) = fit_many_points(&cube) {
            let fit_gauss_newton = fit_gauss_newton(&cube).unwrap();
            assert!((found.radius - fit_gauss_newton.radius).abs() < 1e-9);
        }
    }
}
