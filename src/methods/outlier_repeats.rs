//! Outliers are measured again after the last stage, each step at most twice. The last measurement counts:
//! the wrapped method gets it in place of the first.

use std::borrow::Cow;

use super::{IdentifyError, Method, Next, Refused, Source};
use machine::record::estimate::{Estimate, Outlier};
use machine::record::plan::{Plan, REPEAT_AFTER_STOP, REPEAT_OF_SUSPECTS, Stage, Step, StepKind};
use machine::record::reading::Reading;
use machine::record::sensor::Sensor;

/// Maximum number of repeated measurements of one step.
const MAX_REPEATS: usize = 2;

pub(super) struct OutlierRepeater {
    pub method: Box<dyn Method>,
    /// The same method with the minimum number of Monte Carlo trials.
    pub quick: Box<dyn Method>,
}

fn is_outlier_repeat(repeat: u32) -> bool {
    (REPEAT_OF_SUSPECTS..REPEAT_AFTER_STOP).contains(&repeat)
}

/// Readings with only the last of the repeats below `before` of each step that was measured again; it
/// replaces the earlier ones.
fn latest_repeats(readings: &[Reading], before: u32) -> Cow<'_, [Reading]> {
    if !readings.iter().any(|reading| is_outlier_repeat(reading.repeat)) {
        return Cow::Borrowed(readings);
    }
    let counts = |reading: &&Reading| !is_outlier_repeat(reading.repeat) || reading.repeat < before;
    let last = |step: u32| {
        let repeat_stage =
            readings.iter().filter(counts).filter(|reading| is_outlier_repeat(reading.repeat));
        repeat_stage.filter(|reading| reading.step == step).map(|reading| reading.repeat).max()
    };
    let stays = |reading: &&Reading| match last(reading.step) {
        Some(last) => reading.repeat == last || reading.repeat >= REPEAT_AFTER_STOP,
        None => true,
    };
    let placed = |reading: &Reading| match is_outlier_repeat(reading.repeat) {
        true => Reading { repeat: 0, ..reading.clone() },
        false => reading.clone(),
    };
    readings.iter().filter(counts).filter(stays).map(placed).collect::<Vec<_>>().into()
}

/// Whether the step is part of the measurement `label`, or is that measurement.
fn belongs(step: &Step, label: &str) -> bool {
    let rest = step.label.strip_prefix(label);
    step.kind != StepKind::Prompt
        && rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

fn of_outlier<'p>(plan: &'p Plan, outlier: &Outlier) -> impl Iterator<Item = &'p Step> {
    let labels: Vec<String> = outlier.candidates.iter().map(|one| one.label.clone()).collect();
    plan.steps.iter().filter(move |step| labels.iter().any(|label| belongs(step, label)))
}

impl OutlierRepeater {
    /// The stage that repeats the suspects of the earliest stage that has any. They are of one stage because
    /// the proof of a repeated stage uses what was known when that stage was planned.
    fn repeat_stage(&self, plan: &Plan, done: &[Stage], readings: &[Reading]) -> Option<Stage> {
        // An error is reported when the run is identified.
        let estimate = self.quick.identify(plan, &latest_repeats(readings, u32::MAX)).ok()?;
        let times = |step: &Step| {
            let repeat_stage = done.iter().filter(|stage| is_outlier_repeat(stage.repeat));
            repeat_stage.filter(|stage| stage.steps.contains(&step.id)).count()
        };
        let suspects = estimate.outliers.iter().flat_map(|outlier| of_outlier(plan, outlier));
        let suspects: Vec<&Step> = suspects.filter(|step| times(step) < MAX_REPEATS).collect();
        let is_suspect = |id: &u32| suspects.iter().any(|step| step.id == *id);
        let first = done.iter().find(|stage| stage.steps.iter().any(is_suspect))?;
        let rounds = done.iter().filter(|stage| is_outlier_repeat(stage.repeat)).count() as u32;
        Some(Stage {
            id: done.last().map_or(0, |stage| stage.id + 1),
            name: "suspects measured again".to_owned(),
            repeat: REPEAT_OF_SUSPECTS + rounds,
            steps: first.steps.iter().copied().filter(is_suspect).collect(),
            found: first.found.clone(),
        })
    }

