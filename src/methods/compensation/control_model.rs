//! What the values of a control say about its rotary axes.

use nalgebra::{DMatrix, DVector};

use super::axis_positions::{AxisCoordinate, nominal_coordinate};
use super::target_value::TargetValue;
use crate::MethodRefusal;
use machine::Axis;
use machine::kinematics::{ErrorParameter, ErrorShape, ErrorTerm, KinematicChain};
use machine::record::machine::Machine;

/// Smallest singular value of the equations of the coordinates.
const MIN_SINGULAR_VALUE: f64 = 1e-6;

/// Location errors of the machine that a control with these values takes into account, relative to the positions in the
/// machine file. `values_mm`: one for each of `values`.
///
/// # Errors
/// The values do not determine the coordinates; the machine has no such axis.
pub fn location_errors_of_control(
    machine: &Machine,
    values: &[TargetValue],
    values_mm: &[f64],
) -> Result<Vec<ErrorTerm>, MethodRefusal> {
    let coordinates = solve_coordinates(values, values_mm).ok_or_else(|| {
        MethodRefusal::new("the values of the control do not determine the positions of its axes", "check the target")
    })?;
    let chain = KinematicChain::new(machine)?;
    let deviation = |axis: Axis, component: Axis| {
        let own = coordinates.iter().find(|(own, _)| *own == AxisCoordinate { axis, component });
        own.map(|(coordinate, mm)| mm - nominal_coordinate(machine, *coordinate))
    };
    let branch = chain.topology().workpiece_branch();
    let mut terms = Vec::new();
    for (AxisCoordinate { axis, component }, _) in &coordinates {
        // An error of an axis is relative to the axis that carries it.
        let carriers = branch.iter().take_while(|own| *own != axis);
        let of_carrier = carriers.filter_map(|carrier| deviation(*carrier, *component)).last().unwrap_or(0.0);
        let parameter = ErrorParameter::new(*component, *axis, ErrorShape::Location)
            .map_err(|error| MethodRefusal::new(error.to_string(), "check the target"))?;
        let value = deviation(*axis, *component).unwrap_or(0.0) - of_carrier;
        terms.push(ErrorTerm { parameter, value });
    }
    Ok(terms)
}

/// The coordinates of which the values are sums, mm. `None`: the values do not determine them.
fn solve_coordinates(values: &[TargetValue], values_mm: &[f64]) -> Option<Vec<(AxisCoordinate, f64)>> {
    let mut coordinates: Vec<AxisCoordinate> =
        values.iter().flat_map(|value| value.terms.iter().map(|(coordinate, _)| *coordinate)).collect();
    coordinates.sort();
    coordinates.dedup();
    let factor = |row: usize, column: usize| -> f64 {
        let own = values[row].terms.iter().filter(|(coordinate, _)| *coordinate == coordinates[column]);
        own.map(|(_, factor)| factor).sum()
    };
    let matrix = DMatrix::from_fn(values.len(), coordinates.len(), factor);
    let sums = values.iter().zip(values_mm).map(|(value, mm)| mm + value.offset_mm);
    let decomposition = matrix.svd(true, true);
    if values.len() < coordinates.len() || decomposition.singular_values.min() < MIN_SINGULAR_VALUE {
        return None;
    }
    let solved = decomposition.solve(&DVector::from_iterator(values.len(), sums), 0.0).ok()?;
    Some(coordinates.into_iter().zip(solved.iter().copied()).collect())
}
