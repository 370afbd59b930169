//! One scan: from point to point, and at each of them samples while the machine stands; or all the way,
//! where the control stamps positions.

use tokio::sync::mpsc;

use super::stands::unrounded;
use super::sweep::{self, Placed};
use super::{Run, RunError};
use crate::setup::Mounted;
use devices::controllers::ControllerError;
use devices::sensors::{Sample, SensorError};
use machine::Position;
use machine::record::event::Event;
use machine::record::motion::Outcome;
use machine::record::plan::{Sampling, Scan, Step};
use machine::record::reading::{Flag, Reading};
use planning::proof::ProvenBlock;
use planning::{blocks_out_of_range, end_of};

/// Samples of one scan in motion that are kept: a quarter of an hour at 1 kHz.
const MOST_SAMPLES: usize = 1_000_000;

/// A distance, or out of range, as on the way to the first point.
fn is_alive(sample: &Sample) -> bool {
    !matches!(sample.flag, Flag::Saturated | Flag::Stale)
}

fn is_out_of_range(sample: &Sample) -> bool {
    sample.flag == Flag::Range
}

fn in_sight(sample: &Sample) -> bool {
    matches!(sample.flag, Flag::None | Flag::Gap)
}

/// What has come by now.
fn taken(mut told: mpsc::Receiver<Sample>) -> Vec<Sample> {
    std::iter::from_fn(|| told.try_recv().ok()).collect()
}

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

    /// Known before anything moves: a scan in motion needs a control that stamps positions.
    pub(super) fn can_sweep(&self, steps: &[Step]) -> Result<(), RunError> {
        let in_motion = |step: &&Step| {
            let sampling = step.scan.as_ref().map(|scan| scan.sampling);
            matches!(sampling, Some(Sampling::Continuous { .. }))
        };
        match steps.iter().find(in_motion) {
            Some(step) if !self.devices.controller.stamps() => {
                Err(RunError::NotStamped { step: step.id })
            }
            _ => Ok(()),
        }
    }

    fn sensor(&self, step: &Step) -> Result<&Mounted, RunError> {
        let named = self.looking.iter().find(|sensor| sensor.name() == step.sensor());
        named.ok_or_else(|| faulty(step)(SensorError::Unknown { name: step.sensor().to_owned() }))
    }

    /// The blocks of a scan; every sample that was taken along it.
    pub(super) async fn scan(
        &mut self,
        (step, scan): (&Step, &Scan),
        repeat: u32,
        mut blocks: Vec<ProvenBlock>,
    ) -> Result<Vec<Reading>, RunError> {
        let rest = blocks.split_off(blocks_out_of_range(scan, blocks.len()));
        self.out_of_range(step, blocks).await?;
        let blocks = rest;
        match scan.sampling {
            Sampling::Dwell { samples, .. } => self.dwells(step, repeat, samples, blocks).await,
            Sampling::Continuous { rate_hz } => {
                self.sweep((step, scan), repeat, rate_hz, blocks).await
            }
        }
    }

    /// Until a scan has confirmed where the machine stands: up from where it stands, then to where nothing
    /// declared is within the range of the sensor. A distance on that last way, or at its end, is that
    /// of a body that is not where it is stated, and holds the machine.
    async fn out_of_range(
        &mut self,
        step: &Step,
        blocks: Vec<ProvenBlock>,
    ) -> Result<(), RunError> {
        let count = blocks.len();
        for (number, block) in (1..).zip(blocks) {
            let good = if number == count { is_out_of_range } else { is_alive };
            self.watched(step, block, good).await?;
        }
        if count > 0 {
            // A simulated sensor without a wire is not watched: it reports only when it is polled.
            let taken = self.sensor(step)?.take(1).await.map_err(faulty(step));
            let seen =
                taken.and_then(|samples| match samples.iter().find(|s| !is_out_of_range(s)) {
                    Some(sample) => Err(self.blind(step, Some(sample))),
                    None => Ok(()),
                });
            return seen.inspect_err(|_| self.devices.controller.halt().now());
        }
        Ok(())
    }

    /// A block for each point, and `count` samples at each of them.
    async fn dwells(
        &mut self,
        step: &Step,
        repeat: u32,
        count: u32,
        blocks: Vec<ProvenBlock>,
    ) -> Result<Vec<Reading>, RunError> {
        let mut readings = Vec::new();
        let first = step.scan.as_ref().and_then(|scan| scan.path.first());
        let mut commanded = first.cloned().unwrap_or_default();
        for (number, block) in blocks.into_iter().enumerate() {
            let good = if number == 0 { is_alive } else { in_sight };
            commanded = end_of(block.motions(), &commanded);
            let outcome = self.watched(step, block, good).await?;
            let own_s = outcome.t_s.unwrap_or_else(|| self.devices.clock.now_s());
            let stands = self.devices.controller.look().await?.stands;
            let stands = unrounded(&stands, &commanded);
            let samples = self.seen(step, count).await?;
            readings.extend(self.at_point(step, repeat, (own_s, &stands), &samples));
        }
        Ok(readings)
    }

    /// As long as the machine moves all that the sensor says is `good`: otherwise the machine is held.
    async fn watched(
        &self,
        step: &Step,
        block: ProvenBlock,
        good: impl Fn(&Sample) -> bool + Send + 'static,
    ) -> Result<Outcome, RunError> {
        let (sensor, halt) = (self.sensor(step)?, self.devices.controller.halt());
        let watched = sensor.watch(good, move || halt.now()).await.map_err(faulty(step));
        watched.inspect_err(|_| self.devices.controller.halt().now())?;
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

    /// The error for a sample with an unexpected flag or distance.
    fn blind(&self, step: &Step, seen: Option<&Sample>) -> RunError {
        if let Some(value_mm) = seen.and_then(|sample| sample.value_mm) {
            let sensor = step.sensor().to_owned();
            return RunError::EarlyDistance { step: step.id, sensor, value_mm };
        }
        let flag = seen.map_or(Flag::Stale, |sample| sample.flag);
        RunError::Blind { step: step.id, sensor: step.sensor().to_owned(), flag }
    }

    /// All samples of the way from the first point to the last, each where its own time says.
    async fn sweep(
        &mut self,
        (step, scan): (&Step, &Scan),
        repeat: u32,
        rate_hz: f64,
        mut blocks: Vec<ProvenBlock>,
    ) -> Result<Vec<Reading>, RunError> {
        let unswept = |why: &str| RunError::Unswept { step: step.id, why: why.to_owned() };
        let Some(sweep) = blocks.pop() else { return Err(unswept("it has no motion")) };
        for way in blocks {
            self.watched(step, way, is_alive).await?;
        }
        let (tell, told) = mpsc::channel(MOST_SAMPLES);
        let keep = move |sample: &Sample| in_sight(sample) && tell.try_send(*sample).is_ok();
        let outcome = self.watched(step, sweep, keep).await;
        let samples = taken(told);
        let outcome = match outcome {
            Err(RunError::EarlyDistance { .. }) if samples.len() == MOST_SAMPLES => {
                return Err(unswept("the sensor said more on the way than is kept"));
            }
            outcome => outcome?,
        };
        let Some(track) = outcome.track else { return Err(RunError::NotStamped { step: step.id }) };
        if let Some(why) = sweep::unstamped(&track, &scan.path) {
            return Err(unswept(&why));
        }
        let placed = sweep::placed(&samples, &track, rate_hz);
        if placed.samples.is_empty() {
            return Err(unswept(if samples.is_empty() {
                "the sensor said nothing on the way; a simulated one behind no wire speaks only when it is asked"
            } else {
                "no sample was taken at a time at which the control says where the axes stood"
            }));
        }
        self.tell_of(step, &placed, track.gaps()).await?;
        Ok(self.along(step, repeat, placed))
    }

    /// What was left out is told, not passed over.
    async fn tell_of(&mut self, step: &Step, placed: &Placed, gaps: usize) -> Result<(), RunError> {
        let Placed { samples, nowhere, thinned } = placed;
        let (label, all) = (&step.label, samples.len() + nowhere + thinned);
        let by_gaps = format!(
            "{label}: {nowhere} of {all} samples are left out: in {gaps} places the control's positions \
             have a gap"
        );
        let by_rate = format!(
            "{label}: {thinned} of {all} samples are left out: the sensor is faster than rate_hz of the plan"
        );
        for (count, text) in [(nowhere, by_gaps), (thinned, by_rate)] {
            if *count > 0 {
                self.note(Event::Announced { text }).await?;
            }
        }
        Ok(())
    }

    fn along(&mut self, step: &Step, repeat: u32, placed: Placed) -> Vec<Reading> {
        let now_s = self.devices.clock.now_s();
        let shift_s = self.timeline.at(now_s) - now_s;
        let reading = |(sample, position): (Sample, Position)| Reading {
            step: step.id,
            repeat,
            position,
            value_mm: sample.value_mm,
            sensor: step.sensor().to_owned(),
            t_s: sample.t_s + shift_s,
            flag: sample.flag,
            temperatures_c: Default::default(),
        };
        placed.samples.into_iter().map(reading).collect()
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
            sensor: step.sensor().to_owned(),
            t_s: began + (sample.t_s - first),
            flag: sample.flag,
            temperatures_c: Default::default(),
        };
        samples.iter().map(reading).collect()
    }
}

/// What the sensor that `step` looks with has met.
fn faulty(step: &Step) -> impl Fn(SensorError) -> RunError {
    let name = step.sensor().to_owned();
    move |source| RunError::Sensor { name: name.clone(), source }
}
