//! Circle or sphere fit by Gauss–Newton steps from an algebraic initial value, for any number and arrangement of
//! points.

use faer::Mat;

use super::{RadialError, RadialFit, STEP_TOLERANCE};
use crate::linear_least_squares::{LinearProblem, LinearSolution, solve_least_squares};

/// Ratio of thickness to length (smallest to largest singular value) up to which the points count as flat (on one
/// line or in one plane), which is an error.
const MAX_FLAT_THICKNESS_RATIO: f64 = 1e-7;
const MAX_STEP_COUNT: usize = 1000;
/// Tolerance of the step after [`MAX_STEP_COUNT`]. If the deviations are as large as the radius, the steps shrink
/// slowly or alternate within their rounding, and this accuracy is sufficient.
const TOLERANCE_AFTER_MAX_STEPS: f64 = 1e-9;

/// Fits by an algebraic initial value (Kåsa 1976), then Gauss–Newton with each step halved until the deviations
/// decrease.
pub(super) fn fit_gauss_newton<const D: usize>(points: &[[f64; D]]) -> Result<RadialFit<D>, RadialError> {
    if points.len() <= D {
        return Err(RadialError::TooFewPoints(points.len()));
    }
    if points.iter().flatten().any(|number| !number.is_finite()) {
        return Err(RadialError::NotFinite);
    }
    // The differences of neighbouring points are exact, wherever the points are.
    let origin = points[0];
    let local: Vec<[f64; D]> = points.iter().map(|p| std::array::from_fn(|k| p[k] - origin[k])).collect();
    let centre = algebraic_centre(&local)?;
    let (at, step) = iterate_to_convergence(&local, PolarPoints::new(&local, centre))?;
    let centre = std::array::from_fn(|k| origin[k] + at.centre[k]);
    Ok(RadialFit { centre, radius: at.radius, residuals: at.residuals, covariance: step.covariance })
}

/// Returns the points about the best centre, and the last step, whose covariance is that of centre and radius.
fn iterate_to_convergence<const D: usize>(
    points: &[[f64; D]],
    start: PolarPoints<D>,
) -> Result<(PolarPoints<D>, LinearSolution), RadialError> {
    let mut at = start;
    for count in 0..=MAX_STEP_COUNT {
        let step = at.solve_step().ok_or(RadialError::NotConverged)?;
        let size = step_size_in_uncertainties(&step) / at.radius;
        if size <= STEP_TOLERANCE || (count == MAX_STEP_COUNT && size <= TOLERANCE_AFTER_MAX_STEPS) {
            return Ok((at.after_step(points, &step.x, 1.0), step));
        }
        let mut part = 1.0;
        at = loop {
            let next = at.after_step(points, &step.x, part);
            // Near the minimum the step is more accurate than the rounded distances.
            if next.residual_norm() <= at.residual_norm() + at.residual_norm_rounding() {
                break next;
            }
            if part * size <= STEP_TOLERANCE {
                return Ok((at, step));
            }
            part *= 0.5;
        };
    }
    Err(RadialError::NotConverged)
}

/// Largest step of a centre coordinate or of the radius, relative to its standard uncertainty for a radial standard
/// deviation of 1.
fn step_size_in_uncertainties(step: &LinearSolution) -> f64 {
    let parts = step.x.iter().enumerate().map(|(j, x)| x.abs() / step.covariance[(j, j)].sqrt());
    parts.fold(0.0, f64::max)
}

/// Centre c, in the coordinates of `points`, that minimises Σ(|p − c|² − r²)². Points on one line (D = 2) or in one
/// plane (D = 3) are an error.
fn algebraic_centre<const D: usize>(points: &[[f64; D]]) -> Result<[f64; D], RadialError> {
    let count = points.len();
    let mean: [f64; D] = std::array::from_fn(|k| points.iter().map(|p| p[k]).sum::<f64>() / count as f64);
    let mut a = Mat::from_fn(count, D, |i, k| points[i][k] - mean[k]);
    let spread = a.singular_values().map_err(|_| RadialError::NotConverged)?;
    if spread[D - 1] <= MAX_FLAT_THICKNESS_RATIO * spread[0] {
        return Err(RadialError::CollinearOrCoplanar);
    }
    a.resize_with(count, D + 1, |_, _| spread[0]);
    let half: Vec<f64> = (0..count).map(|i| 0.5 * (0..D).map(|k| a[(i, k)] * a[(i, k)]).sum::<f64>()).collect();
    let offset = solve_unweighted(&a, &half).ok_or(RadialError::CollinearOrCoplanar)?.x;
    Ok(std::array::from_fn(|k| mean[k] + offset[k]))
}

fn solve_unweighted(a: &Mat<f64>, y: &[f64]) -> Option<LinearSolution> {
    let sigma = vec![1.0; y.len()];
    let a = a.as_ref();
    solve_least_squares(&LinearProblem { a, y, sigma: &sigma, constraints: None, rank_threshold: 1e-14 }).ok()
}

/// The points relative to a centre, in polar form.
struct PolarPoints<const D: usize> {
    centre: [f64; D],
    radius: f64,
    /// Unit vectors from the centre to the points.
    directions: Vec<[f64; D]>,
    /// Distance from the centre less radius, one per point.
    residuals: Vec<f64>,
}

impl<const D: usize> PolarPoints<D> {
    /// The best radius for a given centre is the mean distance.
    fn new(points: &[[f64; D]], centre: [f64; D]) -> Self {
        let polar: Vec<([f64; D], f64)> = points.iter().map(|p| direction_and_distance(p, &centre)).collect();
        let distances = polar.iter().map(|(_, distance)| distance);
        let radius = distances.clone().sum::<f64>() / points.len() as f64;
        let residuals = distances.map(|distance| distance - radius).collect();
        let directions = polar.iter().map(|(direction, _)| *direction).collect();
        Self { centre, radius, directions, residuals }
    }

    /// Gauss–Newton step of the centre, then of the radius.
    fn solve_step(&self) -> Option<LinearSolution> {
        let a = Mat::from_fn(self.directions.len(), D + 1, |i, k| self.directions[i].get(k).copied().unwrap_or(1.0));
        solve_unweighted(&a, &self.residuals)
    }

    /// Moves the centre by the fraction `part` of `step`; the radius becomes the mean distance.
    fn after_step(&self, points: &[[f64; D]], step: &[f64], part: f64) -> Self {
        let centre = std::array::from_fn(|k| self.centre[k] + part * step[k]);
        Self::new(points, centre)
    }

    fn residual_norm(&self) -> f64 {
        self.residuals.iter().map(|r| r * r).sum::<f64>().sqrt()
    }

    /// Rounding error of the residual norm, caused by the rounding errors of the distances of the points from the
    /// centre.
    fn residual_norm_rounding(&self) -> f64 {
        4.0 * f64::EPSILON * self.radius * (self.residuals.len() as f64).sqrt()
    }
}

/// Unit vector and distance from the centre. The direction of a point at the centre is the zero vector, so the
/// point has no effect on the step.
fn direction_and_distance<const D: usize>(point: &[f64; D], centre: &[f64; D]) -> ([f64; D], f64) {
    let offset: [f64; D] = std::array::from_fn(|k| point[k] - centre[k]);
    let largest = offset.iter().fold(0.0, |largest: f64, part| largest.max(part.abs()));
    if largest == 0.0 {
        return (offset, 0.0);
    }
    let distance = largest * offset.iter().map(|part| (part / largest).powi(2)).sum::<f64>().sqrt();
    (offset.map(|part| part / distance), distance)
}
