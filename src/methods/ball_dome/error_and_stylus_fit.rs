//! Simultaneous least-squares fit of machine errors and stylus to the readings of the certified artefact
//! (paper 4, section 7, S4). The spindle does not turn: its offsets are included in the stylus.

use estimation::linear_least_squares::{LinearProblem, LinearSolution, RANK_THRESHOLD, solve_least_squares};
use estimation::rigid_fit::RigidFit;
use faer::Mat;
use nalgebra::{Matrix3, Vector3};

use super::measured_points::MeasuredPoints;
use super::prior_machine_errors::is_spindle_error;
use super::stylus_gain::StylusGain;
use super::variant::StylusEstimate;
use crate::identification::KnownErrors;
use machine::kinematics::{ErrorParameter, ErrorTerm};

/// Number of Gauss–Newton steps. The equations are nearly linear: the third step changes the result by less than 0.001
/// µm.
const GAUSS_NEWTON_STEPS: usize = 3;
/// Number of unknowns besides the errors: stylus, translation and rotation of the artefact.
pub const STYLUS_AND_POSE_UNKNOWN_COUNT: usize = 9;

/// The fitted stylus minus the offset of the spindle in the prior. Of the other errors of the prior, only the names
/// are used: their values are fitted, starting at 0. The gain of the stylus applies to the change of each point minus
/// the change of its certified position. `None`: the readings do not separate errors and stylus.
pub fn fit_machine_errors_and_stylus(points: &MeasuredPoints, known: &KnownErrors<'_>) -> Option<StylusEstimate> {
    let own = known.errors.iter().filter(|error| !is_spindle_error(error));
    let mut errors: Vec<ErrorTerm> = own.map(|error| ErrorTerm { value: 0.0, ..*error }).collect();
    let mut stylus = points.stated_stylus;
    let mut gain = StylusGain::new();
    for _ in 0..GAUSS_NEWTON_STEPS {
        let solution = gauss_newton_step(points, &errors, stylus)?;
        errors.iter_mut().zip(&solution.x).for_each(|(error, change)| error.value += change);
        let first = errors.len();
        stylus += Vector3::from_fn(|k, _| solution.x[first + k]);
        let of_point = |i: usize| Matrix3::from_fn(|k, j| -solution.gain[(first + k, 3 * i + j)]);
        gain = (0..points.point_count()).map(of_point).collect();
    }
    let prior_derivatives = stylus_derivatives_by_spindle_errors(points, known);
    let offset = prior_derivatives.iter().zip(&known.errors).map(|(by, error)| by * error.value);
    Some(StylusEstimate {
        vector_mm: stylus + offset.sum::<Vector3<f64>>(),
        gain: Some(gain),
        stylus_derivatives_by_prior_errors: prior_derivatives,
    })
}

/// Change of the stylus by each error of the prior, for a stylus that includes the offset of the spindle
/// (paper 4, Eqs. 5 to 7); zero for an error of another axis.
fn stylus_derivatives_by_spindle_errors(points: &MeasuredPoints, known: &KnownErrors<'_>) -> Vec<Vector3<f64>> {
    let of = |error: &ErrorTerm| {
        if !is_spindle_error(error) {
            return Vector3::zeros();
        }
        let by_error = points.point_derivatives_by_errors(&[], points.stated_stylus, &[error.parameter]);
        let stylus_derivatives = points.point_derivatives_by_stylus(&[]);
        -(stylus_derivatives[0].transpose() * by_error[0][0])
    };
    known.errors.iter().map(of).collect()
}

/// One step from `errors` and `stylus`. Unknowns: changes of the errors, of the stylus (3), translation and rotation
/// of the artefact (3 each). `None`: the equations are rank-deficient.
fn gauss_newton_step(points: &MeasuredPoints, errors: &[ErrorTerm], stylus: Vector3<f64>) -> Option<LinearSolution> {
    let fit = RigidFit::new(&points.certified_positions_mm, &points.table_positions_mm(errors, stylus));
    let parameters: Vec<ErrorParameter> = errors.iter().map(|error| error.parameter).collect();
    let error_derivatives = points.point_derivatives_by_errors(errors, stylus, &parameters);
    let stylus_derivatives = points.point_derivatives_by_stylus(errors);
    let first = parameters.len();
    let mut a = Mat::zeros(3 * points.point_count(), first + STYLUS_AND_POSE_UNKNOWN_COUNT);
    let mut y = Vec::with_capacity(3 * points.point_count());
    for i in 0..points.point_count() {
        y.extend((-fit.deviations[i]).iter());
        let turned = fit.rotated_points_about_centroid[i].cross_matrix();
        for k in 0..3 {
            error_derivatives[i].iter().enumerate().for_each(|(j, column)| a[(3 * i + k, j)] = column[k]);
            for j in 0..3 {
                a[(3 * i + k, first + j)] = stylus_derivatives[i][(k, j)];
                a[(3 * i + k, first + 3 + j)] = if j == k { -1.0 } else { 0.0 };
                a[(3 * i + k, first + 6 + j)] = turned[(k, j)];
            }
        }
    }
    let sigma = vec![1.0; y.len()];
    let problem =
        LinearProblem { a: a.as_ref(), y: &y, sigma: &sigma, constraints: None, rank_threshold: RANK_THRESHOLD };
    solve_least_squares(&problem).ok()
}
