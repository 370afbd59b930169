//! Error motion values of a rotating axis by ISO 230-7: synchronous, fundamental and residual synchronous
//! values from the harmonics; total and asynchronous values from single revolutions.

use machine::record::estimate::{Parameter, Unit};

use super::estimate::parameter_without_budget;
use super::harmonics::HarmonicFunction;
use super::output_range::{RangeOutput, value_range};

/// Synchronous error motion value in the fixed sensitive direction of the motion. An axial motion also has the
/// fundamental and the residual synchronous value (the first harmonic of the other motions is eccentricity or tilt).
/// Only identifiable harmonics are included; without an identifiable harmonic there is no value.
pub fn synchronous_ranges(motion: &HarmonicFunction, is_axial: bool) -> Vec<RangeOutput> {
    let symbol = &motion.symbol;
    let mut ranges = vec![motion.range_output(format!("{symbol}_synchronous"))];
    let has_fundamental = motion.harmonics.iter().any(|harmonic| harmonic.order == 1.0);
    if is_axial && has_fundamental {
        let fundamental = motion.clone().retain_orders(|order| order == 1.0);
        let residual = motion.clone().retain_orders(|order| order > 1.0);
        ranges.push(fundamental.range_output(format!("{symbol}_fundamental")));
        ranges.push(residual.range_output(format!("{symbol}_residual_synchronous")));
    }
    ranges.into_iter().flatten().collect()
}

/// Total and asynchronous value of a motion in one measurement. Both values include the noise of the sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorMotionValues {
    /// Range over all angles and revolutions.
    total_value: f64,
    /// Largest range over the revolutions at one angle.
    asynchronous_value: f64,
}

impl ErrorMotionValues {
    /// `synchronous`: the mean motion at equally spaced angles. `motion`: revolutions × angles; it may
    /// contain an unknown function of the angle that is the same in each revolution.
    pub fn new(synchronous: &[f64], motion: &[Vec<f64>]) -> Self {
        let (mut asynchronous, mut all) = (0.0_f64, Vec::new());
        for (i, synchronous) in synchronous.iter().enumerate() {
            let at_angle = || motion.iter().map(|revolution| revolution[i]);
            let mean = at_angle().sum::<f64>() / motion.len() as f64;
            let deviations: Vec<f64> = at_angle().map(|value| value - mean).collect();
            asynchronous = asynchronous.max(value_range(&deviations));
            all.extend(deviations.iter().map(|deviation| synchronous + deviation));
        }
        Self { total_value: value_range(&all), asynchronous_value: asynchronous }
    }
}

/// Total and asynchronous value of the motion `symbol`: the mean over the measurements and the standard
/// uncertainty of that mean (type A). One measurement gives no uncertainty and therefore no value.
pub fn total_and_asynchronous_parameters(symbol: &str, unit: Unit, values: &[ErrorMotionValues]) -> Vec<Parameter> {
    let mean = |suffix: &str, value: fn(&ErrorMotionValues) -> f64| {
        let count = values.len() as f64;
        let mean = values.iter().map(value).sum::<f64>() / count;
        let squares: f64 = values.iter().map(|own| (value(own) - mean).powi(2)).sum();
        let u = (squares / (count - 1.0) / count).sqrt();
        parameter_without_budget(&format!("{symbol}_{suffix}"), unit, mean, u, Some(count - 1.0))
    };
    if values.len() < 2 {
        return Vec::new();
    }
    vec![mean("total", |own| own.total_value), mean("asynchronous", |own| own.asynchronous_value)]
}
