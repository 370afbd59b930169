//! Results of single revolutions, which show whether error motions and linear axes repeat (paper 5, Figs. 8
//! and 9).

use nalgebra::Vector3;

use super::basis::equal_angles;
use super::four_steps::rigid_bodies;
use super::layout::{COMPONENTS, Stop};
use super::outputs::unit;
use super::solved::Solved;
use crate::identification::order_values;
use machine::Axis;
use machine::record::estimate::{FigureKind, Function, Unit};

pub fn functions(solved: &Solved<'_>) -> Vec<Function> {
    let residuals: Vec<Vector3<f64>> = solved.residuals().collect();
    let mut all = linear_axes(solved, &residuals);
    // Values at the stops already show every revolution.
    if !solved.settings.values {
        all.extend(error_motions(solved, &residuals));
    }
    all
}

/// Curves over an angle without a stated uncertainty, one curve per revolution or direction.
fn curves(
    symbol: String,
    argument: &str,
    unit: Unit,
    points: impl Iterator<Item = (f64, f64)>,
) -> Function {
    let points = points.map(|(angle, value)| (angle.to_degrees(), unit.from_internal(value)));
    Function {
        argument: argument.to_owned(),
        argument_unit: "deg".to_owned(),
        figure: FigureKind::Curve,
        ..order_values(&symbol, unit, points)
    }
}

/// Deviations of X, Y and Z at the measuring positions, by revolution.
fn linear_axes(solved: &Solved<'_>, residuals: &[Vector3<f64>]) -> Vec<Function> {
    let (layout, x) = (&solved.design.layout, &solved.solution.x);
    let positions = solved.settings.positions;
    let revolutions = solved.design.stops.len().div_ceil(positions);
    let mut sums = vec![(Vector3::zeros(), 0.0); revolutions * positions];
    for (sighting, residual) in solved.measured.sightings.iter().zip(residuals) {
        let (sum, count) = &mut sums[sighting.stop / positions * positions + sighting.place];
        *sum += residual;
        *count += 1.0;
    }
    let of_axis = |(k, axis): (usize, Axis)| {
        let angles = (0..revolutions).flat_map(|_| equal_angles(positions));
        let of_place = |(i, (angle, (sum, count))): (usize, (f64, &(Vector3<f64>, f64)))| {
            // If the true position of a linear axis is too large, its displayed position at a ball is too
            // small.
            (*count > 0.0).then(|| (angle, x[layout.place(i % positions, k)] - sum[k] / count))
        };
        let points = angles.zip(&sums).enumerate().filter_map(of_place);
        curves(format!("D{axis}_revolutions"), "position", Unit::Um, points)
    };
    Axis::LINEAR.into_iter().enumerate().map(of_axis).collect()
}

/// Error motions at the stops: the harmonics plus the residuals of the stop; rising commands first, then
/// falling ones.
fn error_motions(solved: &Solved<'_>, residuals: &[Vector3<f64>]) -> Vec<Function> {
    let (layout, stops, x) = (&solved.design.layout, &solved.design.stops, &solved.solution.x);
    let axis = solved.plate.axis;
    let bodies = rigid_bodies(&solved.measured.sightings, residuals);
    let mut order: Vec<usize> = bodies.keys().copied().collect();
    order.sort_by(|a, b| {
        let [a, b] = [stops[*a], stops[*b]];
        b.direction.total_cmp(&a.direction).then(a.angle.total_cmp(&b.angle))
    });
    let of_component = |(k, component): (usize, Axis)| {
        let point = |stop: &usize| {
            let Stop { angle, direction } = stops[*stop];
            let functions = layout.basis.values(angle, *stop).into_iter().enumerate();
            let harmonics: f64 = functions.map(|(j, value)| value * x[layout.motion(k, j)]).sum();
            let reversal = if layout.has_reversal { x[layout.reversal(k)] } else { 0.0 };
            (angle, harmonics + 0.5 * direction * reversal + bodies[stop][k])
        };
        let points = order.iter().map(point);
        curves(format!("E{component}{axis}_stops"), axis.name(), unit(component), points)
    };
    COMPONENTS.into_iter().enumerate().map(of_component).collect()
}
