//! The identification as paper 2 describes it (Eqs. 5 to 7, 17 and 19, with the columns of METHODS section 2 in
//! place of Eq. 18), for comparison. It takes the single measurement at B = C = 0 as the truth, and the zero
//! position from the circles of both axes. The estimate of `trued` has unknowns for both.

use faer::Mat;
use nalgebra::{Rotation3, Vector3};

use super::bench::LaserSetup;
use super::centres::Centres;
use super::group::Grouped;
use estimation::circle::fit_circle;
use estimation::linear::{LinearProblem, RANK_THRESHOLD, solve};
use machine::frame::unit_vector;
use machine::record::machine::Sense;
use machine::{Axis, Position};

/// Rotary angles below this count as zero, rad.
const ZERO: f64 = 1e-9;
/// Largest distance between two stated axes that count as intersecting.
const MEETS_MM: f64 = 1e-6;

/// W = (α_BY, β_BY, γ_BY, δx_CB, α_CB), rad and mm. `None`: the machine is not that of the paper (a B table that
/// carries C), or its circles were not measured.
pub fn identify(bench: &LaserSetup<'_>, grouped: &Grouped, x: &[f64]) -> Option<[f64; 5]> {
    let machine = &bench.plan.machine;
    let iso = |axis| machine.axes.get(&axis).is_some_and(|spec| spec.positive == Sense::Iso);
    let table = super::parameters::of_table(&bench.chain);
    if bench.touches() || table != [Axis::B, Axis::C] || !iso(Axis::B) || !iso(Axis::C) {
        return None;
    }
    let centres = unit_beam(&grouped.centres, x);
    let fitted = centres.solve().ok()?;
    let places: Vec<(&Position, Vector3<f64>)> = grouped
        .groups
        .iter()
        .enumerate()
        .map(|(i, group)| (&group.rotary, centres.centre(&fitted.x, i)))
        .collect();
    let origin = intersection(bench)?;
    let zero = zero_position(&places, origin)?;
    let seen: Vec<(f64, f64, Vector3<f64>)> = places
        .iter()
        .map(|(at, centre)| (at.at(Axis::B), at.at(Axis::C), *centre - zero - origin))
        .collect();
    location_errors(&seen)
}

/// Copy of `centres` with the beam of the fit held at norm 1.
fn unit_beam(centres: &Centres, x: &[f64]) -> Centres {
    let lean = centres.frame.transpose() * unit_vector(centres.beam(x)).unwrap_or_default();
    Centres { free: false, held: [lean.x, lean.y, lean.z - 1.0], ..centres.clone() }
}

/// Origin of the paper's equations: the stated intersection of B and C. `None`: they do not intersect.
fn intersection(bench: &LaserSetup<'_>) -> Option<Vector3<f64>> {
    let point = |axis: Axis| bench.plan.machine.axes.get(&axis).map(|spec| spec.point_mm);
    let ([bx, _, z], [x, y, _]) = (point(Axis::B)?, point(Axis::C)?);
    ((bx - x).abs() < MEETS_MM).then(|| Vector3::new(x, y, z))
}

/// Zero position by Eq. (7): x and y from the circle of C at B = 0, z from the circle of B at C = 0.
fn zero_position(
    places: &[(&Position, Vector3<f64>)],
    origin: Vector3<f64>,
) -> Option<Vector3<f64>> {
    let circle = |other: Axis, i: usize, j: usize| {
        let here = places.iter().filter(|(at, _)| at.at(other).abs() < ZERO);
        let points: Vec<[f64; 2]> = here.map(|(_, centre)| [centre[i], centre[j]]).collect();
        fit_circle(&points).ok().map(|circle| circle.centre)
    };
    let (of_c, of_b) = (circle(Axis::B, 0, 1)?, circle(Axis::C, 0, 2)?);
    Some(Vector3::new(of_c[0], of_c[1], of_b[1]) - origin)
}

/// Location errors by Eq. (19): unweighted least squares over (B, C, measured position of the sphere).
pub fn location_errors(seen: &[(f64, f64, Vector3<f64>)]) -> Option<[f64; 5]> {
    let (_, _, first) = *seen.iter().find(|(b, c, _)| b.abs() < ZERO && c.abs() < ZERO)?;
    let others: Vec<_> = seen.iter().filter(|(b, c, _)| b.abs() + c.abs() >= ZERO).collect();
    let mut a = Mat::zeros(3 * others.len(), 5);
    let mut y = Vec::with_capacity(3 * others.len());
    for (i, (b, c, measured)) in others.into_iter().enumerate() {
        let nominal = nominal(*b, *c) * first;
        y.extend(&(measured - nominal));
        for (j, column) in columns(*b, *c, first).into_iter().enumerate() {
            (0..3).for_each(|k| a[(3 * i + k, j)] = column[k]);
        }
    }
    let sigma = vec![1.0; y.len()];
    let problem = LinearProblem {
        a: a.as_ref(),
        y: &y,
        sigma: &sigma,
        constraints: None,
        rank_threshold: RANK_THRESHOLD,
    };
    solve(&problem).ok()?.x.try_into().ok()
}

/// Nominal rotation D_b(−B)·D_c(−C).
pub fn nominal(b: f64, c: f64) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Vector3::y_axis(), -b)
        * Rotation3::from_axis_angle(&Vector3::z_axis(), -c)
}

/// ∂d/∂W at one pose: ∂q̂/∂W less the contribution of the measurement at B = C = 0.
pub fn columns(b: f64, c: f64, w: Vector3<f64>) -> [Vector3<f64>; 5] {
    let turn = nominal(b, c);
    let (here, first) = (of_sphere(b, turn * w, w), of_sphere(0.0, w, w));
    std::array::from_fn(|j| here[j] - turn * first[j])
}

/// ∂q̂/∂W, with q the nominal position of the sphere at the pose and w its position at B = C = 0.
fn of_sphere(b: f64, q: Vector3<f64>, w: Vector3<f64>) -> [Vector3<f64>; 5] {
    let (s, c) = b.sin_cos();
    [
        Vector3::new(0.0, w.z - q.z, q.y - w.y),
        Vector3::new(q.z - w.z, 0.0, -q.x),
        Vector3::new(-q.y, q.x, 0.0),
        Vector3::new(c - 1.0, 0.0, s),
        Vector3::new(-q.y * s, 0.0, q.y * c),
    ]
}