    /// Adds the outliers that were measured again to the estimate, as they were found before each round.
    /// Measurements that are still outliers come first.
    fn list(&self, plan: &Plan, readings: &[Reading], estimate: &mut Estimate) {
        let mut rounds: Vec<u32> = readings.iter().map(|reading| reading.repeat).collect();
        rounds.retain(|repeat| is_outlier_repeat(*repeat));
        rounds.sort_unstable();
        rounds.dedup();
        let is_measured = |outlier: &Outlier| {
            let steps = of_outlier(plan, outlier).map(|step| step.id);
            let mut repeat_stage =
                readings.iter().filter(|reading| is_outlier_repeat(reading.repeat));
            steps.into_iter().any(|id| repeat_stage.any(|reading| reading.step == id))
        };
        for outlier in estimate.outliers.iter_mut().filter(|outlier| is_measured(outlier)) {
            outlier.resolution = Some("measured again: it is off still".to_owned());
        }
        for before in rounds {
            let Ok(earlier) = self.quick.identify(plan, &latest_repeats(readings, before)) else {
                continue;
            };
            for outlier in earlier.outliers {
                let labels = |outlier: &Outlier| -> Vec<String> {
                    outlier.candidates.iter().map(|one| one.label.clone()).collect()
                };
                if estimate.outliers.iter().any(|known| labels(known) == labels(&outlier)) {
                    continue;
                }
                let resolution = "measured again: the last measurement counts";
                let off = outlier.candidates.iter();
                let off = off.map(|one| format!("{} by {:.1} µm", one.label, one.deviation_um));
                let off: Vec<String> = off.collect();
                estimate.warnings.push(format!(
                    "was off what all others make expected: {}; {resolution}",
                    off.join(" or ")
                ));
                let resolution = Some(resolution.to_owned());
                estimate.outliers.push(Outlier { resolution, ..outlier });
            }
        }
    }
}

impl Method for OutlierRepeater {
    fn settings(&self) -> serde_json::Value {
        self.method.settings()
    }

    fn next(&self, plan: &Plan, done: &[Stage], source: Source<'_>) -> Result<Next, Refused> {
        let Source::Measured(readings) = source else {
            return self.method.next(plan, done, source);
        };
        let ordinary: Vec<Stage> =
            done.iter().filter(|stage| !is_outlier_repeat(stage.repeat)).cloned().collect();
        let last = latest_repeats(readings, u32::MAX);
        match self.method.next(plan, &ordinary, Source::Measured(&last))? {
            Next::Done => Ok(match self.repeat_stage(plan, done, readings) {
                Some(stage) => Next::Stage { stage, new_steps: Vec::new() },
                None => Next::Done,
            }),
            next => Ok(next),
        }
    }

    fn required_sensors<'a>(&self, sensors: &'a [Sensor]) -> Result<Vec<&'a Sensor>, Refused> {
        self.method.required_sensors(sensors)
    }

    fn takes_probe_map(&self) -> bool {
        self.method.takes_probe_map()
    }

    fn check_priors(&self, plan: &Plan) -> Result<(), Refused> {
        self.method.check_priors(plan)
    }

    fn forecast(&self, plan: &Plan, machine_s: f64) -> Result<Vec<String>, Refused> {
        self.method.forecast(plan, machine_s)
    }

    fn identify(&self, plan: &Plan, readings: &[Reading]) -> Result<Estimate, IdentifyError> {
        let mut estimate = self.method.identify(plan, &latest_repeats(readings, u32::MAX))?;
        if readings.iter().any(|reading| is_outlier_repeat(reading.repeat)) {
            self.list(plan, readings, &mut estimate);
        }
        Ok(estimate)
    }
}
