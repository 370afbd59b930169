//! Simultaneous least-squares fit of machine errors and stylus to the readings of the certified artefact
//! (paper 4, section 7, S4). The spindle does not turn: its offsets are included in the stylus.

use estimation::linear::{self, LinearProblem, LinearSolution, RANK_THRESHOLD};
use estimation::rigid::RigidFit;
use faer::Mat;
use nalgebra::{Matrix3, Vector3};

use super::points::MeasuredPoints;
use super::prior::is_spindle_error;
use super::stylus::StylusGain;
use crate::IdentifyError;
use crate::identification::KnownErrors;
use machine::kinematics::{ErrorParameter, ErrorTerm};

/// Number of Gauss–Newton steps. The equations are so nearly linear that the third changes less than 0.001
/// µm.
const GAUSS_NEWTON_STEPS: usize = 3;
/// Number of unknowns besides the errors: stylus, translation and rotation of the artefact.
const STYLUS_AND_POSE_UNKNOWNS: usize = 9;

pub struct ErrorAndStylusFit {
    /// Stylus from the spindle datum, including the offset of the spindle, mm.
    pub stylus: Vector3<f64>,
    /// Gain of the stylus for the change of each point minus the change of its certified position.
    pub gain: StylusGain,
}

/// # Errors
/// The readings do not separate errors and stylus.
pub fn fit_errors_and_stylus(
    points: &MeasuredPoints,
    known: &KnownErrors<'_>,
) -> Result<ErrorAndStylusFit, IdentifyError> {
    let own = known.errors.iter().filter(|error| !is_spindle_error(error));
    let parameters: Vec<ErrorParameter> = own.map(|error| error.parameter).collect();
    let mut values = vec![0.0; parameters.len()];
    let mut stylus = points.stylus;
    let mut gain = StylusGain::new();
    for _ in 0..GAUSS_NEWTON_STEPS {
        let terms: Vec<ErrorTerm> = parameters
            .iter()
            .zip(&values)
            .map(|(parameter, value)| ErrorTerm { parameter: *parameter, value: *value })
            .collect();
        let solution = gauss_newton_step(points, &parameters, &terms, stylus)
            .map_err(|error| IdentifyError::from_solver_error(error, |_| Vec::new()))?;
        values.iter_mut().zip(&solution.x).for_each(|(value, change)| *value += change);
        let first = parameters.len();
        stylus += Vector3::from_fn(|k, _| solution.x[first + k]);
        let of_point = |i: usize| Matrix3::from_fn(|k, j| -solution.gain[(first + k, 3 * i + j)]);
        gain = (0..points.count()).map(of_point).collect();
    }
    Ok(ErrorAndStylusFit { stylus, gain })
}

fn gauss_newton_step(
    points: &MeasuredPoints,
    parameters: &[ErrorParameter],
    terms: &[ErrorTerm],
    stylus: Vector3<f64>,
) -> Result<LinearSolution, linear::LinearError> {
    let seen = points.table_positions_mm(terms, stylus);
    let fit = RigidFit::new(&points.certified_mm, &seen);
    let error_derivatives = points.error_derivatives(terms, stylus, parameters);
    let stylus_derivatives = points.stylus_derivatives(terms);
    let first = parameters.len();
    let mut a = Mat::zeros(3 * points.count(), first + STYLUS_AND_POSE_UNKNOWNS);
    let mut y = Vec::with_capacity(3 * points.count());
    for i in 0..points.count() {
        y.extend((-fit.deviations[i]).iter());
        let turned = fit.arms[i].cross_matrix();
        for k in 0..3 {
            error_derivatives[i].iter().enumerate().for_each(|(j, column)| a[(3 * i + k, j)] = column[k]);
            for j in 0..3 {
                a[(3 * i + k, first + j)] = stylus_derivatives[i][(k, j)];
                a[(3 * i + k, first + 3 + j)] = if j == k { -1.0 } else { 0.0 };
                a[(3 * i + k, first + 6 + j)] = turned[(k, j)];
            }
        }
    }
    linear::solve_least_squares(&LinearProblem {
        a: a.as_ref(),
        y: &y,
        sigma: &vec![1.0; y.len()],
        constraints: None,
        rank_threshold: RANK_THRESHOLD,
    })
}
