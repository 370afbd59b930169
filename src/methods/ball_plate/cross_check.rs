//! Comparison of least squares over all visits with the four-step evaluation of the source of the method.

use std::collections::BTreeSet;
use std::fmt;

use nalgebra::Vector3;

use super::four_step_solution::solve_in_four_steps;
use super::solved::SolvedRun;
use super::unknowns_layout::{MOTION_COMPONENTS, UnknownsLayout};
use crate::identification::{Identification, slope_of_unknown};
use machine::record::estimate::Unit;

/// The coefficient or reversal of an error motion for which least squares and four-step evaluation differ most,
/// relative to its expanded uncertainty.
pub struct LargestCoefficientDifference {
    pub symbol: String,
    pub unit: Unit,
    /// Absolute difference of the coefficient between both evaluations, in its internal unit.
    pub difference: f64,
    /// Expanded uncertainty U of the coefficient (not of the difference), in its internal unit.
    pub coefficient_expanded_uncertainty: f64,
}

impl LargestCoefficientDifference {
    /// # Errors
    /// The reason why the four steps do not apply.
    pub fn new(solved: &SolvedRun<'_>, identified: &Identification) -> Result<Self, &'static str> {
        check_four_steps_apply(solved)?;
        let layout = &solved.design.layout;
        let (stops, observations) = (&solved.design.stops, &solved.measured.observations);
        let other = solve_in_four_steps(layout, stops, observations, &deviations_without_drift(solved))
            .ok_or("the equations have no solution")?;
        let uncertainty = |j| identified.propagation.output_uncertainty(&slope_of_unknown(j, layout.unknown_count()));
        let expanded: Vec<f64> = (0..other.len()).map(|j| uncertainty(j).expanded()).collect();
        let by = |j: usize| (other[j] - solved.solution.x[j]).abs();
        let share = |j: usize| by(j) / expanded[j].max(f64::MIN_POSITIVE);
        let worst = (0..other.len()).max_by(|i, j| share(*i).total_cmp(&share(*j))).unwrap_or(0);
        let symbol = layout.unknown_names(solved.plate.rotary_axis).swap_remove(worst);
        let unit = coefficient_unit(layout, worst);
        Ok(Self { symbol, unit, difference: by(worst), coefficient_expanded_uncertainty: expanded[worst] })
    }

    /// Warning if the difference exceeds U. Unequal weights alone cause less than U: if the weights vary by a
    /// factor of two, the standard deviation of a difference is 0.35 u; by a factor of four, 0.75 u.
    pub fn warning(&self) -> Option<String> {
        (self.difference > self.coefficient_expanded_uncertainty).then(|| {
            format!(
                "least squares over all visits and the four-step evaluation of the source of the method differ: {self}. \
                 Find the visits with large residual_rms and measure them again"
            )
        })
    }
}

/// Sentence about the comparison, for the lines `gauge` of the estimate.
pub fn describe_cross_check(result: &Result<LargestCoefficientDifference, &'static str>) -> String {
    let reference = "least squares over all visits";
    match result {
        Err(reason) => {
            format!("{reference}; not compared with the four-step evaluation of the source of the method: {reason}")
        }
        Ok(difference) => {
            format!("{reference}; compared with the four-step evaluation of the source of the method: {difference}")
        }
    }
}

impl fmt::Display for LargestCoefficientDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { symbol, unit, difference: by, coefficient_expanded_uncertainty: expanded } = self;
        let [by, expanded] = [by, expanded].map(|value| unit.to_reported_value(*value));
        let unit = unit.symbol();
        write!(f, "largest difference {by:.3} {unit}, in {symbol} (U = {expanded:.3} {unit})")
    }
}

fn coefficient_unit(layout: &UnknownsLayout, coefficient: usize) -> Unit {
    let motions = MOTION_COMPONENTS.len() * layout.angle_basis.function_count();
    let component = match coefficient.checked_sub(motions) {
        None => coefficient / layout.angle_basis.function_count(),
        Some(reversal) => reversal,
    };
    super::outputs::component_unit(MOTION_COMPONENTS[component])
}

/// # Errors
/// The reason why the four steps do not apply.
fn check_four_steps_apply(solved: &SolvedRun<'_>) -> Result<(), &'static str> {
    let SolvedRun { design, measured, plate, settings, .. } = solved;
    let (balls, positions) = (plate.ball_steps.len(), settings.positions);
    let steps: BTreeSet<usize> = plate.ball_steps.iter().copied().collect();
    let is_even = steps.len() == balls
        && positions.is_multiple_of(balls)
        && steps.iter().all(|step| step.is_multiple_of(positions / balls));
    let visits: BTreeSet<(usize, usize)> =
        measured.observations.iter().map(|observation| (observation.stop_index, observation.ball_index)).collect();
    let all = design.stops.len() * balls;
    let is_complete = visits.len() == all && measured.observations.len() == all;
    match () {
        () if settings.value_per_stop => Err("harmonics are required (values = false)"),
        () if !is_even => Err("balls at equal angles are required, which leave some harmonics undetermined"),
        () if !is_complete => Err("each ball must be measured once at each stop"),
        () => Ok(()),
    }
}

/// Deviations of the observations, minus the fitted drift and the steps at interruptions, mm.
fn deviations_without_drift(solved: &SolvedRun<'_>) -> Vec<Vector3<f64>> {
    let SolvedRun { design, measured, solution, design_matrix: a, .. } = solved;
    let drift = design.layout.drift_unknown_index(1, 0)..design.layout.measuring_position_unknown_index(0, 0);
    let fitted = |row: usize| drift.clone().map(|j| a[(row, j)] * solution.x[j]).sum::<f64>();
    let fitted_drift = |i: usize| Vector3::from_fn(|axis, _| fitted(3 * i + axis));
    let observations = measured.observations.iter().enumerate();
    observations.map(|(i, observation)| observation.axis_position_deviation_mm - fitted_drift(i)).collect()
}
