//! Sensors of a run. They are opened before any motion and watched during motion. A sample that is not accepted
//! holds the machine.

use std::cell::Cell;

use futures_util::future::try_join_all;

use super::{Run, RunError};
use crate::setup::OpenSensor;
use devices::controllers::ControllerError;
use devices::sensors::{Sample, SensorError};
use machine::record::event::RunEvent;
use machine::record::motion::MotionBlockOutcome;
use machine::record::plan::Step;
use machine::record::reading::ReadingFlag;
use machine::record::sensor::SensorMount;
use planning::proof::ProvenBlock;

/// Whether a sample allows the motion to continue.
pub(super) type SampleCondition = Box<dyn Fn(&Sample) -> bool + Send>;

/// Rejects saturated and stale samples only: an out-of-range sample is accepted, as on the path to the first point.
pub(super) fn has_signal(sample: &Sample) -> bool {
    !matches!(sample.flag, ReadingFlag::Saturated | ReadingFlag::Stale)
}

/// Whether the sensor works and reports no distance: no surface is within its range, or there is no echo (flag
/// `Range`).
pub(super) fn is_out_of_range(sample: &Sample) -> bool {
    sample.flag == ReadingFlag::Range
}

/// Whether the sample is a valid distance, also if samples before it are missing (flag `Gap`).
pub(super) fn is_distance(sample: &Sample) -> bool {
    matches!(sample.flag, ReadingFlag::None | ReadingFlag::Gap)
}

/// Share of the range, at each of its ends, where noise may make a distance appear and disappear.
const RANGE_EDGE_SHARE: f64 = 0.1;

/// Condition while a ball enters the range of a sensor: any sample but a saturated or stale one until a distance is
/// in the inner 80 % of the range, afterwards distances alone.
pub(super) fn range_entry_condition(range_mm: [f64; 2]) -> SampleCondition {
    let [least, greatest] = range_mm;
    let edge = RANGE_EDGE_SHARE * (greatest - least);
    let inner = least + edge..=greatest - edge;
    let has_entered = Cell::new(false);
    Box::new(move |sample| {
        let is_inside = sample.value_mm.is_some_and(|value| inner.contains(&value));
        has_entered.set(has_entered.get() || (is_distance(sample) && is_inside));
        if has_entered.get() { is_distance(sample) } else { has_signal(sample) }
    })
}

impl Run<'_> {
    /// Opens the sensors of the plan and checks, before any motion, that they respond. Their identities are recorded
    /// as events of the run. The sensors replace the probe, so the check of the probe counts as done.
    pub(super) async fn open_plan_sensors(&mut self) -> Result<(), RunError> {
        self.open_sensors.clear();
        for wanted in self.plan.sensors.clone() {
            let fault = sensor_error(&wanted.name);
            let sensor = self.devices.sensor_opener.open(&wanted.name).await.map_err(&fault)?;
            let prepared = sensor.prepare().await.map_err(&fault)?;
            self.open_sensors.push(sensor);
            let text = format!("{}: {}", wanted.name, prepared.identity);
            self.record_event(RunEvent::OperatorMessage { text }).await?;
        }
        self.is_probe_confirmed = true;
        Ok(())
    }

    /// Sensors of `step` on one of `mounts`, in the order of the plan.
    pub(super) fn step_sensors_on(&self, step: &Step, mounts: &[SensorMount]) -> Vec<machine::record::sensor::Sensor> {
        let sensors = self.plan.sensors.iter();
        let wanted = sensors.filter(|s| mounts.contains(&s.mount) && step.sensors.contains(&s.name));
        wanted.cloned().collect()
    }

    /// Conditions for the sensors of `step` during the motion to the first point, in the order of `step.sensors`. A
    /// sensor on the table measures the ball in the spindle, which is between the sensors during the whole motion
    /// (`is_ball_in_nest`) or enters their range. Other sensors must only satisfy `has_signal`.
    pub(super) fn range_entry_conditions(&self, step: &Step, is_ball_in_nest: bool) -> Vec<SampleCondition> {
        let on_table = self.step_sensors_on(step, &[SensorMount::Table]);
        let condition = |name: &String| match on_table.iter().find(|sensor| sensor.name == *name) {
            None => Box::new(has_signal) as SampleCondition,
            Some(_) if is_ball_in_nest => Box::new(is_distance),
            Some(sensor) => range_entry_condition(sensor.range_mm),
        };
        step.sensors.iter().map(condition).collect()
    }

    pub(super) fn find_open_sensor(&self, name: &str) -> Result<&OpenSensor, RunError> {
        let named = self.open_sensors.iter().find(|sensor| sensor.name() == name);
        named.ok_or_else(|| sensor_error(name)(SensorError::UnknownSensor { name: name.to_owned() }))
    }

    /// Open sensors of `step`, in the order of `step.sensors`.
    fn step_sensors(&self, step: &Step) -> Result<Vec<&OpenSensor>, RunError> {
        step.sensors.iter().map(|name| self.find_open_sensor(name)).collect()
    }

    /// Executes `block`. The machine is held as soon as a sensor of `step` reports a sample that its entry of
    /// `sample_conditions` rejects; the result is then an error, also if the block was completed.
    pub(super) async fn execute_with_hold_on_rejection(
        &self,
        step: &Step,
        block: ProvenBlock,
        sample_conditions: Vec<SampleCondition>,
    ) -> Result<MotionBlockOutcome, RunError> {
        self.begin_watch(step, sample_conditions).await?;
        let executed = self.devices.open_controller.execute(block).await;
        self.end_watch(step, executed).await
    }

    /// Starts watching the sensors of `step`, until [`Run::end_watch`]; `sample_conditions` has the order of
    /// `step.sensors`. A simulated sensor that measures only when it is read is not watched.
    pub(super) async fn begin_watch(
        &self,
        step: &Step,
        sample_conditions: Vec<SampleCondition>,
    ) -> Result<(), RunError> {
        for (sensor, condition) in self.step_sensors(step)?.iter().zip(sample_conditions) {
            let halt = self.devices.open_controller.halt_handle();
            let watched = sensor.watch(condition, move || halt.trigger()).await;
            let watched = watched.map_err(sensor_error(sensor.name()));
            watched.inspect_err(|_| self.devices.open_controller.halt_handle().trigger())?;
        }
        Ok(())
    }

    /// Ends the watch. Returns the outcome of the executed block if each sensor reported accepted samples only.
    pub(super) async fn end_watch(
        &self,
        step: &Step,
        execution_result: Result<MotionBlockOutcome, ControllerError>,
    ) -> Result<MotionBlockOutcome, RunError> {
        let mut accepted = Ok(());
        for sensor in self.step_sensors(step)? {
            accepted = accepted.and(end_sensor_watch(step, sensor).await);
        }
        match execution_result {
            // An error of the control is returned first, except a halt, which a rejected sample may have requested.
            Err(error) if !matches!(error, ControllerError::Halted) => Err(error.into()),
            executed => accepted.and(executed.map_err(RunError::from)),
        }
    }

    /// Takes one sample of a sensor, which must satisfy `expected`. Otherwise, or if the sensor fails, the machine is
    /// held.
    pub(super) async fn check_sample(
        &self,
        step: &Step,
        name: &str,
        expected: fn(&Sample) -> bool,
    ) -> Result<(), RunError> {
        let taken = self.find_open_sensor(name)?.read_samples(1).await.map_err(sensor_error(name));
        let seen = taken.and_then(|samples| match samples.iter().find(|s| !expected(s)) {
            Some(sample) => Err(sample_error(step, name, Some(sample))),
            None => Ok(()),
        });
        seen.inspect_err(|_| self.devices.open_controller.halt_handle().trigger())
    }

    /// Takes `count` samples of each sensor of `step` at the same time, with the machine at rest; one list for each
    /// sensor, in the order of `step.sensors`. The machine is held if a sensor fails, sends fewer samples or none
    /// with a distance.
    pub(super) async fn take_samples_at_rest(&self, step: &Step, count: u32) -> Result<Vec<Vec<Sample>>, RunError> {
        let sensors = self.step_sensors(step)?;
        let taken = try_join_all(sensors.iter().map(|sensor| take_samples(step, sensor, count))).await;
        taken.inspect_err(|_| self.devices.open_controller.halt_handle().trigger())
    }
}

