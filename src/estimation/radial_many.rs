//! Circle or sphere of very many points: a few of them make the start, sums over all the steps. The
//! gradient is summed from small numbers (deviations; directions less their mean, turned so that a
//! narrow cap does not hide in a wide one), so that the squares of the normal equations cost no digits.

use faer::{Mat, Side};
use rayon::prelude::*;

use super::radial::{Radial, TOLERANCE, careful};
use super::radial_lanes::{Frame, Sums, residuals, sums};

/// Fewer are for the careful way.
const MANY: usize = 1024;
/// Of which the start is made.
const FEW: usize = 256;
/// More are not needed where points resemble a sphere at all.
const MAX_STEPS: usize = 12;
/// Summed at once: what is added up in order afterwards does not depend on the threads.
const BLOCK: usize = 4096;

/// `None`: too few, or something is the matter, which the careful way tells.
pub(super) fn fit<const D: usize>(points: &[[f64; D]]) -> Option<Radial<D>> {
    if points.len() < MANY {
        return None;
    }
    let mut frame = frame(points)?;
    let tolerance = TOLERANCE * (points.len() as f64).sqrt();
    let mut before = f64::INFINITY;
    for _ in 0..MAX_STEPS {
        let all = total(points, &frame);
        let step = Step::new(&all, &frame, points.len())?;
        // No way for plain steps.
        if step.size >= before {
            return None;
        }
        before = step.size;
        frame = step.moved(&frame);
        if step.size <= tolerance {
            return Some(finished(points, &frame, step));
        }
    }
    None
}

/// Centre, radius and directions as a few of the points see them.
fn frame<const D: usize>(points: &[[f64; D]]) -> Option<Frame<D>> {
    let few: Vec<[f64; D]> = points.iter().step_by(points.len() / FEW).copied().collect();
    let start = careful(&few).ok()?;
    let origin = *points.first()?;
    let mut frame = Frame {
        origin,
        centre: std::array::from_fn(|k| start.centre[k] - origin[k]),
        radius: start.radius,
        turn: std::array::from_fn(|i| std::array::from_fn(|k| f64::from(u8::from(i == k)))),
        mean: [0.0; D],
    };
    let seen = sums(&few, &frame);
    let count = few.len() as f64;
    let mean = seen.v.map(|v| v / count);
    let scatter =
        Mat::from_fn(D, D, |i, j| seen.vv[i.min(j)][i.max(j)] / count - mean[i] * mean[j]);
    let own = scatter.self_adjoint_eigen(Side::Lower).ok()?;
    frame.turn = std::array::from_fn(|i| std::array::from_fn(|k| own.U()[(k, i)]));
    frame.mean = frame.turn.map(|row| (0..D).map(|k| row[k] * mean[k]).sum());
    Some(frame)
}

fn total<const D: usize>(points: &[[f64; D]], frame: &Frame<D>) -> Sums<D> {
    let parts: Vec<Sums<D>> = points.par_chunks(BLOCK).map(|block| sums(block, frame)).collect();
    parts.into_iter().fold(Sums::ZERO, |all, part| all.plus(&part))
}

struct Step<const D: usize> {
    /// Of the centre, turned, and of the radius.
    centre: [f64; D],
    radius: f64,
    covariance: Mat<f64>,
    /// Largest, in standard uncertainties that a radial deviation of one radius would cause.
    size: f64,
}

impl<const D: usize> Step<D> {
    /// The radius is the mean that is left; without it D equations, nearly without each other.
    fn new(all: &Sums<D>, frame: &Frame<D>, count: usize) -> Option<Self> {
        let n = count as f64;
        let mean = all.v.map(|v| v / n);
        let square = |i: usize, j: usize| all.vv[i.min(j)][i.max(j)] - all.v[i] * mean[j];
        let scale: [f64; D] = std::array::from_fn(|i| square(i, i).sqrt());
        let scaled = Mat::from_fn(D, D, |i, j| square(i, j) / (scale[i] * scale[j]));
        let own = scaled.self_adjoint_eigen(Side::Lower).ok()?;
        let inverse = |i: usize, j: usize| -> f64 {
            let part = |k: usize| own.U()[(i, k)] * own.U()[(j, k)] / own.S()[k];
            (0..D).map(part).sum::<f64>() / (scale[i] * scale[j])
        };
        let pull: [f64; D] = std::array::from_fn(|i| all.vr[i] - mean[i] * all.r);
        let centre: [f64; D] =
            std::array::from_fn(|i| (0..D).map(|j| inverse(i, j) * pull[j]).sum());
        // Where the directions stand off from, they are from 0, not from their mean.
        let whole: [f64; D] = std::array::from_fn(|i| frame.mean[i] + mean[i]);
        let radius = all.r / n - (0..D).map(|i| whole[i] * centre[i]).sum::<f64>();
        let covariance = covariance(inverse, &whole, n);
        let size = |j: usize| {
            let moved = centre.get(j).copied().unwrap_or(radius);
            moved.abs() / covariance[(j, j)].sqrt() / frame.radius
        };
        let size = (0..=D)
            .map(size)
            .try_fold(0.0, |most: f64, size| size.is_finite().then_some(most.max(size)))?;
        Some(Self { centre, radius, covariance, size })
    }

    fn moved(&self, frame: &Frame<D>) -> Frame<D> {
        let back = |k: usize| (0..D).map(|i| frame.turn[i][k] * self.centre[i]).sum::<f64>();
        Frame {
            centre: std::array::from_fn(|k| frame.centre[k] + back(k)),
            radius: frame.radius + self.radius,
            ..*frame
        }
    }
}

/// Of the turned centre and the radius; `whole`: the mean direction.
fn covariance<const D: usize>(
    inverse: impl Fn(usize, usize) -> f64,
    whole: &[f64; D],
    n: f64,
) -> Mat<f64> {
    let with = |i: usize| (0..D).map(|k| inverse(i, k) * whole[k]).sum::<f64>();
    Mat::from_fn(D + 1, D + 1, |i, j| match (i < D, j < D) {
        (true, true) => inverse(i, j),
        (true, false) => -with(i),
        (false, true) => -with(j),
        (false, false) => 1.0 / n + (0..D).map(|k| whole[k] * with(k)).sum::<f64>(),
    })
}

fn finished<const D: usize>(points: &[[f64; D]], frame: &Frame<D>, step: Step<D>) -> Radial<D> {
    let mut all = vec![0.0; points.len()];
    let blocks = points.par_chunks(BLOCK).zip(all.par_chunks_mut(BLOCK));
    blocks.for_each(|(points, part)| residuals(points, frame, part));
    let turn = Mat::from_fn(D + 1, D + 1, |i, k| match (i < D, k < D) {
        (true, true) => frame.turn[i][k],
        _ => f64::from(u8::from(i == k)),
    });
    Radial {
        centre: std::array::from_fn(|k| frame.origin[k] + frame.centre[k]),
        radius: frame.radius,
        residuals: all,
        covariance: turn.transpose() * step.covariance * &turn,
    }
}
