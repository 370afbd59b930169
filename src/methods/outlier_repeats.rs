//! Outliers are measured again after the last stage, each step at most twice. The wrapped method gets the last
//! measurement of a step in place of the first.

use std::borrow::Cow;

use super::{IdentifyError, Method, MethodRefusal, NextStage, ObjectPositionSource};
use machine::record::estimate::Estimate;
use machine::record::measurement_check::Outlier;
use machine::record::plan::{FIRST_OUTLIER_REPEAT_NUMBER, FIRST_REPEAT_NUMBER_AFTER_STOP, Plan, Stage, Step, StepKind};
use machine::record::reading::Reading;
use machine::record::sensor::Sensor;

/// Maximum number of repeats of one step because of an outlier.
const MAX_OUTLIER_REPEATS: usize = 2;

/// Wrapper that measures outliers again after the last stage of `method`.
pub(super) struct OutlierRepeater {
    pub method: Box<dyn Method>,
    /// The same method with the minimum number of Monte Carlo trials.
    pub method_with_few_trials: Box<dyn Method>,
}

fn is_outlier_repeat(repeat_number: u32) -> bool {
    (FIRST_OUTLIER_REPEAT_NUMBER..FIRST_REPEAT_NUMBER_AFTER_STOP).contains(&repeat_number)
}

/// Readings in which the last outlier repeat of each step, among those with numbers below `end_repeat`, replaces the
/// earlier measurements of the step, with repeat number 0. Repeats after a stop are kept.
fn readings_of_latest_repeats(readings: &[Reading], end_repeat: u32) -> Cow<'_, [Reading]> {
    if !readings.iter().any(|reading| is_outlier_repeat(reading.repeat)) {
        return Cow::Borrowed(readings);
    }
    let counts = |reading: &&Reading| !is_outlier_repeat(reading.repeat) || reading.repeat < end_repeat;
    let last = |step: u32| {
        let repeats = readings.iter().filter(counts).filter(|reading| is_outlier_repeat(reading.repeat));
        repeats.filter(|reading| reading.step == step).map(|reading| reading.repeat).max()
    };
    let is_kept = |reading: &&Reading| match last(reading.step) {
        Some(last) => reading.repeat == last || reading.repeat >= FIRST_REPEAT_NUMBER_AFTER_STOP,
        None => true,
    };
    let renumbered = |reading: &Reading| match is_outlier_repeat(reading.repeat) {
        true => Reading { repeat: 0, ..reading.clone() },
        false => reading.clone(),
    };
    readings.iter().filter(counts).filter(is_kept).map(renumbered).collect::<Vec<_>>().into()
}

/// Whether `label` belongs to the measurement `measurement_label`: it is the same label, or starts with this label and
/// a slash.
fn is_part_of_measurement(label: &str, measurement_label: &str) -> bool {
    let rest = label.strip_prefix(measurement_label);
    rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

/// Measuring steps of the plan that belong to a candidate of the outlier.
fn outlier_steps<'p>(plan: &'p Plan, outlier: &Outlier) -> impl Iterator<Item = &'p Step> {
    let labels: Vec<String> = outlier.candidates.iter().map(|one| one.label.clone()).collect();
    let steps = plan.steps.iter().filter(|step| step.kind != StepKind::Prompt);
    steps.filter(move |step| labels.iter().any(|label| is_part_of_measurement(&step.label, label)))
}

impl OutlierRepeater {
    /// The stage that repeats the suspect steps of the earliest stage with suspects. All of its steps are of one
    /// stage, because the proof of a repeated stage uses the artefact position (`found`) of the original stage.
    /// `None`: no suspect step has repeats left, or the identification fails.
    fn outlier_repeat_stage(&self, plan: &Plan, done: &[Stage], readings: &[Reading]) -> Option<Stage> {
        // An error is reported when the run is identified.
        let estimate =
            self.method_with_few_trials.identify(plan, &readings_of_latest_repeats(readings, u32::MAX)).ok()?;
        let times = |step: &Step| {
            let repeat_stages = done.iter().filter(|stage| is_outlier_repeat(stage.repeat));
            repeat_stages.filter(|stage| stage.steps.contains(&step.id)).count()
        };
        let suspects = estimate.outliers.iter().flat_map(|outlier| outlier_steps(plan, outlier));
        let suspects: Vec<&Step> = suspects.filter(|step| times(step) < MAX_OUTLIER_REPEATS).collect();
        let is_suspect = |id: &u32| suspects.iter().any(|step| step.id == *id);
        let first = done.iter().find(|stage| stage.steps.iter().any(is_suspect))?;
        let rounds = done.iter().filter(|stage| is_outlier_repeat(stage.repeat)).count() as u32;
        Some(Stage {
            id: done.last().map_or(0, |stage| stage.id + 1),
            name: "outliers measured again".to_owned(),
            repeat: FIRST_OUTLIER_REPEAT_NUMBER + rounds,
            steps: first.steps.iter().copied().filter(is_suspect).collect(),
            found: first.found.clone(),
        })
    }

