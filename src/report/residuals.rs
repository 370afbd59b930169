//! Residuals of the measurements over the time of the run and over the temperature: a drift or a thermal effect that
//! the model does not contain is visible as a trend.

use minijinja::{Value, context};

use super::captions::{svg_value, symbol_value};
use super::figure;
use machine::record::estimate::{Estimate, EstimatedFunction, FunctionFigureKind, Unit};
use machine::record::measurement_check::{MeasurementCheck, Outlier};
use machine::record::plan::Plan;
use machine::record::reading::Reading;
use methods::measurement_conditions::{MeasurementConditions, measurement_conditions};

/// Minimum number of measurements with a figure.
const MIN_MEASUREMENTS: usize = 3;
const SECONDS_PER_MINUTE: f64 = 60.0;

/// One figure of the residuals.
#[derive(Debug, Clone, PartialEq)]
pub struct ResidualFigure {
    /// Residuals over the time, the number of the measurement or the temperature.
    pub function: EstimatedFunction,
    /// Points (argument, residual) that are candidates of an outlier.
    pub outlier_points: Vec<[f64; 2]>,
    pub caption: String,
}

/// Figures of the residuals of a run: over the time, and over the temperature of each thermometer whose temperature
/// changed. Empty for an estimate without residuals.
pub fn residual_figures(plan: &Plan, readings: &[Reading], estimate: &Estimate) -> Vec<ResidualFigure> {
    let Some(residuals) = RunResiduals::new(plan, readings, estimate) else { return Vec::new() };
    let mut figures = vec![residuals.figure_over_time(readings)];
    figures.extend(residuals.thermometer_names().iter().filter_map(|name| residuals.figure_over_temperature(name)));
    figures
}

/// Template values of the figures, as those of [`figure_values`](super::figure_values).
pub fn residual_figure_values(figures: &[ResidualFigure]) -> Vec<Value> {
    let value = |figure: &ResidualFigure| {
        context! {
            symbol => symbol_value(&figure.function.symbol),
            caption => figure.caption.as_str(),
            square => false,
            svg => svg_value(figure::draw_points_with_circles(&figure.function, &figure.outlier_points)),
        }
    };
    figures.iter().map(value).collect()
}

/// Residual of one measurement.
struct MeasurementResidual<'a> {
    residual_um: f64,
    is_outlier_candidate: bool,
    conditions: Option<&'a MeasurementConditions>,
}

struct RunResiduals<'a> {
    estimate: &'a Estimate,
    /// Measurements with a finite residual.
    checks: Vec<(&'a MeasurementCheck, f64)>,
    /// Conditions of each of the `checks`.
    conditions: Vec<Option<MeasurementConditions>>,
}

impl<'a> RunResiduals<'a> {
    fn new(plan: &Plan, readings: &[Reading], estimate: &'a Estimate) -> Option<Self> {
        let checks = estimate.measurement_checks.iter();
        let checks: Vec<(&MeasurementCheck, f64)> =
            checks.filter_map(|check| Some((check, check.residual_um.filter(|um| um.is_finite())?))).collect();
        let labels: Vec<&str> = checks.iter().map(|(check, _)| check.label.as_str()).collect();
        (checks.len() >= MIN_MEASUREMENTS).then(|| {
            let conditions = measurement_conditions(plan, readings, &labels);
            Self { estimate, checks, conditions }
        })
    }

