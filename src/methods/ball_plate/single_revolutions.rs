//! Results of single revolutions, which show whether error motions and linear axes repeat (paper 5, Figs. 8
//! and 9).

use nalgebra::Vector3;

use super::angle_basis::equal_angles;
use super::four_step_solution::fit_rigid_bodies;
use super::outputs::component_unit;
use super::solved::SolvedRun;
use super::unknowns_layout::{MOTION_COMPONENTS, TableStop};
use crate::identification::function_over_harmonic_orders;
use machine::Axis;
use machine::record::estimate::{EstimatedFunction, FunctionFigureKind, Unit};

/// Deviations of the linear axes by revolution and, unless each stop has a separate value, error motions at the
/// stops.
pub fn single_revolution_functions(solved: &SolvedRun<'_>) -> Vec<EstimatedFunction> {
    let residuals: Vec<Vector3<f64>> = solved.residuals().collect();
    let mut all = linear_axis_deviations_by_revolution(solved, &residuals);
    // Values at the stops already show every revolution.
    if !solved.settings.value_per_stop {
        all.extend(error_motions_at_stops(solved, &residuals));
    }
    all
}

/// A function of an angle without a stated uncertainty; its points hold one curve after the other, one per revolution
/// or direction. `points`: rad and internal unit.
fn angle_curve(
    symbol: String,
    argument: &str,
    unit: Unit,
    points: impl Iterator<Item = (f64, f64)>,
) -> EstimatedFunction {
    let points = points.map(|(angle, value)| (angle.to_degrees(), unit.to_reported_value(value)));
    EstimatedFunction {
        argument: argument.to_owned(),
        argument_unit: "deg".to_owned(),
        figure: FunctionFigureKind::Curve,
        ..function_over_harmonic_orders(&symbol, unit, points)
    }
}

/// Deviations of X, Y and Z at the measuring positions, by revolution: the fitted value, corrected by the mean
/// residual of the revolution.
fn linear_axis_deviations_by_revolution(solved: &SolvedRun<'_>, residuals: &[Vector3<f64>]) -> Vec<EstimatedFunction> {
    let (layout, x) = (&solved.design.layout, &solved.solution.x);
    let positions = solved.settings.positions;
    let revolutions = solved.design.stops.len().div_ceil(positions);
    let mut sums = vec![(Vector3::zeros(), 0.0); revolutions * positions];
    for (observation, residual) in solved.measured.observations.iter().zip(residuals) {
        let (sum, count) =
            &mut sums[observation.stop_index / positions * positions + observation.measuring_position_index];
        *sum += residual;
        *count += 1.0;
    }
    let of_axis = |(k, axis): (usize, Axis)| {
        let angles = (0..revolutions).flat_map(|_| equal_angles(positions));
        let of_place = |(i, (angle, (sum, count))): (usize, (f64, &(Vector3<f64>, f64)))| {
            // If the true position of a linear axis is too large, its displayed position at a ball is too
            // small.
            (*count > 0.0)
                .then(|| (angle, x[layout.measuring_position_unknown_index(i % positions, k)] - sum[k] / count))
        };
        let points = angles.zip(&sums).enumerate().filter_map(of_place);
        angle_curve(format!("D{axis}_revolutions"), "position", Unit::Um, points)
    };
    Axis::LINEAR.into_iter().enumerate().map(of_axis).collect()
}

/// Error motions at the stops: the harmonics plus the residuals of the stop; rising commands first, then
/// falling ones.
fn error_motions_at_stops(solved: &SolvedRun<'_>, residuals: &[Vector3<f64>]) -> Vec<EstimatedFunction> {
    let (layout, stops, x) = (&solved.design.layout, &solved.design.stops, &solved.solution.x);
    let axis = solved.plate.rotary_axis;
    let bodies = fit_rigid_bodies(&solved.measured.observations, residuals);
    let mut order: Vec<usize> = bodies.keys().copied().collect();
    order.sort_by(|a, b| {
        let [a, b] = [stops[*a], stops[*b]];
        b.approach_sign.total_cmp(&a.approach_sign).then(a.angle.total_cmp(&b.angle))
    });
    let of_component = |(k, component): (usize, Axis)| {
        let point = |stop: &usize| {
            let TableStop { angle, approach_sign: direction } = stops[*stop];
            let functions = layout.angle_basis.function_values(angle, *stop).into_iter().enumerate();
            let harmonics: f64 = functions.map(|(j, value)| value * x[layout.motion_unknown_index(k, j)]).sum();
            let reversal = if layout.has_reversal { x[layout.reversal_unknown_index(k)] } else { 0.0 };
            (angle, harmonics + 0.5 * direction * reversal + bodies[stop][k])
        };
        let points = order.iter().map(point);
        angle_curve(format!("E{component}{axis}_stops"), axis.name(), component_unit(component), points)
    };
    MOTION_COMPONENTS.into_iter().enumerate().map(of_component).collect()
}
