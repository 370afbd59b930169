//! Comparison of least squares over all visits with the four steps of paper 5.

use std::collections::BTreeSet;
use std::fmt;

use nalgebra::Vector3;

use super::four_steps::solve_in_four_steps;
use super::layout::{MOTION_COMPONENTS, UnknownsLayout};
use super::solved::SolvedRun;
use crate::identification::{Identification, unit_slope};
use machine::record::estimate::Unit;

pub enum CrossCheck {
    NotPossible(&'static str),
    Compared(CoefficientDifference),
}

/// The coefficient of an error motion with the largest difference relative to its expanded uncertainty.
pub struct CoefficientDifference {
    pub symbol: String,
    pub unit: Unit,
    /// Difference of the coefficient, in its internal unit.
    pub difference: f64,
    pub expanded: f64,
}

impl CrossCheck {
    pub fn new(solved: &SolvedRun<'_>, identified: &Identification) -> Self {
        if let Some(reason) = find_obstacle(solved) {
            return Self::NotPossible(reason);
        }
        let layout = &solved.design.layout;
        let (stops, observations) = (&solved.design.stops, &solved.measured.observations);
        let Some(other) = solve_in_four_steps(layout, stops, observations, &deviations_without_drift(solved)) else {
            return Self::NotPossible("the equations have no solution");
        };
        let uncertainty = |j| identified.propagation.uncertainty(&unit_slope(j, layout.unknowns()));
        let expanded: Vec<f64> = (0..other.len()).map(|j| uncertainty(j).expanded()).collect();
        let by = |j: usize| (other[j] - solved.solution.x[j]).abs();
        let share = |j: usize| by(j) / expanded[j].max(f64::MIN_POSITIVE);
        let worst = (0..other.len()).max_by(|i, j| share(*i).total_cmp(&share(*j))).unwrap_or(0);
        let symbol = layout.names(solved.plate.axis).swap_remove(worst);
        let unit = coefficient_unit(layout, worst);
        Self::Compared(CoefficientDifference { symbol, unit, difference: by(worst), expanded: expanded[worst] })
    }

    /// Warning if the difference exceeds U. Unequal weights alone cause less than U: if the weights vary by a
    /// factor of two, the standard deviation of a difference is 0.35 u; by a factor of four, 0.75 u.
    pub fn warning(&self) -> Option<String> {
        let Self::Compared(difference) = self else { return None };
        (difference.difference > difference.expanded).then(|| {
            format!(
                "least squares over all visits and the four steps of paper 5 differ: {difference}. Find the \
                visits with large residual_rms and measure them again"
            )
        })
    }
}

impl fmt::Display for CrossCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let reference = "least squares over all visits";
        match self {
            Self::NotPossible(reason) => {
                write!(f, "{reference}; not compared with the four steps of paper 5: {reason}")
            }
            Self::Compared(difference) => {
                write!(f, "{reference}; compared with the four steps of paper 5: {difference}")
            }
        }
    }
}

impl fmt::Display for CoefficientDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { symbol, unit, difference: by, expanded } = self;
        let [by, expanded] = [by, expanded].map(|value| unit.from_internal(*value));
        let unit = unit.symbol();
        write!(f, "largest difference {by:.3} {unit}, in {symbol} (U = {expanded:.3} {unit})")
    }
}

fn coefficient_unit(layout: &UnknownsLayout, coefficient: usize) -> Unit {
    let motions = MOTION_COMPONENTS.len() * layout.basis.len();
    let component = match coefficient.checked_sub(motions) {
        None => coefficient / layout.basis.len(),
        Some(reversal) => reversal,
    };
    super::outputs::component_unit(MOTION_COMPONENTS[component])
}

/// Reason why the four steps do not apply.
fn find_obstacle(solved: &SolvedRun<'_>) -> Option<&'static str> {
    let SolvedRun { design, measured, plate, settings, .. } = solved;
    let (balls, positions) = (plate.position_steps.len(), settings.positions);
    let steps: BTreeSet<usize> = plate.position_steps.iter().copied().collect();
    let is_even = steps.len() == balls
        && positions.is_multiple_of(balls)
        && steps.iter().all(|step| step.is_multiple_of(positions / balls));
    let visits: BTreeSet<(usize, usize)> =
        measured.observations.iter().map(|observation| (observation.stop, observation.ball)).collect();
    let all = design.stops.len() * balls;
    let is_complete = visits.len() == all && measured.observations.len() == all;
    match () {
        () if settings.values => Some("harmonics are required (values = false)"),
        () if !is_even => Some("balls at equal angles are required, which leave some harmonics undetermined"),
        () if !is_complete => Some("each ball must be measured once at each stop"),
        () => None,
    }
}

/// Deviations of the sightings, minus the fitted drift and the steps at interruptions, mm.
fn deviations_without_drift(solved: &SolvedRun<'_>) -> Vec<Vector3<f64>> {
    let SolvedRun { design, measured, solution, design_matrix: a, .. } = solved;
    let drift = design.layout.drift_index(1, 0)..design.layout.position_index(0, 0);
    let fitted = |row: usize| drift.clone().map(|j| a[(row, j)] * solution.x[j]).sum::<f64>();
    let observations = measured.observations.iter().enumerate();
    let of_observation = |(i, observation): (usize, &super::equations::BallObservation)| {
        observation.deviation - Vector3::from_fn(|axis, _| fitted(3 * i + axis))
    };
    observations.map(of_observation).collect()
}
