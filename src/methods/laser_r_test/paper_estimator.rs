//! The identification as paper 2 describes it (Eqs. 5 to 7, 17 and 19, with the columns of METHODS section 2 in
//! place of Eq. 18), for comparison. It takes the single measurement at B = C = 0 as the truth, and the zero
//! position from the circles of both axes. The estimate of `trued` has unknowns for both.

use faer::Mat;
use nalgebra::{Rotation3, Vector3};

use super::centre_equations::CentreEquations;
use super::pose_groups::GroupedScans;
use super::setup::LaserSetup;
use estimation::circle::fit_circle;
use estimation::linear_least_squares::{LinearProblem, RANK_THRESHOLD, solve_least_squares};
use machine::frame::unit_vector;
use machine::record::machine::AxisSense;
use machine::{Axis, Position};

/// Rotary angles below this count as zero, rad.
const ZERO_ANGLE_TOLERANCE_RAD: f64 = 1e-9;
/// Largest distance between two stated axes that count as intersecting.
const AXIS_INTERSECTION_TOLERANCE_MM: f64 = 1e-6;

/// W = (α_BY, β_BY, γ_BY, δx_CB, α_CB), rad and mm. `None`: a touch probe was used, the machine is not that of
/// the paper (a B table that carries C, axes that intersect), or its circles were not measured.
pub fn identify_by_paper_method(setup: &LaserSetup<'_>, grouped: &GroupedScans, x: &[f64]) -> Option<[f64; 5]> {
    let machine = &setup.plan.machine;
    let iso = |axis| machine.axes.get(&axis).is_some_and(|spec| spec.positive == AxisSense::Iso);
    let table = super::parameter_selection::table_rotary_axes(&setup.chain);
    if setup.uses_touch_probe() || table != [Axis::B, Axis::C] || !iso(Axis::B) || !iso(Axis::C) {
        return None;
    }
    let centres = with_unit_beam(&grouped.centre_equations, x);
    let fitted = centres.solve().ok()?;
    let centres_by_pose: Vec<(&Position, Vector3<f64>)> = grouped
        .groups
        .iter()
        .enumerate()
        .map(|(i, group)| (&group.rotary, centres.group_centre(&fitted.x, i)))
        .collect();
    let origin = axis_intersection(setup)?;
    let zero = zero_position_from_circles(&centres_by_pose, origin)?;
    let measured: Vec<(f64, f64, Vector3<f64>)> = centres_by_pose
        .iter()
        .map(|(at, centre)| (at.get_or_zero(Axis::B), at.get_or_zero(Axis::C), *centre - zero - origin))
        .collect();
    location_errors_by_least_squares(&measured)
}

/// Copy of `centres` with the beam of the fit held at norm 1.
fn with_unit_beam(centres: &CentreEquations, x: &[f64]) -> CentreEquations {
    let beam = centres.beam_frame.transpose() * unit_vector(centres.beam_vector(x)).unwrap_or_default();
    CentreEquations { is_beam_free: false, fixed_beam_values: [beam.x, beam.y, beam.z - 1.0], ..centres.clone() }
}

/// Origin of the paper's equations: the stated intersection of B and C. `None`: they do not intersect.
fn axis_intersection(setup: &LaserSetup<'_>) -> Option<Vector3<f64>> {
    let point = |axis: Axis| setup.plan.machine.axes.get(&axis).map(|spec| spec.point_mm);
    let ([bx, _, z], [x, y, _]) = (point(Axis::B)?, point(Axis::C)?);
    ((bx - x).abs() < AXIS_INTERSECTION_TOLERANCE_MM).then(|| Vector3::new(x, y, z))
}

/// Zero position by Eq. (7): x and y from the circle of C at B = 0, z from the circle of B at C = 0.
fn zero_position_from_circles(
    centres_by_pose: &[(&Position, Vector3<f64>)],
    origin: Vector3<f64>,
) -> Option<Vector3<f64>> {
    let circle = |fixed: Axis, i: usize, j: usize| {
        let circle_points =
            centres_by_pose.iter().filter(|(at, _)| at.get_or_zero(fixed).abs() < ZERO_ANGLE_TOLERANCE_RAD);
        let points: Vec<[f64; 2]> = circle_points.map(|(_, centre)| [centre[i], centre[j]]).collect();
        fit_circle(&points).ok().map(|circle| circle.centre)
    };
    let (circle_c, circle_b) = (circle(Axis::B, 0, 1)?, circle(Axis::C, 0, 2)?);
    Some(Vector3::new(circle_c[0], circle_c[1], circle_b[1]) - origin)
}

/// W by Eq. (19): unweighted least squares over (B, C, measured position of the sphere), rad and mm. `None`: there is
/// no measurement at B = C = 0, or the errors are not determined.
pub fn location_errors_by_least_squares(measured: &[(f64, f64, Vector3<f64>)]) -> Option<[f64; 5]> {
    let (_, _, first) =
        *measured.iter().find(|(b, c, _)| b.abs() < ZERO_ANGLE_TOLERANCE_RAD && c.abs() < ZERO_ANGLE_TOLERANCE_RAD)?;
    let others: Vec<_> = measured.iter().filter(|(b, c, _)| b.abs() + c.abs() >= ZERO_ANGLE_TOLERANCE_RAD).collect();
    let mut a = Mat::zeros(3 * others.len(), 5);
    let mut y = Vec::with_capacity(3 * others.len());
    for (i, (b, c, position)) in others.into_iter().enumerate() {
        let nominal = nominal_rotation(*b, *c) * first;
        y.extend(&(position - nominal));
        for (j, column) in location_error_derivatives(*b, *c, first).into_iter().enumerate() {
            (0..3).for_each(|k| a[(3 * i + k, j)] = column[k]);
        }
    }
    let sigma = vec![1.0; y.len()];
    let problem =
        LinearProblem { a: a.as_ref(), y: &y, sigma: &sigma, constraints: None, rank_threshold: RANK_THRESHOLD };
    solve_least_squares(&problem).ok()?.x.try_into().ok()
}

/// Nominal rotation D_b(−B)·D_c(−C).
pub fn nominal_rotation(b: f64, c: f64) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Vector3::y_axis(), -b) * Rotation3::from_axis_angle(&Vector3::z_axis(), -c)
}

/// ∂d/∂W at one pose: ∂q̂/∂W minus the contribution of the measurement at B = C = 0. `w`: position of the sphere
/// there.
pub fn location_error_derivatives(b: f64, c: f64, w: Vector3<f64>) -> [Vector3<f64>; 5] {
    let rotation = nominal_rotation(b, c);
    let (here, first) = (sphere_derivatives(b, rotation * w, w), sphere_derivatives(0.0, w, w));
    std::array::from_fn(|j| here[j] - rotation * first[j])
}

/// ∂q̂/∂W, with q the nominal position of the sphere at the pose and w its position at B = C = 0.
fn sphere_derivatives(b: f64, q: Vector3<f64>, w: Vector3<f64>) -> [Vector3<f64>; 5] {
    let (s, c) = b.sin_cos();
    [
        Vector3::new(0.0, w.z - q.z, q.y - w.y),
        Vector3::new(q.z - w.z, 0.0, -q.x),
        Vector3::new(-q.y, q.x, 0.0),
        Vector3::new(c - 1.0, 0.0, s),
        Vector3::new(-q.y * s, 0.0, q.y * c),
    ]
}
