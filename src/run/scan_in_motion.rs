//! One scan in motion: samples from the first point of the path to the last. Their positions come from the
//! control's time stamps or from the encoder count of the turning axis in each sample.

use std::time::Duration;

use tokio::sync::mpsc;
use tokio::time::sleep;

use super::counted_turn::{CountedTurn, rotation_between_samples_rad};
use super::equal_angles;
use super::position_assignment::{self, PositionedSamples, REST_TOLERANCE_MM_OR_RAD};
use super::scan::{PositionedSample, to_reading};
use super::unrounded_position::undo_control_rounding;
use super::watched_sensors::{SampleCondition, is_distance};
use super::{Run, RunError};
use crate::setup::EncoderScale;
use devices::sensors::Sample;
use machine::Position;
use machine::record::axis_track::AxisTrack;
use machine::record::event::RunEvent;
use machine::record::plan::{Sampling, Scan, Step};
use machine::record::reading::Reading;
use planning::proof::ProvenBlock;

/// Maximum number of samples of one sensor per scan in motion, a quarter of an hour at 1 kHz.
const MAX_SAMPLES_PER_SENSOR: usize = 1_000_000;
/// Period of the checks whether the counts are at rest: samples may still arrive after the control reports rest.
const STANDSTILL_POLL_PERIOD: Duration = Duration::from_millis(20);
/// Maximum number of checks whether the counts are at rest; the run then continues.
const MAX_STANDSTILL_POLLS: usize = 100;

/// An executed scan in motion.
struct ExecutedScanInMotion {
    /// Positions of the axes over time as the control reported them, if it records them.
    track: Option<AxisTrack>,
    /// Positions that the control reports at rest before and after the scan, if encoder counts give the
    /// positions.
    rest_positions_before_and_after: Option<[Position; 2]>,
    sensor_channels: Vec<SensorChannel>,
}

/// Samples of one sensor.
struct SensorChannel {
    sensor: String,
    /// Scale of the encoder whose counts give the positions, and the sample at rest before the scan.
    encoder_and_rest_sample: Option<(EncoderScale, Sample)>,
    /// Received during the motion, in order.
    samples: Vec<Sample>,
}