/// Ends the watch of one sensor; an error if a sample was rejected.
async fn end_sensor_watch(step: &Step, sensor: &OpenSensor) -> Result<(), RunError> {
    match sensor.end_watch().await.map_err(sensor_error(sensor.name()))? {
        Some(sample) => Err(sample_error(step, sensor.name(), Some(&sample))),
        None => Ok(()),
    }
}

/// Takes `count` samples; an error if the sensor sends fewer, or if none of them is a distance.
async fn take_samples(step: &Step, sensor: &OpenSensor, count: u32) -> Result<Vec<Sample>, RunError> {
    let name = sensor.name();
    let samples = sensor.read_samples(count).await.map_err(sensor_error(name))?;
    match samples.iter().find(|sample| sample.value_mm.is_some()) {
        _ if samples.len() < count as usize => Err(sample_error(step, name, samples.last())),
        None => Err(sample_error(step, name, samples.first())),
        Some(_) => Ok(samples),
    }
}

/// Error for a rejected or missing sample: `UnexpectedBodyInRange` if it has a distance, otherwise `NoValidSample`.
fn sample_error(step: &Step, sensor: &str, sample: Option<&Sample>) -> RunError {
    let (step, sensor) = (step.id, sensor.to_owned());
    if let Some(value_mm) = sample.and_then(|sample| sample.value_mm) {
        return RunError::UnexpectedBodyInRange { step, sensor, value_mm };
    }
    RunError::NoValidSample { step, sensor, flag: sample.map_or(ReadingFlag::Stale, |sample| sample.flag) }
}

fn sensor_error(name: &str) -> impl Fn(SensorError) -> RunError {
    let name = name.to_owned();
    move |source| RunError::Sensor { name: name.clone(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(value_mm: Option<f64>, flag: ReadingFlag) -> Sample {
        Sample { received_s: 0.0, value_mm, flag, lost_before_count: 0, encoder_count: None }
    }

    fn distance(mm: f64) -> Sample {
        sample(Some(mm), ReadingFlag::None)
    }

    #[test]
    fn ball_can_enter_the_range_of_a_sensor_but_not_leave_it() {
        let out_of_range = sample(None, ReadingFlag::Range);
        let condition = range_entry_condition([-1.0, 1.0]);
        // At the far end of the range noise makes the distance appear and disappear.
        for entering in [out_of_range, distance(0.99), out_of_range, distance(0.7), distance(-0.9)] {
            assert!(condition(&entering), "{entering:?}");
        }
        assert!(!condition(&out_of_range));
        let condition = range_entry_condition([-1.0, 1.0]);
        assert!(!condition(&sample(None, ReadingFlag::Stale)) && !condition(&sample(None, ReadingFlag::Saturated)));
    }
}
