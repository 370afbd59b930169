//! One scan in motion: samples from the first point of the path to the last. Their positions come from the
//! control's time stamps or from the encoder count of the turning axis in each sample.

use std::time::Duration;

use tokio::sync::mpsc;
use tokio::time::sleep;

use super::counted_turn::{CountedTurn, turned_rad};
use super::display_rounding::unrounded;
use super::equal_angles;
use super::scan::{Sampled, reading};
use super::sweep::{self, Placed, REST_TOLERANCE};
use super::watched_sensors::{Accepts, is_distance};
use super::{Run, RunError};
use crate::setup::EncoderScale;
use devices::sensors::Sample;
use machine::Position;
use machine::record::event::Event;
use machine::record::plan::{Sampling, Scan, Step};
use machine::record::reading::Reading;
use machine::record::track::Track;
use planning::proof::ProvenBlock;

/// Maximum number of samples of one sensor per scan in motion, a quarter of an hour at 1 kHz.
const MAX_SAMPLES: usize = 1_000_000;
/// Period and number of the checks whether the counts are at rest: samples may still arrive after the control
/// reports rest.
const REST_PERIOD: Duration = Duration::from_millis(20);
const MAX_REST_PERIODS: usize = 100;

/// An executed scan in motion.
struct Sweep {
    track: Option<Track>,
    /// Positions that the control reports at rest before and after the scan, if encoder counts give the
    /// positions.
    rests: Option<[Position; 2]>,
    channels: Vec<Channel>,
}

/// Samples of one sensor.
struct Channel {
    sensor: String,
    /// Scale of the encoder whose counts give the positions, and the sample at rest before the scan.
    counts: Option<(EncoderScale, Sample)>,
    samples: Vec<Sample>,
}

