//! The least-squares solution of the equations.

use estimation::linear::{LinearError, RankAnalysis};
use estimation::nonlinear::{NonlinearError, NonlinearSolution, minimise_squares};
use estimation::null_names::name_null_space;
use estimation::schur::factorise;

use super::model::SensorEquations;
use super::nest::SensorNest;
use super::observe::ObservedMeans;
use super::sources::standard_uncertainties;
use crate::IdentifyError;
use crate::identification::ObservationEquation;

/// The equation, weighted by the sources that are independent between observations.
pub fn weighted_equation<'a>(nest: &'a SensorNest<'a>, observed: &'a ObservedMeans) -> SensorEquations<'a> {
    let equation = SensorEquations::unweighted(nest, observed);
    let sigma = standard_uncertainties(&equation);
    SensorEquations { sigma_mm: sigma, ..equation }
}

/// # Errors
/// The means do not separate the unknowns, or the iteration does not converge.
pub fn solve_equation(equation: &SensorEquations<'_>) -> Result<NonlinearSolution, IdentifyError> {
    let sensors: Vec<&str> = equation.nest.sensors.iter().map(|sensor| sensor.name.as_str()).collect();
    let names = equation.unknowns.names(&sensors);
    let unsolved = |why: NonlinearError| {
        let lost = |survey: &RankAnalysis| name_null_space(survey.null_space.as_ref(), &names);
        IdentifyError::from_solver_error(why, lost)
    };
    let survey = survey_rank(equation, &equation.initial_values()).map_err(unsolved)?;
    if survey.nullity > 0 {
        return Err(unsolved(LinearError::RankDeficient(Box::new(survey)).into()));
    }
    let unchanged = vec![0.0; equation.observations()];
    let residuals = |x: &[f64]| equation.residuals(x, &unchanged);
    minimise_squares(equation.initial_values(), |x| equation.rows(x), residuals).map_err(unsolved)
}

pub fn survey_rank(equation: &SensorEquations<'_>, x: &[f64]) -> Result<RankAnalysis, NonlinearError> {
    Ok(factorise(equation.rows(x)).0.analyse_rank()?)
}
