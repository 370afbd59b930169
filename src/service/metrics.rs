//! Counters and gauges in Prometheus format. The number of label values is bounded: they are the configured
//! machines and fixed lists of this program.

use std::borrow::Cow;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use prometheus_client::encoding::text::{encode_eof, encode_registry};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Metric, Registry};

use super::machine_state::{CycleOutcome, MachineState, ServiceState};
use super::result_metrics::{METRIC_PREFIX, MetricLabels, NewestMethodResult, encode_result_metrics};

type SecondsGauge = Gauge<f64, AtomicU64>;

/// Metrics of the whole daemon.
#[derive(Clone)]
pub struct Metrics {
    registry: Arc<Registry>,
    /// Ended cycles and identifications by machine and [`CycleOutcome::label`].
    cycles_by_outcome: Family<MetricLabels<2>, Counter>,
    /// Touches and scans by machine.
    readings: Family<MetricLabels<1>, Counter>,
    /// Refused requests by machine and reason.
    refusals: Family<MetricLabels<2>, Counter>,
    /// Cycles whose measurement ended by a failure of a link to the control or to a sensor, by machine.
    cycles_ended_by_link_error: Family<MetricLabels<1>, Counter>,
    /// By machine and state: 1 for the current state, 0 for the others.
    state: Family<MetricLabels<2>, Gauge>,
    /// Time since the worker of a machine last reported progress.
    progress_age: Family<MetricLabels<1>, SecondsGauge>,
    /// Duration of each write job of the journal, s.
    journal_write_time: Histogram,
}

impl Default for Metrics {
    fn default() -> Self {
        let mut registry = Registry::with_prefix(METRIC_PREFIX);
        registry.register("build", "Version of the program", Info::new([("version", env!("CARGO_PKG_VERSION"))]));
        let runs = register_metric(&mut registry, "runs", "Cycles by outcome");
        let readings = register_metric(&mut registry, "readings", "Touches and scans in the journal");
        let refusals = register_metric(&mut registry, "refusals", "Refused requests by reason");
        let link_errors = register_metric(&mut registry, "link_errors", "Cycles that ended with a link error");
        let state = register_metric(&mut registry, "state", "1 for the current state of a machine");
        let help = "Time since the worker of a machine last made progress; the watchdog monitors it";
        let progress_age = register_metric(&mut registry, "progress_age_seconds", help);
        // Time of a synced commit: buckets from 0.1 ms upwards, to cover a slow disk.
        let journal_write_time = Histogram::new(exponential_buckets(0.0001, 2.5, 12));
        let help = "Duration of a write job of the journal, including its commit";
        registry.register("journal_write_seconds", help, journal_write_time.clone());
        Self {
            registry: Arc::new(registry),
            cycles_by_outcome: runs,
            readings,
            refusals,
            cycles_ended_by_link_error: link_errors,
            state,
            progress_age,
            journal_write_time,
        }
    }
}

/// Adds a metric to the registry.
fn register_metric<M: Metric + Clone + Default>(registry: &mut Registry, name: &str, help: &str) -> M {
    let metric = M::default();
    registry.register(name, help, metric.clone());
    metric
}

