//! Gauges of measured values, for Prometheus. They are built for each scrape from the newest result of each method,
//! so that nothing remains of a result that is outdated or replaced. The label values are bounded: configured
//! machines, methods of this program, the parameters of one estimate, configured thermometers.
//!
//! By the conventions of Prometheus a metric has one unit, the base unit, at the end of its name. The parameters have
//! several units, so there is one metric for each base unit instead of a label `unit`: a sum or a graph of one metric
//! never mixes units.

use std::borrow::Cow;
use std::fmt;
use std::sync::atomic::AtomicU64;

use prometheus_client::encoding::text::encode_registry;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::{Metric, Registry, Unit as MetricUnit};

use super::machine_state::CycleOutcome;
use crate::store::FinishedRunResult;
use machine::record::estimate::{Parameter, Unit, Verdict};

/// Prefix of all metric names.
pub const METRIC_PREFIX: &str = "trued";

/// Names and values of the `N` labels of a series.
pub type MetricLabels<const N: usize> = [(&'static str, Cow<'static, str>); N];

/// The newest result of one method on a machine.
#[derive(Debug, Clone, PartialEq)]
pub struct NewestMethodResult {
    pub machine: String,
    pub result: FinishedRunResult,
    /// Whether the result no longer describes the machine; then only its time is reported.
    pub outdated: bool,
}

type GaugeFamily<const N: usize> = Family<MetricLabels<N>, Gauge<f64, AtomicU64>>;
/// Gauges with the value 1 or 0.
type FlagFamily<const N: usize> = Family<MetricLabels<N>, Gauge>;

/// Base units of the parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum BaseUnit {
    Meters,
    Radians,
    /// Without a dimension, for values in µm/m.
    Ratios,
    Seconds,
}

impl BaseUnit {
    const ALL: [Self; 4] = [Self::Meters, Self::Radians, Self::Ratios, Self::Seconds];

    fn metric_unit(self) -> MetricUnit {
        match self {
            Self::Meters => MetricUnit::Meters,
            Self::Radians => MetricUnit::Other("radians".to_owned()),
            Self::Ratios => MetricUnit::Ratios,
            Self::Seconds => MetricUnit::Seconds,
        }
    }

    /// Base unit of `unit`, and the number of `unit` in one base unit: 1e6 µm are 1 m.
    fn with_units_per_base_unit(unit: Unit) -> (Self, f64) {
        match unit {
            Unit::Um => (Self::Meters, 1e6),
            Unit::Mm => (Self::Meters, 1e3),
            Unit::Urad => (Self::Radians, 1e6),
            Unit::UmPerM => (Self::Ratios, 1e6),
            Unit::Ms => (Self::Seconds, 1e3),
        }
    }
}

/// Gauges of the parameters in one base unit.
struct ParameterGauges {
    /// Values of identifiable parameters, by machine, method and symbol.
    values: GaugeFamily<3>,
    expanded_uncertainties: GaugeFamily<3>,
    /// Limits of the magnitude of the values; only parameters with a limit have one.
    limits: GaugeFamily<3>,
}

impl ParameterGauges {
    fn register(registry: &mut Registry, unit: &MetricUnit) -> Self {
        let help = "Value of a parameter in the newest result of a method";
        let values = register_with_unit(registry, "parameter_value", help, unit);
        let help = "Expanded uncertainty U of the value";
        let expanded_uncertainties = register_with_unit(registry, "parameter_expanded_uncertainty", help, unit);
        let help = "Limit of the magnitude of the value";
        let limits = register_with_unit(registry, "parameter_limit", help, unit);
        Self { values, expanded_uncertainties, limits }
    }
}

fn register_with_unit<M: Metric + Clone + Default>(
    registry: &mut Registry,
    name: &str,
    help: &str,
    unit: &MetricUnit,
) -> M {
    let metric = M::default();
    registry.register_with_unit(name, help, unit.clone(), metric.clone());
    metric
}

/// Gauges of all results of one scrape.
struct ResultMetrics {
    registry: Registry,
    /// In the order of [`BaseUnit::ALL`].
    parameters_by_base_unit: [ParameterGauges; 4],
    /// By parameter and verdict: 1 for its verdict, 0 for the others; only parameters with a limit.
    parameter_verdicts: FlagFamily<4>,
    /// By method and verdict: 1 for the verdict of the result, 0 for the others.
    result_verdicts: FlagFamily<3>,
    /// Unix time at which the run of the result ended, s; also of an outdated result.
    measurement_times: GaugeFamily<2>,
    /// Mean temperatures during the run, °C, by thermometer.
    temperatures: GaugeFamily<3>,
}

