//! Whether C turns the way the machine file says.

use super::algebra::dot;
use super::fit::{Fit, Solved};
use super::model::{Layout, Observation};
use super::outputs;

/// Whether the readings confirm the stated sense of C.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sense {
    Confirmed,
    /// Either sense explains the readings: the part is too round and centred, or the design too
    /// sparse.
    NotConfirmed,
    /// The opposite sense explains the readings far better.
    Contradicted,
}

/// Solve with the opposite sense as well. Under the wrong one an eccentric part looks like an
/// error motion of twice its eccentricity; under the right one the error motion is small.
pub fn judge(fit: &Fit, sigma: &[f64], solved: &Solved) -> Sense {
    let n = fit.layout.design.n;
    let turned: Vec<Observation> =
        fit.observations.iter().map(|seen| Observation { c: (n - seen.c) % n, ..*seen }).collect();
    let radii: Vec<f64> = turned.iter().map(|seen| seen.radius).collect();
    let Ok(other) = Fit::new(fit.layout.clone(), turned, sigma, false) else {
        return Sense::NotConfirmed;
    };
    let stated = error_motion_rms(&fit.layout, &solved.x);
    let opposite = error_motion_rms(&fit.layout, &other.solve(&radii).x);
    // A factor of five is far beyond what scatter does to either figure.
    if opposite > 5.0 * stated {
        Sense::Confirmed
    } else if stated > 5.0 * opposite {
        Sense::Contradicted
    } else {
        Sense::NotConfirmed
    }
}

fn error_motion_rms(layout: &Layout, x: &[f64]) -> f64 {
    let functions = outputs::functions(layout, 0, "");
    let squares: f64 = functions
        .iter()
        .filter(|f| f.symbol == "EXC" || f.symbol == "EYC")
        .flat_map(|f| &f.points)
        .map(|point| dot(point, x).powi(2))
        .sum();
    squares.sqrt()
}
