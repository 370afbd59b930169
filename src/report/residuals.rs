//! Residuals of the measurements over the time of the run and over the temperature: a drift or a thermal effect that
//! the model does not contain is visible as a trend.

use std::collections::BTreeSet;

use minijinja::{Value, context};

use super::captions::{svg_value, symbol_value};
use super::figure;
use machine::record::estimate::{Estimate, EstimatedFunction, FunctionFigureKind, Unit};
use machine::record::measurement_check::MeasurementCheck;
use machine::record::reading::Reading;

/// Minimum number of measurements for a figure.
const MIN_MEASUREMENTS_PER_FIGURE: usize = 3;
const SECONDS_PER_MINUTE: f64 = 60.0;

/// One figure of the residuals.
#[derive(Debug, Clone, PartialEq)]
pub struct ResidualFigure {
    /// Residuals over the time, the number of the measurement or the temperature.
    pub function: EstimatedFunction,
    /// Points (argument, residual) that are possible outliers.
    pub outlier_points: Vec<[f64; 2]>,
    pub caption: String,
}

/// Figures of the residuals of a run: over the time, and over the temperature of each thermometer whose temperature
/// changed. Empty if fewer than three measurements have a residual.
pub fn residual_figures(readings: &[Reading], estimate: &Estimate) -> Vec<ResidualFigure> {
    let Some(residuals) = RunResiduals::new(readings, estimate) else { return Vec::new() };
    let mut figures = vec![residuals.figure_over_time()];
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
struct MeasurementResidual {
    /// Measured minus modelled value, outward along a touch; for a point, the length of the difference.
    residual_um: f64,
    /// Whether the measurement is a possible outlier that no repeated measurement has replaced.
    is_outlier_candidate: bool,
    /// Mean time of the readings of the measurement, s; `None`: unknown.
    t_s: Option<f64>,
}

/// Residuals of an estimate, and the readings of its run.
struct RunResiduals<'a> {
    readings: &'a [Reading],
    /// Measurements with a finite residual.
    measurements: Vec<MeasurementResidual>,
}

impl<'a> RunResiduals<'a> {
    /// `None`: fewer than [`MIN_MEASUREMENTS_PER_FIGURE`] measurements have a residual.
    fn new(readings: &'a [Reading], estimate: &Estimate) -> Option<Self> {
        let unresolved = estimate.outliers.iter().filter(|outlier| !outlier.is_replaced());
        let candidates: BTreeSet<&str> =
            unresolved.flat_map(|outlier| &outlier.candidates).map(|candidate| candidate.label.as_str()).collect();
        let measurement = |check: &MeasurementCheck| {
            Some(MeasurementResidual {
                residual_um: check.residual_um.filter(|um| um.is_finite())?,
                is_outlier_candidate: candidates.contains(check.label.as_str()),
                t_s: check.t_s,
            })
        };
        let measurements: Vec<MeasurementResidual> =
            estimate.measurement_checks.iter().filter_map(measurement).collect();
        (measurements.len() >= MIN_MEASUREMENTS_PER_FIGURE).then_some(Self { readings, measurements })
    }

    /// Figure over the time since the first reading, or over the number of the measurement if a time is unknown.
    fn figure_over_time(&self) -> ResidualFigure {
        let begin_s = self.readings.first().map_or(0.0, |first| first.t_s);
        let minutes = |measurement: &MeasurementResidual| Some((measurement.t_s? - begin_s) / SECONDS_PER_MINUTE);
        let times: Option<Vec<f64>> = self.measurements.iter().map(minutes).collect();
        match times.filter(|times| has_different_values(times)) {
            Some(times) => {
                let caption = format!(
                    "over the time since the first reading: {}. A trend, or larger residuals at the start and at the \
                     end, indicate a drift that the model does not contain: the declared drift may be too small",
                    self.describe_residuals()
                );
                self.figure_over(["time", "min"], times.into_iter().map(Some), caption)
            }
            None => {
                let numbers = (1..=self.measurements.len()).map(|number| Some(number as f64));
                let caption = format!("over the number of the measurement: {}", self.describe_residuals());
                self.figure_over(["measurement number", ""], numbers, caption)
            }
        }
    }

