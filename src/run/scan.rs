//! One scan: from point to point, and at each of them samples while the machine stands; or all the way,
//! where the control stamps positions.

use tokio::sync::mpsc;

use super::equal_angles;
use super::stands::unrounded;
use super::sweep::{self, Placed};
use super::watched_sensors::{Accepts, is_alive, is_distance, is_out_of_range};
use super::{Run, RunError};
use devices::sensors::Sample;
use machine::Position;
use machine::record::event::Event;
use machine::record::plan::{Sampling, Scan, Step};
use machine::record::reading::Reading;
use machine::record::sensor::Mount;
use planning::proof::ProvenBlock;
use planning::{blocks_out_of_range, end_of};

/// Samples of one sensor that are kept of one scan in motion: a quarter of an hour at 1 kHz.
const MAX_SAMPLES: usize = 1_000_000;

/// A sample of a sensor, and where the machine stood.
struct Sampled<'a> {
    sensor: &'a str,
    sample: Sample,
    t_s: f64,
    position: Position,
}

impl Run<'_> {
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

    /// The blocks of a scan; every sample that was taken along it.
    pub(super) async fn scan(
        &mut self,
        (step, scan): (&Step, &Scan),
        repeat: u32,
        mut blocks: Vec<ProvenBlock>,
    ) -> Result<Vec<Reading>, RunError> {
        let rest = blocks.split_off(blocks_out_of_range(scan, blocks.len()));
        let in_nest = blocks.is_empty();
        self.out_of_range(step, blocks).await?;
        if in_nest {
            for sensor in self.sensors_on(step, &[Mount::Table]) {
                self.reports(step, &sensor.name, is_distance).await?;
            }
        }
        match scan.sampling {
            Sampling::Dwell { samples, .. } => {
                self.dwells(step, repeat, samples, rest, in_nest).await
            }
            Sampling::Continuous { rate_hz, per_revolution } => {
                // The filter to equal angles takes all samples.
                let most_hz = if per_revolution.is_some() { f64::INFINITY } else { rate_hz };
                self.sweep((step, scan), repeat, most_hz, rest, in_nest).await
            }
        }
    }

    /// Until a scan has confirmed where the machine stands: up from where it stands, then to where nothing
    /// declared is within the range of a sensor in the spindle, nor the ball within that of one on the table. A
    /// distance on that last way, or at its end, is that of a body that is not where it is stated, and holds
    /// the machine.
    async fn out_of_range(
        &mut self,
        step: &Step,
        blocks: Vec<ProvenBlock>,
    ) -> Result<(), RunError> {
        let moving = self.sensors_on(step, &[Mount::Spindle, Mount::Table]);
        let moving: Vec<String> = moving.into_iter().map(|sensor| sensor.name).collect();
        let accepts = |name: &String, is_last: bool| -> Accepts {
            Box::new(if is_last && moving.contains(name) { is_out_of_range } else { is_alive })
        };
        let count = blocks.len();
        for (number, block) in (1..).zip(blocks) {
            let all = step.sensors.iter().map(|name| accepts(name, number == count)).collect();
            self.watched(step, block, all).await?;
        }
        if count > 0 {
            // A simulated sensor without a wire is not watched: it reports only when it is polled.
            for name in &moving {
                self.reports(step, name, is_out_of_range).await?;
            }
        }
        Ok(())
    }

    /// A block for each point, and `count` samples of each sensor at each of them.
    async fn dwells(
        &mut self,
        step: &Step,
        repeat: u32,
        count: u32,
        blocks: Vec<ProvenBlock>,
        in_nest: bool,
    ) -> Result<Vec<Reading>, RunError> {
        let mut readings = Vec::new();
        let first = step.scan.as_ref().and_then(|scan| scan.path.first());
        let mut commanded = first.cloned().unwrap_or_default();
        for (number, block) in blocks.into_iter().enumerate() {
            let accepts = match number {
                0 => self.accepted_on_entry(step, in_nest),
                _ => step.sensors.iter().map(|_| Box::new(is_distance) as Accepts).collect(),
            };
            commanded = end_of(block.motions(), &commanded);
            let outcome = self.watched(step, block, accepts).await?;
            let own_s = outcome.t_s.unwrap_or_else(|| self.devices.clock.now_s());
            let stands = self.devices.controller.look().await?.stands;
            let stands = unrounded(&stands, &commanded);
            let samples = self.samples_at_rest(step, count).await?;
            readings.extend(self.at_point(step, repeat, (own_s, &stands), &samples));
        }
        Ok(readings)
    }

    /// All samples of the way from the first point to the last, each where its own time says.
    async fn sweep(
        &mut self,
        (step, scan): (&Step, &Scan),
        repeat: u32,
        most_hz: f64,
        mut blocks: Vec<ProvenBlock>,
        in_nest: bool,
    ) -> Result<Vec<Reading>, RunError> {
        let unswept = |why: &str| RunError::Unswept { step: step.id, why: why.to_owned() };
        let Some(sweep) = blocks.pop() else { return Err(unswept("it has no motion")) };
        for way in blocks {
            self.watched(step, way, self.accepted_on_entry(step, in_nest)).await?;
        }
        let (accepts, kept): (Vec<Accepts>, Vec<mpsc::Receiver<Sample>>) =
            step.sensors.iter().map(|_| keeping(MAX_SAMPLES)).unzip();
        let outcome = self.watched(step, sweep, accepts).await;
        let samples: Vec<Vec<Sample>> = kept.into_iter().map(received).collect();
        let outcome = match outcome {
            Err(RunError::EarlyDistance { .. })
                if samples.iter().any(|samples| samples.len() == MAX_SAMPLES) =>
            {
                return Err(unswept("a sensor reported more samples on the way than are kept"));
            }
            outcome => outcome?,
        };
        let Some(track) = outcome.track else { return Err(RunError::NotStamped { step: step.id }) };
        if let Some(why) = sweep::unstamped(&track, &scan.path) {
            return Err(unswept(&why));
        }
        let mut readings = Vec::new();
        for (sensor, samples) in step.sensors.iter().zip(samples) {
            let placed = sweep::placed(&samples, &track, most_hz);
            if placed.samples.is_empty() {
                return Err(unswept(&nothing_placed(sensor, samples.is_empty())));
            }
            self.tell_of((step, sensor), &placed, track.gaps()).await?;
            let kept = match equal_angles::wanted(scan) {
                Some((axis, count)) => {
                    let turn = equal_angles::filtered(&placed.samples, axis, count);
                    if let Some(text) = turn.lacking(&step.label, sensor) {
                        self.note(Event::Announced { text }).await?;
                    }
                    turn.samples
                }
                None => placed.samples,
            };
            readings.extend(self.along(step, sensor, repeat, kept));
        }
        Ok(readings)
    }

    /// What was left out is told, not passed over.
    async fn tell_of(
        &mut self,
        (step, sensor): (&Step, &str),
        placed: &Placed,
        gaps: usize,
    ) -> Result<(), RunError> {
        let Placed { samples, nowhere, thinned } = placed;
        let (label, all) = (&step.label, samples.len() + nowhere + thinned);
        let by_gaps = format!(
            "{label}: {nowhere} of {all} samples of {sensor} are left out: in {gaps} places the control's \
             positions have a gap"
        );
        let by_rate = format!(
            "{label}: {thinned} of {all} samples of {sensor} are left out: the sensor is faster than rate_hz \
             of the plan"
        );
        for (count, text) in [(nowhere, by_gaps), (thinned, by_rate)] {
            if *count > 0 {
                self.note(Event::Announced { text }).await?;
            }
        }
        Ok(())
    }

    fn along(
        &mut self,
        step: &Step,
        sensor: &str,
        repeat: u32,
        samples: Vec<(Sample, Position)>,
    ) -> Vec<Reading> {
        let now_s = self.devices.clock.now_s();
        let shift_s = self.timeline.at(now_s) - now_s;
        let placed = samples.into_iter().map(|(sample, position)| Sampled {
            sensor,
            sample,
            t_s: sample.t_s + shift_s,
            position,
        });
        placed.map(|sampled| reading(step, repeat, sampled)).collect()
    }

    /// The axes stood still all the while; the samples lie in time as the clock of the first sensor says.
    fn at_point(
        &mut self,
        step: &Step,
        repeat: u32,
        (own_s, stands): (f64, &Position),
        samples: &[Vec<Sample>],
    ) -> Vec<Reading> {
        let began = self.timeline.at(own_s);
        let times: Vec<f64> = samples.iter().take(1).flatten().map(|sample| sample.t_s).collect();
        let after_s =
            |k: usize| times.get(k).zip(times.first()).map_or(0.0, |(t, first)| t - first);
        let of_sensor = |(sensor, samples): (&String, &Vec<Sample>)| -> Vec<Reading> {
            let sampled = samples.iter().enumerate().map(|(k, sample)| Sampled {
                sensor,
                sample: *sample,
                t_s: began + after_s(k),
                position: stands.clone(),
            });
            sampled.map(|sampled| reading(step, repeat, sampled)).collect()
        };
        step.sensors.iter().zip(samples).flat_map(of_sensor).collect()
    }
}

fn reading(step: &Step, repeat: u32, sampled: Sampled<'_>) -> Reading {
    let Sampled { sensor, sample, t_s, position } = sampled;
    Reading {
        step: step.id,
        repeat,
        position,
        value_mm: sample.value_mm,
        sensor: sensor.to_owned(),
        t_s,
        flag: sample.flag,
        temperatures_c: Default::default(),
    }
}

/// Distances, which come out of the channel, at most `count`.
fn keeping(count: usize) -> (Accepts, mpsc::Receiver<Sample>) {
    let (sender, receiver) = mpsc::channel(count);
    let keep = move |sample: &Sample| is_distance(sample) && sender.try_send(*sample).is_ok();
    (Box::new(keep), receiver)
}

/// What has come by now.
fn received(mut samples: mpsc::Receiver<Sample>) -> Vec<Sample> {
    std::iter::from_fn(|| samples.try_recv().ok()).collect()
}

fn nothing_placed(sensor: &str, is_silent: bool) -> String {
    match is_silent {
        true => format!(
            "{sensor} reported nothing on the way; a simulated sensor without a wire reports only when it is \
             polled"
        ),
        false => format!(
            "no sample of {sensor} was taken at a time at which the control reports where the axes stood"
        ),
    }
}