impl Run<'_> {
    /// Checks before any motion that the positions of all samples can be known: the control stamps positions,
    /// or each sample carries the encoder count of the axis that turns.
    pub(super) fn can_sweep(&self, steps: &[Step]) -> Result<(), RunError> {
        let lacks_positions = |step: &&Step| match &step.scan {
            Some(scan) if matches!(scan.sampling, Sampling::Continuous { .. }) => {
                step.sensors.iter().any(|sensor| self.encoder_of(scan, sensor).is_none())
            }
            _ => false,
        };
        match steps.iter().find(lacks_positions) {
            Some(step) if !self.devices.controller.stamps() => {
                Err(RunError::NotStamped { step: step.id })
            }
            _ => Ok(()),
        }
    }

    /// Scale of the encoder whose counts give the positions of the samples of `sensor` along `scan`. `None`:
    /// the positions that the control stamps are used.
    fn encoder_of(&self, scan: &Scan, sensor: &str) -> Option<EncoderScale> {
        let scale = self.devices.sensors.encoder_scale(sensor)?;
        let axis = scan.turned_axis().filter(|axis| *axis == scale.encoder.axis)?;
        let turned = scan.path.last()?.at(axis) - scan.path.first()?.at(axis);
        (turned.abs() > REST_TOLERANCE).then_some(scale)
    }

    /// Samples from the first point to the last, each with the position at which it was taken.
    pub(super) async fn sweep(
        &mut self,
        (step, scan): (&Step, &Scan),
        repeat: u32,
        most_hz: f64,
        mut blocks: Vec<ProvenBlock>,
        in_nest: bool,
    ) -> Result<Vec<Reading>, RunError> {
        let Some(block) = blocks.pop() else { return Err(unswept(step, "it has no motion")) };
        for way in blocks {
            self.watched(step, way, self.accepted_on_entry(step, in_nest)).await?;
        }
        let sweep = self.executed_sweep((step, scan), block).await?;
        let mut readings = Vec::new();
        for channel in &sweep.channels {
            let placed = sweep.placed(channel, (step, scan), most_hz)?;
            let sensor = channel.sensor.as_str();
            if placed.samples.is_empty() {
                return Err(unswept(step, &nothing_placed(sensor, channel.samples.is_empty())));
            }
            let gaps = sweep.track.as_ref().map_or(0, Track::gaps);
            self.tell_of((step, sensor), &placed, gaps).await?;
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

    async fn executed_sweep(
        &self,
        (step, scan): (&Step, &Scan),
        block: ProvenBlock,
    ) -> Result<Sweep, RunError> {
        let mut channels = self.channels(step, scan).await?;
        let is_counted = channels.iter().any(|channel| channel.counts.is_some());
        let before = if is_counted { Some(self.at_rest(scan.path.first()).await?) } else { None };
        let (accepts, mut kept): (Vec<Accepts>, Vec<mpsc::Receiver<Sample>>) =
            step.sensors.iter().map(|_| keeping(MAX_SAMPLES)).unzip();
        self.begin_watch(step, accepts).await?;
        let executed = self.devices.controller.execute(block).await;
        if is_counted && executed.is_ok() {
            until_counts_rest(&mut channels, &mut kept).await;
        }
        let outcome = self.end_watch(step, executed).await;
        channels.iter_mut().zip(&mut kept).for_each(|(channel, kept)| channel.receive(kept));
        let is_full = channels.iter().any(|channel| channel.samples.len() >= MAX_SAMPLES);
        let outcome = match outcome {
            Err(RunError::EarlyDistance { .. }) if is_full => {
                let why = "a sensor reported more samples on the way than are kept";
                return Err(unswept(step, why));
            }
            outcome => outcome?,
        };
        let rests = match before {
            Some(before) => Some([before, self.at_rest(scan.path.last()).await?]),
            None => None,
        };
        Ok(Sweep { track: outcome.track, rests, channels })
    }

    /// Channels of the sensors of `step`, before the axes start.
    async fn channels(&self, step: &Step, scan: &Scan) -> Result<Vec<Channel>, RunError> {
        let scales: Vec<_> = step.sensors.iter().map(|name| self.encoder_of(scan, name)).collect();
        let firsts: Vec<Option<Sample>> = match scales.iter().any(Option::is_some) {
            true => {
                let samples = self.samples_at_rest(step, 1).await?;
                samples.iter().map(|samples| samples.first().copied()).collect()
            }
            false => vec![None; scales.len()],
        };
        let channel = |((sensor, scale), first): ((&String, Option<EncoderScale>), _)| Channel {
            sensor: sensor.clone(),
            counts: scale.zip(first),
            samples: Vec::new(),
        };
        Ok(step.sensors.iter().zip(scales).zip(firsts).map(channel).collect())
    }

    /// Position that the control reports at rest after the motion to `commanded`.
    async fn at_rest(&self, commanded: Option<&Position>) -> Result<Position, RunError> {
        let stands = self.devices.controller.look().await?.stands;
        Ok(commanded.map_or_else(|| stands.clone(), |commanded| unrounded(&stands, commanded)))
    }

    /// Reports the samples that were left out.
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
}

impl Sweep {
    fn placed(
        &self,
        channel: &Channel,
        (step, scan): (&Step, &Scan),
        most_hz: f64,
    ) -> Result<Placed, RunError> {
        if let (Some((scale, first)), Some([before, after])) = (channel.counts, &self.rests) {
            let (rests, speed_deg_s) = ([before, after], step.feed_mm_min / 60.0);
            let turn = CountedTurn { scale, rests, first, speed_deg_s };
            let (step, sensor) = (step.id, channel.sensor.clone());
            let placed = turn.placed(&channel.samples, most_hz);
            return placed.map_err(|source| RunError::Miscounted { step, sensor, source });
        }
        let track = self.track.as_ref().ok_or(RunError::NotStamped { step: step.id })?;
        match sweep::unstamped(track, &scan.path) {
            Some(why) => Err(unswept(step, &why)),
            None => Ok(sweep::placed(&channel.samples, track, most_hz)),
        }
    }
}

impl Channel {
    /// Appends the samples received so far.
    fn receive(&mut self, kept: &mut mpsc::Receiver<Sample>) {
        self.samples.extend(std::iter::from_fn(|| kept.try_recv().ok()));
    }

    /// Whether the counts of `samples`, two or more, are nearly equal.
    fn is_at_rest(&self, samples: &[Sample]) -> bool {
        let Some((scale, _)) = self.counts else { return true };
        match samples {
            [from, .., to] => {
                turned_rad(scale, from, to).is_some_and(|turned| turned.abs() <= REST_TOLERANCE)
            }
            _ => false,
        }
    }
}

/// Waits until the newest samples of each sensor with counts show an axis at rest, or until the last check.
async fn until_counts_rest(channels: &mut [Channel], kept: &mut [mpsc::Receiver<Sample>]) {
    let size = |(channel, kept): (&mut Channel, &mut mpsc::Receiver<Sample>)| {
        channel.receive(kept);
        channel.samples.len()
    };
    let mut sizes: Vec<usize> = channels.iter_mut().zip(kept.iter_mut()).map(size).collect();
    for _ in 0..MAX_REST_PERIODS {
        sleep(REST_PERIOD).await;
        let mut is_at_rest = true;
        for ((channel, kept), size) in channels.iter_mut().zip(kept.iter_mut()).zip(&mut sizes) {
            channel.receive(kept);
            let newest = channel.samples.get(*size..).unwrap_or_default();
            is_at_rest &= channel.is_at_rest(newest);
            // Two samples of a slow sensor take longer than one period.
            if newest.len() > 1 {
                *size = channel.samples.len();
            }
        }
        if is_at_rest {
            return;
        }
    }
}

fn unswept(step: &Step, why: &str) -> RunError {
    RunError::Unswept { step: step.id, why: why.to_owned() }
}

/// Accepts distances and sends them to the returned channel, at most `count`.
fn keeping(count: usize) -> (Accepts, mpsc::Receiver<Sample>) {
    let (sender, receiver) = mpsc::channel(count);
    let keep = move |sample: &Sample| is_distance(sample) && sender.try_send(*sample).is_ok();
    (Box::new(keep), receiver)
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