    /// Figure over the temperature in the reading nearest in time to each measurement. `None` if the temperature did
    /// not change or is known for too few measurements.
    fn figure_over_temperature(&self, thermometer: &str) -> Option<ResidualFigure> {
        let of_reading = |reading: &Reading| Some((reading.t_s, reading.temperatures_c.get(thermometer)?));
        let mut by_time: Vec<(f64, f64)> = self.readings.iter().filter_map(of_reading).collect();
        by_time.sort_by(|one, other| one.0.total_cmp(&other.0));
        let celsius = |measurement: &MeasurementResidual| nearest_value(&by_time, measurement.t_s?);
        let all: Vec<Option<f64>> = self.measurements.iter().map(celsius).collect();
        let known: Vec<f64> = all.iter().flatten().copied().collect();
        let caption = format!(
            "over the temperature of the thermometer {thermometer}: the same residuals. A trend indicates a \
             thermal effect that the model does not contain"
        );
        let is_drawn = known.len() >= MIN_MEASUREMENTS_PER_FIGURE && has_different_values(&known);
        is_drawn.then(|| self.figure_over(["temperature", "°C"], all.into_iter(), caption))
    }

    /// Figure of the measurements with a known argument, sorted by the argument. `argument`: name and unit.
    fn figure_over(
        &self,
        argument: [&str; 2],
        arguments: impl Iterator<Item = Option<f64>>,
        caption: String,
    ) -> ResidualFigure {
        let points = arguments.zip(&self.measurements);
        let mut points: Vec<(f64, &MeasurementResidual)> = points.filter_map(|(x, own)| Some((x?, own))).collect();
        points.sort_by(|one, other| one.0.total_cmp(&other.0));
        let candidates = points.iter().filter(|(_, residual)| residual.is_outlier_candidate);
        let outlier_points: Vec<[f64; 2]> = candidates.map(|(x, residual)| [*x, residual.residual_um]).collect();
        let circled = if outlier_points.is_empty() { "" } else { ". Circled: possible outliers" };
        let symbol = if self.are_all_nonnegative() { "residual length" } else { "residual" };
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

    /// Whether no residual is negative: the residuals then count as lengths of vectors.
    fn are_all_nonnegative(&self) -> bool {
        self.measurements.iter().all(|measurement| measurement.residual_um >= 0.0)
    }

    fn describe_residuals(&self) -> String {
        let count = self.measurements.len();
        match self.are_all_nonnegative() {
            true => format!("length of the vector from the modelled to the measured point, {count} measurements"),
            false => format!("measured minus modelled value, {count} measurements"),
        }
    }

    /// Names of the thermometers, each once.
    fn thermometer_names(&self) -> BTreeSet<&str> {
        self.readings.iter().flat_map(|reading| reading.temperatures_c.iter().map(|(name, _)| name)).collect()
    }
}

/// Value at the time nearest to `t_s`, of (time, value) in the order of time.
fn nearest_value(by_time: &[(f64, f64)], t_s: f64) -> Option<f64> {
    let next = by_time.partition_point(|(time_s, _)| *time_s < t_s);
    let neighbours = &by_time[next.saturating_sub(1)..(next + 1).min(by_time.len())];
    let nearest = neighbours.iter().min_by(|one, other| (one.0 - t_s).abs().total_cmp(&(other.0 - t_s).abs()));
    nearest.map(|(_, value)| *value)
}

fn has_different_values(values: &[f64]) -> bool {
    values.windows(2).any(|pair| pair[0] != pair[1])
}

#[cfg(test)]
mod tests;