    /// Adds to the estimate the outliers that were measured again, with the deviations found before each round.
    /// Measurements that are still outliers come first.
    fn add_repeated_outliers(&self, plan: &Plan, readings: &[Reading], estimate: &mut Estimate) {
        let mut rounds: Vec<u32> = readings.iter().map(|reading| reading.repeat).collect();
        rounds.retain(|repeat| is_outlier_repeat(*repeat));
        rounds.sort_unstable();
        rounds.dedup();
        let is_measured = |outlier: &Outlier| {
            let steps = outlier_steps(plan, outlier).map(|step| step.id);
            let mut repeats = readings.iter().filter(|reading| is_outlier_repeat(reading.repeat));
            steps.into_iter().any(|id| repeats.any(|reading| reading.step == id))
        };
        for outlier in estimate.outliers.iter_mut().filter(|outlier| is_measured(outlier)) {
            outlier.resolution = Some("measured again: still an outlier".to_owned());
        }
        for before in rounds {
            let Ok(earlier) = self.method_with_few_trials.identify(plan, &readings_of_latest_repeats(readings, before))
            else {
                continue;
            };
            for outlier in earlier.outliers {
                let labels = |outlier: &Outlier| -> Vec<String> {
                    outlier.candidates.iter().map(|one| one.label.clone()).collect()
                };
                if estimate.outliers.iter().any(|known| labels(known) == labels(&outlier)) {
                    continue;
                }
                let off = outlier.candidates.iter();
                let off = off.map(|one| format!("{} by {:.1} µm", one.label, one.deviation_um));
                let off: Vec<String> = off.collect();
                estimate.warnings.push(format!(
                    "an outlier was found, with its deviation from the fit to all other measurements: {}; {}",
                    off.join(" or "),
                    Outlier::REPLACED
                ));
                let resolution = Some(Outlier::REPLACED.to_owned());
                estimate.outliers.push(Outlier { resolution, ..outlier });
            }
        }
    }
}

impl Method for OutlierRepeater {
    fn settings(&self) -> serde_json::Value {
        self.method.settings()
    }

    fn next_stage(
        &self,
        plan: &Plan,
        done: &[Stage],
        source: ObjectPositionSource<'_>,
    ) -> Result<NextStage, MethodRefusal> {
        let ObjectPositionSource::Measured(readings) = source else {
            return self.method.next_stage(plan, done, source);
        };
        let ordinary: Vec<Stage> = done.iter().filter(|stage| !is_outlier_repeat(stage.repeat)).cloned().collect();
        let last = readings_of_latest_repeats(readings, u32::MAX);
        match self.method.next_stage(plan, &ordinary, ObjectPositionSource::Measured(&last))? {
            NextStage::NoFurtherStage => Ok(match self.outlier_repeat_stage(plan, done, readings) {
                Some(stage) => NextStage::Stage { stage, new_steps: Vec::new() },
                None => NextStage::NoFurtherStage,
            }),
            next => Ok(next),
        }
    }

    fn required_sensors<'a>(&self, sensors: &'a [Sensor]) -> Result<Vec<&'a Sensor>, MethodRefusal> {
        self.method.required_sensors(sensors)
    }

    fn accepts_probe_map(&self) -> bool {
        self.method.accepts_probe_map()
    }

    fn check_priors(&self, plan: &Plan) -> Result<(), MethodRefusal> {
        self.method.check_priors(plan)
    }

    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, MethodRefusal> {
        self.method.forecast(plan, machine_s)
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        let mut estimate = self.method.identify(plan, &readings_of_latest_repeats(readings, u32::MAX))?;
        if readings.iter().any(|reading| is_outlier_repeat(reading.repeat)) {
            self.add_repeated_outliers(plan, readings, &mut estimate);
        }
        Ok(estimate)
    }
}