    fn residuals(&self) -> impl Iterator<Item = MeasurementResidual<'_>> {
        let unresolved = |outlier: &&Outlier| !outlier.is_replaced();
        let is_candidate = move |label: &str| {
            let mut candidates = self.estimate.outliers.iter().filter(unresolved).flat_map(|one| &one.candidates);
            candidates.any(|candidate| candidate.label == label)
        };
        self.checks.iter().zip(&self.conditions).map(move |((check, residual_um), conditions)| MeasurementResidual {
            residual_um: *residual_um,
            is_outlier_candidate: is_candidate(&check.label),
            conditions: conditions.as_ref(),
        })
    }

    /// Over the time since the first reading, or over the number of the measurement if a time is unknown.
    fn figure_over_time(&self, readings: &[Reading]) -> ResidualFigure {
        let begin_s = readings.first().map_or(0.0, |first| first.t_s);
        let minutes =
            |residual: &MeasurementResidual<'_>| Some((residual.conditions?.t_s - begin_s) / SECONDS_PER_MINUTE);
        let times: Option<Vec<f64>> = self.residuals().map(|residual| minutes(&residual)).collect();
        match times.filter(|times| is_changing(times)) {
            Some(times) => {
                let caption = format!(
                    "over the time since the first reading: {}. A trend, or larger residuals at the start and at the \
                     end, indicate a drift that the model does not contain: the declared drift may be too small",
                    self.describe_residuals()
                );
                self.figure_over(["time", "min"], times.into_iter().map(Some), caption)
            }
            None => {
                let numbers = (1..=self.checks.len()).map(|number| Some(number as f64));
                let caption = format!("over the number of the measurement: {}", self.describe_residuals());
                self.figure_over(["measurement number", ""], numbers, caption)
            }
        }
    }

    /// `None` if the temperature did not change or is known for too few measurements.
    fn figure_over_temperature(&self, thermometer: &str) -> Option<ResidualFigure> {
        let celsius = |residual: MeasurementResidual<'_>| residual.conditions?.temperatures_c.get(thermometer).copied();
        let all: Vec<Option<f64>> = self.residuals().map(celsius).collect();
        let known: Vec<f64> = all.iter().flatten().copied().collect();
        let caption = format!(
            "over the temperature of the thermometer {thermometer}: the same residuals. A trend indicates a \
             thermal effect that the model does not contain"
        );
        let is_drawn = known.len() >= MIN_MEASUREMENTS && is_changing(&known);
        is_drawn.then(|| self.figure_over(["temperature", "°C"], all.into_iter(), caption))
    }

    /// Points with an argument, in its order. `argument`: name and unit.
    fn figure_over(
        &self,
        argument: [&str; 2],
        arguments: impl Iterator<Item = Option<f64>>,
        caption: String,
    ) -> ResidualFigure {
        let points = arguments.zip(self.residuals());
        let mut points: Vec<(f64, MeasurementResidual<'_>)> = points.filter_map(|(x, own)| Some((x?, own))).collect();
        points.sort_by(|one, other| one.0.total_cmp(&other.0));
        let candidates = points.iter().filter(|(_, residual)| residual.is_outlier_candidate);
        let outlier_points: Vec<[f64; 2]> = candidates.map(|(x, residual)| [*x, residual.residual_um]).collect();
        let circled = if outlier_points.is_empty() { "" } else { ". Circled: possible outliers" };
        let symbol = if self.are_lengths() { "residual length" } else { "residual" };
        let function = EstimatedFunction {
            symbol: symbol.to_owned(),
            argument: argument[0].to_owned(),
            argument_unit: argument[1].to_owned(),
            x: points.iter().map(|(x, _)| *x).collect(),
            unit: Unit::Um,
            y: points.iter().map(|(_, residual)| residual.residual_um).collect(),
            u: Vec::new(),
            figure: FunctionFigureKind::Points,
            at_mm: None,
        };
        ResidualFigure { function, outlier_points, caption: format!("{caption}{circled}.") }
    }

    /// Whether the residuals are lengths of vectors, which are not negative.
    fn are_lengths(&self) -> bool {
        self.checks.iter().all(|(_, residual_um)| *residual_um >= 0.0)
    }

    fn describe_residuals(&self) -> String {
        let count = self.checks.len();
        match self.are_lengths() {
            true => format!("length of the vector from the modelled to the measured point, {count} measurements"),
            false => format!("measured minus modelled value, {count} measurements"),
        }
    }

    /// Names of the thermometers, each once.
    fn thermometer_names(&self) -> Vec<String> {
        let names = self.conditions.iter().flatten().flat_map(|conditions| conditions.temperatures_c.keys().cloned());
        names.collect::<std::collections::BTreeSet<String>>().into_iter().collect()
    }
}

fn is_changing(values: &[f64]) -> bool {
    values.windows(2).any(|pair| pair[0] != pair[1])
}

#[cfg(test)]
mod tests;
