//! Position of the axis in machine coordinates: the stated axis plus the measured location errors.

use nalgebra::Vector3;

use super::identify::SolvedRun;
use crate::identification::parameter_without_budget;
use machine::record::estimate::{BudgetLine, Estimate, Parameter, Unit};

const MM_PER_UM: f64 = 1e-3;

/// Adds X and Y of the measured axis in machine coordinates, at the mean height of the touches. X and Y do not change
/// when `point_mm` is corrected.
pub fn add_axis_position(parts: &SolvedRun<'_>, estimate: &mut Estimate) {
    let mean = parts.setup.heights_in_machine_mm.iter().sum::<f64>() / parts.setup.heights_in_machine_mm.len() as f64;
    let stated = parts.setup.axis.axis_point_at_height(mean);
    let positions = xy_location_errors(estimate).into_iter().zip(["X", "Y"]).zip(&stated);
    let positions = positions.map(|((error, direction), stated)| {
        let symbol = format!("{direction}_{}", parts.setup.axis.axis);
        let [off_mm, u_mm] = [error.value, error.u].map(|um| um * MM_PER_UM);
        let line = |line: BudgetLine| BudgetLine { u: line.u * MM_PER_UM, ..line };
        let interval = error.interval_monte_carlo;
        Parameter {
            u_monte_carlo: error.u_monte_carlo.map(|um| um * MM_PER_UM),
            interval_monte_carlo: interval.map(|um| um.map(|um| stated + um * MM_PER_UM)),
            budget: error.budget.into_iter().map(line).collect(),
            ..parameter_without_budget(&symbol, Unit::Mm, stated + off_mm, u_mm, error.dof)
        }
    });
    estimate.parameters.extend(positions);
}

/// The stated axis, and the measured axis as an entry of the machine file.
pub fn describe_axis_position(parts: &SolvedRun<'_>, estimate: &Estimate) -> String {
    let axis = parts.setup.axis.axis;
    let off = xy_location_errors(estimate).iter().map(|error| error.value * MM_PER_UM).collect();
    let [old, new] = [vec![0.0; 2], off].map(|off: Vec<f64>| {
        let off = Vector3::from_iterator(off.into_iter().chain([0.0]));
        let point = parts.setup.axis.displaced_axis_point_mm(off).map(|mm| (mm * 1e4).round() / 1e4 + 0.0);
        format!("[{}, {}, {}]", point.x, point.y, point.z)
    });
    let directions = match parts.setup.axis.describe_other_nonzero_axes() {
        others if others.is_empty() => String::new(),
        others => format!("; the directions are X and Y of the machine with {others}"),
    };
    format!(
        "EX0{axis} and EY0{axis} are the measured minus the configured position: configured [axes.{axis}] \
        point_mm = {old}, measured {new}{directions}"
    )
}

/// Location errors of the axis along X and Y: the first two parameters.
fn xy_location_errors(estimate: &Estimate) -> Vec<Parameter> {
    estimate.parameters.iter().take(2).cloned().collect()
}