impl Metrics {
    /// Callback for the journal's writer; it records the duration of each job.
    pub fn journal_write_observer(&self) -> impl Fn(Duration) + Send + 'static + use<> {
        let histogram = self.journal_write_time.clone();
        move |took: Duration| histogram.observe(took.as_secs_f64())
    }

    /// Sets the metrics of `machine`. The series of outcomes, readings and link errors exist from the start, those of
    /// refusals from the first refusal of their reason.
    pub fn update_machine(&self, machine: &str, machine_state: &MachineState, progress_age: Duration) {
        let MachineState { state: now, counters, .. } = machine_state;
        let name = || ("machine", Cow::from(machine.to_owned()));
        let set = |counter: &Counter, count: u64| counter.inner().store(count, Ordering::Relaxed);
        for state in ServiceState::ALL {
            let labels = [name(), ("state", state.label().into())];
            self.state.get_or_create(&labels).set(i64::from(state == *now));
        }
        self.progress_age.get_or_create(&[name()]).set(progress_age.as_secs_f64());
        for label in CycleOutcome::all().map(CycleOutcome::label) {
            let count = counters.outcome_counts_by_label.get(label).copied().unwrap_or_default();
            set(&self.cycles_by_outcome.get_or_create(&[name(), ("outcome", label.into())]), count);
        }
        for (why, count) in &counters.refusal_counts {
            let labels = [name(), ("reason", format!("{why:?}").into())];
            set(&self.refusals.get_or_create(&labels), *count);
        }
        set(&self.readings.get_or_create(&[name()]), counters.reading_count);
        set(&self.cycles_ended_by_link_error.get_or_create(&[name()]), counters.cycles_ended_by_link_error);
    }

    /// Returns all metrics in the OpenMetrics text format, with those of `results`.
    ///
    /// # Errors
    /// None known: writing to a `String` does not fail.
    pub fn encode_text(&self, results: &[NewestMethodResult]) -> Result<String, std::fmt::Error> {
        let mut text = String::new();
        encode_registry(&mut text, &self.registry)?;
        encode_result_metrics(results, &mut text)?;
        encode_eof(&mut text)?;
        Ok(text)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use serde_json::{Value, json};

    use super::*;
    use crate::store::{FinishedRunResult, RunId};
    use machine::record::estimate::Verdict;

    const DASHBOARD: &str = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/grafana/trued.json"));

    /// Names of all metrics, from the headings of the text format.
    fn all_metric_names() -> BTreeSet<String> {
        let parameter = |unit: &str| {
            let judged = json!({"limit": 1.0, "verdict": "pass"});
            let parameter = json!({"symbol": unit, "value": 1.0, "unit": unit, "u": 0.1, "U": 0.2, "k": 2.0,
                                   "dof": null, "identifiable": true, "judged": judged});
            serde_json::from_value(parameter).unwrap()
        };
        let result = FinishedRunResult {
            run: RunId(1),
            started: jiff::Timestamp::UNIX_EPOCH,
            ended: jiff::Timestamp::UNIX_EPOCH,
            method: "samba".to_owned(),
            verdict: Verdict::Pass,
            parameters: ["um", "urad", "um/m", "mm", "ms"].map(parameter).to_vec(),
            first_to_last_reading_s: None,
            temperatures_c: BTreeMap::from([("table".to_owned(), 20.0)]).into(),
        };
        let newest = NewestMethodResult { machine: "mill".to_owned(), result, outdated: false };
        let metrics = Metrics::default();
        metrics.update_machine("mill", &MachineState::default(), Duration::ZERO);
        let text = metrics.encode_text(&[newest]).unwrap();
        let headings = text.lines().filter_map(|line| line.strip_prefix("# TYPE "));
        headings.map(|heading| heading.split(' ').next().unwrap().to_owned()).collect()
    }

    /// The queries of the example dashboard contain each metric of the results, and no unknown one.
    #[test]
    fn dashboard_uses_the_metrics_of_the_results() {
        let dashboard: Value = serde_json::from_str(DASHBOARD).unwrap();
        let panels = dashboard["panels"].as_array().unwrap().iter();
        let targets = panels.flat_map(|panel| panel["targets"].as_array().into_iter().flatten());
        let variables = dashboard["templating"]["list"].as_array().unwrap().iter();
        let queries = targets.map(|target| &target["expr"]).chain(variables.map(|variable| &variable["definition"]));
        let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
        let words = queries.filter_map(Value::as_str).flat_map(|query| query.split(move |c| !is_name(c)));
        let used: BTreeSet<String> = words.filter(|word| word.starts_with("trued_")).map(str::to_owned).collect();
        let known = all_metric_names();
        assert_eq!(used.difference(&known).collect::<Vec<_>>(), Vec::<&String>::new());
        let is_of_result = |name: &&String| name.starts_with("trued_parameter_") || name.starts_with("trued_result_");
        assert_eq!(known.iter().filter(is_of_result).filter(|name| !used.contains(*name)).count(), 0, "{used:?}");
        assert_eq!(known.iter().filter(is_of_result).count(), 16);
    }
}