impl Run<'_> {
    /// Checks before any motion that the positions of all samples can be known: the control stamps positions,
    /// or each sample carries the encoder count of the axis that turns.
    pub(super) fn check_positions_available_in_motion(&self, steps: &[Step]) -> Result<(), RunError> {
        let lacks_positions = |step: &&Step| match &step.scan {
            Some(scan) if matches!(scan.sampling, Sampling::Continuous { .. }) => {
                step.sensors.iter().any(|sensor| self.path_encoder(scan, sensor).is_none())
            }
            _ => false,
        };
        match steps.iter().find(lacks_positions) {
            Some(step) if !self.devices.open_controller.can_record_track() => {
                Err(RunError::NoTimeStampedPositions { step: step.id })
            }
            _ => Ok(()),
        }
    }

    /// Scale of the encoder whose counts give the positions of the samples of `sensor` along `scan`. `None`:
    /// the positions that the control stamps are used.
    fn path_encoder(&self, scan: &Scan, sensor: &str) -> Option<EncoderScale> {
        let scale = self.devices.sensor_opener.encoder_scale(sensor)?;
        let axis = scan.single_rotary_axis().filter(|axis| *axis == scale.encoder.axis)?;
        let turned = scan.path.last()?.get_or_zero(axis) - scan.path.first()?.get_or_zero(axis);
        (turned.abs() > REST_TOLERANCE_MM_OR_RAD).then_some(scale)
    }

    /// Executes the scan. Returns the samples from the first point to the last, each with the position at which it
    /// was taken, or resampled at equal angles if the plan requests equal angles.
    pub(super) async fn run_scan_in_motion(
        &mut self,
        step: &Step,
        scan: &Scan,
        repeat_number: u32,
        max_rate_hz: f64,
        mut blocks: Vec<ProvenBlock>,
        is_ball_in_nest: bool,
    ) -> Result<Vec<Reading>, RunError> {
        let Some(block) = blocks.pop() else {
            return Err(scan_in_motion_failed(step, "the step contains no motion"));
        };
        for approach_block in blocks {
            self.execute_with_hold_on_rejection(
                step,
                approach_block,
                self.range_entry_conditions(step, is_ball_in_nest),
            )
            .await?;
        }
        let sweep = self.execute_scan_in_motion(step, scan, block).await?;
        let mut readings = Vec::new();
        for channel in &sweep.sensor_channels {
            let placed = sweep.assign_positions(channel, step, scan, max_rate_hz)?;
            let sensor = channel.sensor.as_str();
            if placed.samples.is_empty() {
                return Err(scan_in_motion_failed(step, &no_samples_reason(sensor, channel.samples.is_empty())));
            }
            let gaps = sweep.track.as_ref().map_or(0, AxisTrack::gap_count);
            self.report_unused_samples(step, sensor, &placed, gaps).await?;
            let kept = match equal_angles::axis_and_angles_per_revolution(scan) {
                Some((axis, count)) => {
                    let turn = equal_angles::resample_turn(&placed.samples, axis, count);
                    self.record_messages(turn.gap_message(&step.label, sensor)).await?;
                    turn.samples_with_positions
                }
                None => placed.samples,
            };
            readings.extend(self.scan_in_motion_readings(step, sensor, repeat_number, kept));
        }
        Ok(readings)
    }

    async fn execute_scan_in_motion(
        &self,
        step: &Step,
        scan: &Scan,
        block: ProvenBlock,
    ) -> Result<ExecutedScanInMotion, RunError> {
        let mut channels = self.prepare_sensor_channels(step, scan).await?;
        let is_counted = channels.iter().any(|channel| channel.encoder_and_rest_sample.is_some());
        let before = if is_counted { Some(self.read_rest_position(scan.path.first()).await?) } else { None };
        let (conditions, mut kept): (Vec<SampleCondition>, Vec<mpsc::Receiver<Sample>>) =
            step.sensors.iter().map(|_| distance_buffering_condition(MAX_SAMPLES_PER_SENSOR)).unzip();
        self.begin_watch(step, conditions).await?;
        let executed = self.devices.open_controller.execute(block).await;
        if is_counted && executed.is_ok() {
            wait_for_encoder_rest(&mut channels, &mut kept).await;
        }
        let outcome = self.end_watch(step, executed).await;
        channels.iter_mut().zip(&mut kept).for_each(|(channel, kept)| channel.append_received(kept));
        let is_full = channels.iter().any(|channel| channel.samples.len() >= MAX_SAMPLES_PER_SENSOR);
        let outcome = match outcome {
            Err(RunError::UnexpectedBodyInRange { .. }) if is_full => {
                let why = "a sensor sent more samples during the motion than the buffer can store";
                return Err(scan_in_motion_failed(step, why));
            }
            outcome => outcome?,
        };
        let rest_positions = match before {
            Some(before) => Some([before, self.read_rest_position(scan.path.last()).await?]),
            None => None,
        };
        Ok(ExecutedScanInMotion {
            track: outcome.track,
            rest_positions_before_and_after: rest_positions,
            sensor_channels: channels,
        })
    }

    /// Empty channels for the sensors of `step`, with a sample at rest where encoder counts give the positions.
    async fn prepare_sensor_channels(&self, step: &Step, scan: &Scan) -> Result<Vec<SensorChannel>, RunError> {
        let scales: Vec<_> = step.sensors.iter().map(|name| self.path_encoder(scan, name)).collect();
        let firsts: Vec<Option<Sample>> = match scales.iter().any(Option::is_some) {
            true => {
                let samples = self.take_samples_at_rest(step, 1).await?;
                samples.iter().map(|samples| samples.first().copied()).collect()
            }
            false => vec![None; scales.len()],
        };
        let channel = |((sensor, scale), first): ((&String, Option<EncoderScale>), _)| SensorChannel {
            sensor: sensor.clone(),
            encoder_and_rest_sample: scale.zip(first),
            samples: Vec::new(),
        };
        Ok(step.sensors.iter().zip(scales).zip(firsts).map(channel).collect())
    }

    /// Position that the control reports at rest after the motion to `commanded`.
    async fn read_rest_position(&self, commanded: Option<&Position>) -> Result<Position, RunError> {
        let displayed = self.devices.open_controller.read_snapshot().await?.position;
        Ok(commanded.map_or_else(|| displayed.clone(), |commanded| undo_control_rounding(&displayed, commanded)))
    }

    /// Reports the samples that were left out.
    async fn report_unused_samples(
        &mut self,
        step: &Step,
        sensor: &str,
        positioned: &PositionedSamples,
        gap_count: usize,
    ) -> Result<(), RunError> {
        let PositionedSamples {
            samples,
            without_position_count: without_position,
            dropped_by_rate_count: dropped_by_rate,
        } = positioned;
        let (label, all) = (&step.label, samples.len() + without_position + dropped_by_rate);
        let by_gaps = format!(
            "{label}: {without_position} of {all} samples of {sensor} are not used: the positions of the control \
            have {gap_count} gaps"
        );
        let by_rate = format!(
            "{label}: {dropped_by_rate} of {all} samples of {sensor} are not used: the sensor is faster than \
            rate_hz of the plan"
        );
        for (count, text) in [(without_position, by_gaps), (dropped_by_rate, by_rate)] {
            if *count > 0 {
                self.record_event(RunEvent::OperatorMessage { text }).await?;
            }
        }
        Ok(())
    }

    fn scan_in_motion_readings(
        &mut self,
        step: &Step,
        sensor: &str,
        repeat_number: u32,
        samples: Vec<(Sample, Position)>,
    ) -> Vec<Reading> {
        let now_s = self.devices.clock.now_s();
        let shift_s = self.timeline.control_to_run_time_s(now_s) - now_s;
        let placed = samples.into_iter().map(|(sample, position)| PositionedSample {
            sensor,
            sample,
            time_in_run_s: sample.received_s + shift_s,
            position,
        });
        placed.map(|sampled| to_reading(step, repeat_number, sampled)).collect()
    }
}

