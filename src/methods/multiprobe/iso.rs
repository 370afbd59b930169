//! Values of error motions as ISO 230-7 names them: synchronous, fundamental, residual synchronous from
//! the harmonics; total and asynchronous from the single revolutions.

use std::f64::consts::TAU;

use super::model::Component;
use super::outputs::{ReportedMotions, unit};
use super::settings::TurnSampling;
use crate::identification::{NonlinearOutputs, Range, range_outputs};

/// Angles at which the largest and the least value of a motion are sought.
const ANGLES: usize = 360;

/// The motion of these orders, at equal angles.
fn range(
    motions: &ReportedMotions<'_>,
    symbol: String,
    component: Component,
    orders: &[usize],
) -> Range {
    let angle = |i: usize| i as f64 / ANGLES as f64 * TAU;
    let slopes = (0..ANGLES).map(|i| motions.slope_at(component, orders, angle(i))).collect();
    Range { symbol, unit: unit(component), slopes }
}

/// Synchronous error motion values in the fixed sensitive direction of each motion, fundamental (axial
/// alone: the first harmonic of the others is eccentricity or tilt) and residual synchronous axial
/// values; roundness (peak to valley about the least-squares circle). Only identifiable harmonics take
/// part; a motion without one has no value. ISO 230-7 speaks of a turning axis: at dwell points the same range
/// is `EXC_range`.
pub fn nonlinear_outputs(
    motions: &ReportedMotions<'_>,
    components: &[Component],
    sampling: TurnSampling,
) -> NonlinearOutputs {
    let turns = sampling == TurnSampling::Continuous;
    let mut ranges = Vec::new();
    for component in components.iter().filter(|c| !matches!(c, Component::Face)) {
        let all = motions.identifiable_orders(*component);
        let higher: Vec<usize> = all.iter().copied().filter(|order| *order > 1).collect();
        let symbol = component.symbol();
        let mut add = |symbol: String, orders: &[usize]| {
            if !orders.is_empty() {
                ranges.push(range(motions, symbol, *component, orders));
            }
        };
        match component {
            Component::Roundness(section) => add(format!("RONt_{}", section + 1), &higher),
            _ if turns => add(format!("{symbol}_synchronous"), &all),
            _ => add(format!("{symbol}_range"), &all),
        }
        if turns && *component == Component::Z && all.first() == Some(&1) {
            add(format!("{symbol}_fundamental"), &[1]);
            add(format!("{symbol}_residual_synchronous"), &higher);
        }
    }
    range_outputs(ranges, motions.solution())
}
