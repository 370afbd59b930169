//! Repetitions of a measurement in the journal, for their repeatability: the passes of one run (`trued run --repeat`),
//! each identified alone, or several runs of one method on one machine.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use super::identify::{IdentificationError, identify_readings};
use crate::setup::SetupError;
use crate::store::{Journal, RunId, StoreError, StoredRun};
use machine::record::estimate::{Parameter, Unit};
use machine::record::plan::FIRST_OUTLIER_REPEAT_NUMBER;
use machine::record::reading::{Reading, Temperatures};
use methods::decision::repeatability::{Repeatability, Repetition};

/// What was repeated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum RepetitionKind {
    /// Passes of the complete cycle within one run.
    Passes,
    /// Separate runs of one method on one machine.
    Runs,
}

/// Repeatability of all parameters that every repetition has identified.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RepeatabilityTable {
    pub method: String,
    pub machine: String,
    /// One run if its passes are compared.
    pub runs: Vec<RunId>,
    pub repeated: RepetitionKind,
    pub parameters: Vec<Repeatability>,
}

/// Reason why no repeatability can be computed.
#[derive(Debug, thiserror::Error)]
pub enum RepeatabilityError {
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Identification(#[from] IdentificationError),
    #[error("run {0} has fewer than two complete passes")]
    FewerThanTwoPasses(RunId),
    #[error("run {0} has no estimate")]
    NoEstimate(RunId),
    #[error("run {0} is listed twice")]
    DuplicateRun(RunId),
    /// The run that differs, and the first listed run.
    #[error("run {0} has another method or another machine than run {1}")]
    OtherMethodOrMachine(RunId, RunId),
    /// The run that differs, the first listed run, and what differs.
    #[error("run {0} has {what} other than run {1}", what = .2)]
    OtherSetup(RunId, RunId, &'static str),
}

impl RepeatabilityError {
    pub fn remedy(&self) -> Option<String> {
        match self {
            Self::Store(error) => Some(error.remedy().to_owned()),
            Self::Identification(error) => error.remedy(),
            Self::FewerThanTwoPasses(_) => {
                Some("measure with `trued run self-calibration --repeat 5`, or name several runs".to_owned())
            }
            Self::NoEstimate(run) => Some(format!("`trued show {run}` states the next action")),
            Self::DuplicateRun(_) | Self::OtherMethodOrMachine(..) | Self::OtherSetup(..) => {
                let remedy =
                    "choose runs of one method, machine, probe and artefact; `trued compare` shows differences";
                Some(remedy.to_owned())
            }
        }
    }
}

/// Parameters of one repetition, with its mean time and temperatures.
struct RepetitionResult {
    /// Mean time of the readings, s: on the clock of the run for passes, since the start of the first listed run for
    /// runs.
    mean_time_s: f64,
    /// Mean temperature of each thermometer.
    mean_temperatures_c: Temperatures,
    parameters: Vec<Parameter>,
}

/// Repeatability of the passes of one run, or of several runs.
///
/// # Errors
/// The runs cannot be read, cannot be compared, or a pass cannot be identified alone.
pub fn repeatability_of_runs(journal: &Journal, runs: &[RunId]) -> Result<RepeatabilityTable, RepeatabilityError> {
    let stored = runs.iter().map(|run| journal.load_run(*run)).collect::<Result<Vec<_>, _>>()?;
    let (repeated, results) = match stored.as_slice() {
        [single] => (RepetitionKind::Passes, results_of_passes(single)?),
        several => (RepetitionKind::Runs, results_of_runs(several)?),
    };
    let plan = stored.first().map(|first| &first.plan);
    Ok(RepeatabilityTable {
        method: plan.map(|plan| plan.method.clone()).unwrap_or_default(),
        machine: plan.map(|plan| plan.machine.name.clone()).unwrap_or_default(),
        runs: runs.to_vec(),
        repeated,
        parameters: repeatability_of_parameters(&results),
    })
}

/// Own estimate of each run. All runs must have the method, machine, settings, probe and artefact of the first.
fn results_of_runs(runs: &[StoredRun]) -> Result<Vec<RepetitionResult>, RepeatabilityError> {
    let mut results = Vec::new();
    for (index, run) in runs.iter().enumerate() {
        let (id, first) = (run.summary.id, &runs[0].summary);
        if runs[..index].iter().any(|earlier| earlier.summary.id == id) {
            return Err(RepeatabilityError::DuplicateRun(id));
        }
        if (&run.summary.method, &run.summary.machine) != (&first.method, &first.machine) {
            return Err(RepeatabilityError::OtherMethodOrMachine(id, first.id));
        }
        let (plan, plan_of_first) = (&run.plan, &runs[0].plan);
        let differences = [
            ("settings", plan.settings != plan_of_first.settings),
            ("a probe", plan.probe != plan_of_first.probe),
            ("an artefact", plan.artefact != plan_of_first.artefact),
        ];
        if let Some((what, _)) = differences.into_iter().find(|(_, is_other)| *is_other) {
            return Err(RepeatabilityError::OtherSetup(id, first.id, what));
        }
        let estimate = run.own_estimate().ok_or(RepeatabilityError::NoEstimate(id))?;
        let begun_s = run.summary.started.duration_since(first.started).as_secs_f64();
        results.push(RepetitionResult::new(&run.readings, begun_s, estimate.parameters.clone()));
    }
    Ok(results)
}

/// Result of each complete pass, identified alone, with the steps that are measured once before the passes.
fn results_of_passes(run: &StoredRun) -> Result<Vec<RepetitionResult>, RepeatabilityError> {
    let has_passes =
        methods::method_description(&run.plan.method).is_some_and(|description| description.has_cycle_passes);
    let read: BTreeSet<(u32, u32)> = run.readings.iter().map(|reading| (reading.step, reading.repeat)).collect();
    let is_pass = |repeat: &u32| has_passes && *repeat < FIRST_OUTLIER_REPEAT_NUMBER;
    // The steps before the passes, which locate the part, are measured once.
    let is_later_pass = |(_, repeat): &&(u32, u32)| *repeat > 0 && is_pass(repeat);
    let repeated_steps: BTreeSet<u32> = read.iter().filter(is_later_pass).map(|(step, _)| *step).collect();
    let repeats: BTreeSet<u32> = read.iter().map(|(_, repeat)| *repeat).filter(is_pass).collect();
    // A run that was stopped may end within a pass.
    let is_complete = |pass: &u32| repeated_steps.iter().all(|step| read.contains(&(*step, *pass)));
    let passes: Vec<u32> = repeats.into_iter().filter(is_complete).collect();
    if passes.len() < 2 || repeated_steps.is_empty() {
        return Err(RepeatabilityError::FewerThanTwoPasses(run.summary.id));
    }
    let mut plan = run.plan.clone();
    plan.settings["repeats"] = 1.into();
    if let Some(trials) = plan.settings.get_mut("monte_carlo_trials") {
        // Only values and u are used.
        *trials = methods::MethodRefusal::MIN_MONTE_CARLO_TRIALS.into();
    }
    let method = methods::configure_method(&plan.method, plan.settings.clone());
    let settings_error = |error: serde_json::Error| SetupError::MethodSettings { why: error.to_string() };
    let method = method.map_err(|error| IdentificationError::Setup(Box::new(settings_error(error))))?;
    let identify_pass = |pass: u32| {
        let readings = readings_of_pass(&run.readings, &repeated_steps, pass);
        let estimate = identify_readings(method.as_ref(), &plan, &readings).map_err(IdentificationError::from)?;
        let of_pass = |reading: &&Reading| repeated_steps.contains(&reading.step);
        let own: Vec<Reading> = readings.iter().filter(of_pass).cloned().collect();
        Ok(RepetitionResult::new(&own, 0.0, estimate.parameters))
    };
    passes.into_iter().map(identify_pass).collect()
}

/// Readings of one pass, and of the steps that are measured once before the passes, as the readings of a run with a
/// single pass.
fn readings_of_pass(readings: &[Reading], repeated_steps: &BTreeSet<u32>, pass: u32) -> Vec<Reading> {
    let is_of_pass = |reading: &&Reading| match repeated_steps.contains(&reading.step) {
        true => reading.repeat == pass,
        false => reading.repeat < FIRST_OUTLIER_REPEAT_NUMBER,
    };
    readings.iter().filter(is_of_pass).map(|reading| Reading { repeat: 0, ..reading.clone() }).collect()
}

impl RepetitionResult {
    /// `time_origin_s`: origin of the times of the readings, s.
    fn new(readings: &[Reading], time_origin_s: f64, parameters: Vec<Parameter>) -> Self {
        let mean_time_s = mean(readings.iter().map(|reading| reading.t_s)).unwrap_or(0.0);
        let names = readings.iter().flat_map(|reading| reading.temperatures_c.iter().map(|(name, _)| name));
        let names: BTreeSet<&str> = names.collect();
        let mean_of = |name: &str| {
            let celsius = mean(readings.iter().filter_map(|reading| reading.temperatures_c.get(name)))?;
            Some((name.to_owned(), celsius))
        };
        let temperatures: BTreeMap<String, f64> = names.into_iter().filter_map(mean_of).collect();
        Self { mean_time_s: time_origin_s + mean_time_s, mean_temperatures_c: temperatures.into(), parameters }
    }

    /// The parameter, if it is identifiable and value and u are finite.
    fn parameter(&self, symbol: &str, unit: Unit) -> Option<&Parameter> {
        let is_known = |one: &&Parameter| one.identifiable && one.value.is_finite() && one.u.is_finite();
        self.parameters.iter().filter(is_known).find(|one| one.symbol == symbol && one.unit == unit)
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    (count > 0.0).then(|| sum / count)
}

/// Repeatability of the parameters that every repetition has identified, in the order of the first repetition.
fn repeatability_of_parameters(results: &[RepetitionResult]) -> Vec<Repeatability> {
    let of_parameter = |Parameter { symbol, unit, .. }: &Parameter| {
        let repetition = |result: &RepetitionResult| {
            let Parameter { value, u, .. } = *result.parameter(symbol, *unit)?;
            Some(Repetition {
                time_s: result.mean_time_s,
                value,
                u,
                temperatures_c: result.mean_temperatures_c.clone(),
            })
        };
        let repetitions: Option<Vec<Repetition>> = results.iter().map(repetition).collect();
        Repeatability::from_repetitions(symbol, *unit, &repetitions?)
    };
    results.first().map_or(Vec::new(), |first| first.parameters.iter().filter_map(of_parameter).collect())
}