impl ExecutedScanInMotion {
    /// Positions of the samples: from the encoder counts if the channel has them, otherwise from the track.
    fn assign_positions(
        &self,
        channel: &SensorChannel,
        step: &Step,
        scan: &Scan,
        max_rate_hz: f64,
    ) -> Result<PositionedSamples, RunError> {
        if let (Some((scale, first)), Some([before, after])) =
            (channel.encoder_and_rest_sample, &self.rest_positions_before_and_after)
        {
            let (rest_positions, speed_deg_s) = ([before, after], step.feed_mm_min / 60.0);
            let turn = CountedTurn {
                encoder_scale: scale,
                rest_positions_before_and_after: rest_positions,
                sample_before_turn: first,
                max_speed_deg_s: speed_deg_s,
            };
            let (step, sensor) = (step.id, channel.sensor.clone());
            let placed = turn.assign_positions(&channel.samples, max_rate_hz);
            return placed.map_err(|source| RunError::EncoderFault { step, sensor, source });
        }
        let track = self.track.as_ref().ok_or(RunError::NoTimeStampedPositions { step: step.id })?;
        match position_assignment::reason_for_uncovered_path(track, &scan.path) {
            Some(why) => Err(scan_in_motion_failed(step, &why)),
            None => Ok(position_assignment::assign_positions(&channel.samples, track, max_rate_hz)),
        }
    }
}

impl SensorChannel {
    /// Appends the samples received so far.
    fn append_received(&mut self, receiver: &mut mpsc::Receiver<Sample>) {
        self.samples.extend(std::iter::from_fn(|| receiver.try_recv().ok()));
    }

    /// Whether the counts of the first and the last of `samples` are nearly equal; false for fewer than two samples.
    /// True for a sensor without counts.
    fn is_at_rest(&self, samples: &[Sample]) -> bool {
        let Some((scale, _)) = self.encoder_and_rest_sample else { return true };
        match samples {
            [from, .., to] => rotation_between_samples_rad(scale, from, to)
                .is_some_and(|turned| turned.abs() <= REST_TOLERANCE_MM_OR_RAD),
            _ => false,
        }
    }
}

/// Waits until the newest samples of each sensor with counts show an axis at rest, or until the last check.
async fn wait_for_encoder_rest(channels: &mut [SensorChannel], receivers: &mut [mpsc::Receiver<Sample>]) {
    let size = |(channel, kept): (&mut SensorChannel, &mut mpsc::Receiver<Sample>)| {
        channel.append_received(kept);
        channel.samples.len()
    };
    let mut sizes: Vec<usize> = channels.iter_mut().zip(receivers.iter_mut()).map(size).collect();
    for _ in 0..MAX_STANDSTILL_POLLS {
        sleep(STANDSTILL_POLL_PERIOD).await;
        let mut is_at_rest = true;
        for ((channel, kept), size) in channels.iter_mut().zip(receivers.iter_mut()).zip(&mut sizes) {
            channel.append_received(kept);
            let newest = channel.samples.get(*size..).unwrap_or_default();
            is_at_rest &= channel.is_at_rest(newest);
            // A slow sensor needs more than one period for two samples.
            if newest.len() > 1 {
                *size = channel.samples.len();
            }
        }
        if is_at_rest {
            return;
        }
    }
}

fn scan_in_motion_failed(step: &Step, why: &str) -> RunError {
    RunError::ScanInMotionFailed { step: step.id, why: why.to_owned() }
}

/// Condition that accepts distances only, and the channel to which the condition sends them. When the channel is full
/// (`capacity` unread samples), the condition rejects the next sample, which holds the machine.
fn distance_buffering_condition(capacity: usize) -> (SampleCondition, mpsc::Receiver<Sample>) {
    let (sender, receiver) = mpsc::channel(capacity);
    let keep = move |sample: &Sample| is_distance(sample) && sender.try_send(*sample).is_ok();
    (Box::new(keep), receiver)
}

fn no_samples_reason(sensor: &str, is_silent: bool) -> String {
    match is_silent {
        true => format!(
            "{sensor} sent no samples during the motion; a simulated sensor without `wire` sends samples \
            only when it is polled"
        ),
        false => format!("no sample of {sensor} lies within the times for which the control reported axis positions"),
    }
}