/// Writes the metrics of `results` in the OpenMetrics text format, without its end mark.
///
/// # Errors
/// `text` cannot be written to.
pub fn encode_result_metrics(results: &[NewestMethodResult], text: &mut String) -> fmt::Result {
    let metrics = ResultMetrics::new();
    results.iter().for_each(|newest| metrics.add_result(newest));
    encode_registry(text, &metrics.registry)
}

impl ResultMetrics {
    fn new() -> Self {
        let mut registry = Registry::with_prefix(METRIC_PREFIX);
        let parameters_by_base_unit =
            BaseUnit::ALL.map(|unit| ParameterGauges::register(&mut registry, &unit.metric_unit()));
        let parameter_verdicts = FlagFamily::default();
        let help = "1 for the verdict of a parameter that has a limit";
        registry.register("parameter_verdict", help, parameter_verdicts.clone());
        let result_verdicts = FlagFamily::default();
        let help = "1 for the verdict of the newest result of a method";
        registry.register("result_verdict", help, result_verdicts.clone());
        let help = "Unix time at which the newest result of a method was measured, also if it is outdated";
        let measurement_times = register_with_unit(&mut registry, "result_timestamp", help, &MetricUnit::Seconds);
        let help = "Mean temperature of a thermometer during the measurement of the newest result of a method";
        let temperatures = register_with_unit(&mut registry, "result_temperature", help, &MetricUnit::Celsius);
        Self { registry, parameters_by_base_unit, parameter_verdicts, result_verdicts, measurement_times, temperatures }
    }

    /// Adds the metrics of one result; of an outdated result only the time of its measurement.
    fn add_result(&self, NewestMethodResult { machine, result, outdated }: &NewestMethodResult) {
        let labels = [label("machine", machine), label("method", &result.method)];
        let ended_s = result.ended.as_duration().as_secs_f64();
        self.measurement_times.get_or_create(&labels).set(ended_s);
        if *outdated {
            return;
        }
        for verdict in Verdict::ALL {
            let flag = i64::from(verdict == result.verdict);
            self.result_verdicts.get_or_create(&with_label(&labels, verdict_label(verdict))).set(flag);
        }
        for (thermometer, celsius) in result.temperatures_c.iter() {
            self.temperatures.get_or_create(&with_label(&labels, label("thermometer", thermometer))).set(celsius);
        }
        for parameter in &result.parameters {
            self.add_parameter(&with_label(&labels, label("symbol", &parameter.symbol)), parameter);
        }
    }

    /// Adds value and U of an identifiable parameter, and limit and verdict of a parameter with a limit.
    fn add_parameter(&self, labels: &MetricLabels<3>, parameter: &Parameter) {
        let (base_unit, units_per_base_unit) = BaseUnit::with_units_per_base_unit(parameter.unit);
        let gauges = &self.parameters_by_base_unit[base_unit as usize];
        if parameter.identifiable && parameter.value.is_finite() {
            gauges.values.get_or_create(labels).set(parameter.value / units_per_base_unit);
            gauges.expanded_uncertainties.get_or_create(labels).set(parameter.expanded / units_per_base_unit);
        }
        let Some(judged) = parameter.judged else { return };
        gauges.limits.get_or_create(labels).set(judged.limit / units_per_base_unit);
        for verdict in Verdict::ALL.into_iter().filter(|verdict| *verdict != Verdict::None) {
            let flag = i64::from(verdict == judged.verdict);
            self.parameter_verdicts.get_or_create(&with_label(labels, verdict_label(verdict))).set(flag);
        }
    }
}

type MetricLabel = (&'static str, Cow<'static, str>);

fn label(name: &'static str, value: &str) -> MetricLabel {
    (name, Cow::from(value.to_owned()))
}

fn verdict_label(verdict: Verdict) -> MetricLabel {
    ("verdict", CycleOutcome::Judged(verdict).label().into())
}

/// The labels with one more; `M` must be `N + 1`.
fn with_label<const N: usize, const M: usize>(labels: &MetricLabels<N>, last: MetricLabel) -> MetricLabels<M> {
    let mut all = labels.iter().cloned().chain([last]);
    std::array::from_fn(|_| all.next().unwrap_or_default())
}
