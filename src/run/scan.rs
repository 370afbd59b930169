//! One scan: from point to point, and at each of them samples while the machine stands.

use super::{Run, RunError};
use crate::base::Position;
use crate::controllers::ControllerError;
use crate::record::event::Event;
use crate::record::motion::{Block, Outcome};
use crate::record::plan::{Sampling, Scan, Step};
use crate::record::reading::{Flag, Reading};
use crate::sensors::{Sample, SensorError};
use crate::setup::Mounted;

impl Run<'_> {
    /// The sensors that the plan looks with live and say something, before anything moves.
    pub(super) async fn sensors_live(&mut self) -> Result<(), RunError> {
        self.looking.clear();
        for wanted in self.plan.sensors.clone() {
            let fault = |source| RunError::Sensor { name: wanted.name.clone(), source };
            let sensor = self.devices.sensors.open(&wanted.name).await.map_err(fault)?;
            let prepared = sensor.prepare().await.map_err(fault)?;
            self.looking.push(sensor);
            let text = format!("{}: {}", wanted.name, prepared.identity);
            self.note(Event::Announced { text }).await?;
        }
        self.probe_lives = true;
        Ok(())
    }

    fn sensor(&self, step: &Step) -> Result<&Mounted, RunError> {
        let named = self.looking.iter().find(|sensor| sensor.name() == step.sensor);
        named.ok_or_else(|| faulty(step)(SensorError::Unknown { name: step.sensor.clone() }))
    }

    /// The blocks of a scan, one for each of its points; every sample that was taken there.
    pub(super) async fn scan(
        &mut self,
        (step, scan): (&Step, &Scan),
        repeat: u32,
        blocks: Vec<Block>,
    ) -> Result<Vec<Reading>, RunError> {
        let Sampling::Dwell { samples: count, .. } = scan.sampling else {
            return Err(RunError::NotStamped { step: step.id });
        };
        let mut readings = Vec::new();
        for (number, block) in blocks.into_iter().enumerate() {
            // On its way to the first point the sensor comes from afar, where it sees nothing; it says so.
            let good: fn(&Sample) -> bool = match number {
                0 => |sample| !matches!(sample.flag, Flag::Saturated | Flag::Stale),
                _ => |sample| matches!(sample.flag, Flag::None | Flag::Gap),
            };
            let outcome = self.watched(step, block, good).await?;
            let own_s = outcome.t_s.unwrap_or_else(|| self.devices.clock.now_s());
            let stands = self.devices.controller.look().await?.stands;
            let samples = self.seen(step, count).await?;
            readings.extend(self.at_point(step, repeat, (own_s, &stands), &samples));
        }
        Ok(readings)
    }

    /// As long as the machine moves all that the sensor says is `good`: otherwise the machine is held.
    async fn watched(
        &self,
        step: &Step,
        block: Block,
        good: fn(&Sample) -> bool,
    ) -> Result<Outcome, RunError> {
        let (sensor, halt) = (self.sensor(step)?, self.devices.controller.halt());
        sensor.watch(good, move || halt.now()).await.map_err(faulty(step))?;
        let executed = self.devices.controller.execute(block).await;
        let watched = sensor.rest().await;
        match executed {
            // What the control says of itself comes first, but for the hold that the sensor has asked for.
            Err(error) if !matches!(error, ControllerError::Halted) => Err(error.into()),
            executed => match watched.map_err(faulty(step))? {
                Some(sample) => Err(self.blind(step, Some(&sample))),
                None => Ok(executed?),
            },
        }
    }

    /// `count` samples from where the machine stands. It stays there if the sensor fails.
    async fn seen(&self, step: &Step, count: u32) -> Result<Vec<Sample>, RunError> {
        let taken = self.sensor(step)?.take(count).await.map_err(faulty(step));
        let seen = taken.and_then(|samples| match samples.iter().find(|s| s.value_mm.is_some()) {
            _ if samples.len() < count as usize => Err(self.blind(step, samples.last())),
            None => Err(self.blind(step, samples.first())),
            Some(_) => Ok(samples),
        });
        seen.inspect_err(|_| self.devices.controller.halt().now())
    }

    fn blind(&self, step: &Step, seen: Option<&Sample>) -> RunError {
        let flag = seen.map_or(Flag::Stale, |sample| sample.flag);
        RunError::Blind { step: step.id, sensor: step.sensor.clone(), flag }
    }

    /// The axes stood still all the while; the samples lie in time as the sensor's clock says.
    fn at_point(
        &mut self,
        step: &Step,
        repeat: u32,
        (own_s, stands): (f64, &Position),
        samples: &[Sample],
    ) -> Vec<Reading> {
        let began = self.timeline.at(own_s);
        let first = samples.first().map_or(0.0, |sample| sample.t_s);
        let reading = |sample: &Sample| Reading {
            step: step.id,
            repeat,
            position: stands.clone(),
            value_mm: sample.value_mm,
            sensor: step.sensor.clone(),
            t_s: began + (sample.t_s - first),
            flag: sample.flag,
            temperatures_c: Default::default(),
        };
        samples.iter().map(reading).collect()
    }
}

/// What the sensor that `step` looks with has met.
fn faulty(step: &Step) -> impl Fn(SensorError) -> RunError {
    let name = step.sensor.clone();
    move |source| RunError::Sensor { name: name.clone(), source }
}
