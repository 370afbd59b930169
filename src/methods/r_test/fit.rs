//! The least-squares solution of the equations.

use estimation::linear::{LinearError, Survey};
use estimation::nonlinear::{Minimum, NonlinearError, minimise};
use estimation::null_names::name_null_space;
use estimation::schur::factor;

use super::model::Equation;
use super::nest::Nest;
use super::observe::Observed;
use super::sources::sigma;
use crate::IdentifyError;
use crate::identification::ObservationEquation;

/// The equation, weighted by the sources that are independent between observations.
pub fn weighted<'a>(nest: &'a Nest<'a>, observed: &'a Observed) -> Equation<'a> {
    let equation = Equation::unweighted(nest, observed);
    let sigma = sigma(&equation);
    Equation { sigma, ..equation }
}

/// # Errors
/// The means do not separate the unknowns, or the iteration does not converge.
pub fn solve(equation: &Equation<'_>) -> Result<Minimum, IdentifyError> {
    let sensors: Vec<&str> =
        equation.nest.sensors.iter().map(|sensor| sensor.name.as_str()).collect();
    let names = equation.unknowns.names(&sensors);
    let unsolved = |why: NonlinearError| {
        let lost = |survey: &Survey| name_null_space(survey.null_space.as_ref(), &names);
        IdentifyError::unsolved(why, lost)
    };
    let survey = survey(equation, &equation.start()).map_err(unsolved)?;
    if survey.nullity > 0 {
        return Err(unsolved(LinearError::RankDeficient(Box::new(survey)).into()));
    }
    let unchanged = vec![0.0; equation.observations()];
    let residuals = |x: &[f64]| equation.residuals(x, &unchanged);
    minimise(equation.start(), |x| equation.rows(x), residuals).map_err(unsolved)
}

pub fn survey(equation: &Equation<'_>, x: &[f64]) -> Result<Survey, NonlinearError> {
    Ok(factor(equation.rows(x)).0.survey()?)
}
