//! One scan: samples at rest at each point of the path, or samples in motion along the whole path
//! (`scan_in_motion.rs`).

use super::unrounded_position::undo_control_rounding;
use super::watched_sensors::{SampleCondition, has_signal, is_distance, is_out_of_range};
use super::{Run, RunError};
use devices::sensors::Sample;
use machine::Position;
use machine::record::plan::{Sampling, Scan, Step};
use machine::record::reading::Reading;
use machine::record::sensor::SensorMount;
use planning::proof::ProvenBlock;
use planning::{out_of_range_block_count, position_after_motions};

/// A sample of a sensor with the position of the axes.
pub(super) struct PositionedSample<'a> {
    pub sensor: &'a str,
    pub sample: Sample,
    /// Time of the sample on the clock of the run, s.
    pub time_in_run_s: f64,
    pub position: Position,
}

impl Run<'_> {
    /// Executes the blocks of a scan and returns all samples taken along it.
    pub(super) async fn run_scan(
        &mut self,
        step: &Step,
        scan: &Scan,
        repeat_number: u32,
        mut blocks: Vec<ProvenBlock>,
    ) -> Result<Vec<Reading>, RunError> {
        let scan_blocks = blocks.split_off(out_of_range_block_count(scan, blocks.len()));
        let is_ball_in_nest = blocks.is_empty();
        self.clear_sensor_range_before_scan(step, blocks).await?;
        if is_ball_in_nest {
            for sensor in self.step_sensors_on(step, &[SensorMount::Table]) {
                self.check_sample(step, &sensor.name, is_distance).await?;
            }
        }
        match scan.sampling {
            Sampling::Dwell { samples, .. } => {
                self.run_dwells(step, repeat_number, samples, scan_blocks, is_ball_in_nest).await
            }
            Sampling::Continuous { rate_hz, per_revolution } => {
                // The resampling at equal angles needs all samples.
                let max_rate_hz = if per_revolution.is_some() { f64::INFINITY } else { rate_hz };
                self.run_scan_in_motion(step, scan, repeat_number, max_rate_hz, scan_blocks, is_ball_in_nest).await
            }
        }
    }

    /// While no scan has confirmed the position of the machine, moves out of the sensors' range: first up, then to a
    /// position where no declared body is within the range of a sensor in the spindle and the ball is outside the range
    /// of a sensor on the table. A distance during or after the last of these motions means that a body is not at its
    /// stated position; the machine is then held.
    async fn clear_sensor_range_before_scan(&mut self, step: &Step, blocks: Vec<ProvenBlock>) -> Result<(), RunError> {
        let moving = self.step_sensors_on(step, &[SensorMount::Spindle, SensorMount::Table]);
        let moving: Vec<String> = moving.into_iter().map(|sensor| sensor.name).collect();
        let condition = |name: &String, is_last: bool| -> SampleCondition {
            Box::new(if is_last && moving.contains(name) { is_out_of_range } else { has_signal })
        };
        let count = blocks.len();
        for (number, block) in (1..).zip(blocks) {
            let conditions = step.sensors.iter().map(|name| condition(name, number == count)).collect();
            self.execute_with_hold_on_rejection(step, block, conditions).await?;
        }
        if count > 0 {
            // A simulated sensor without a wire cannot be watched: it reports only when it is polled.
            for name in &moving {
                self.check_sample(step, name, is_out_of_range).await?;
            }
        }
        Ok(())
    }

    /// Executes a block for each point and takes `samples_per_point` samples of each sensor there. `is_ball_in_nest`:
    /// as in [`Run::range_entry_conditions`].
    async fn run_dwells(
        &mut self,
        step: &Step,
        repeat_number: u32,
        samples_per_point: u32,
        blocks: Vec<ProvenBlock>,
        is_ball_in_nest: bool,
    ) -> Result<Vec<Reading>, RunError> {
        let mut readings = Vec::new();
        let first = step.scan.as_ref().and_then(|scan| scan.path.first());
        let mut commanded = first.cloned().unwrap_or_default();
        for (number, block) in blocks.into_iter().enumerate() {
            let conditions = match number {
                0 => self.range_entry_conditions(step, is_ball_in_nest),
                _ => step.sensors.iter().map(|_| Box::new(is_distance) as SampleCondition).collect(),
            };
            commanded = position_after_motions(block.motions(), &commanded);
            let outcome = self.execute_with_hold_on_rejection(step, block, conditions).await?;
            let control_time_s = outcome.trigger_time_s.unwrap_or_else(|| self.devices.clock.now_s());
            let position = self.devices.open_controller.read_snapshot().await?.position;
            let position = undo_control_rounding(&position, &commanded);
            let samples = self.take_samples_at_rest(step, samples_per_point).await?;
            readings.extend(self.point_readings(step, repeat_number, control_time_s, &position, &samples));
        }
        Ok(readings)
    }

    /// Readings at one point. The axes were at rest; the samples are spaced in time by the clock of the first
    /// sensor.
    fn point_readings(
        &mut self,
        step: &Step,
        repeat_number: u32,
        control_time_s: f64,
        machine_position: &Position,
        samples: &[Vec<Sample>],
    ) -> Vec<Reading> {
        let began = self.timeline.control_to_run_time_s(control_time_s);
        let times: Vec<f64> = samples.iter().take(1).flatten().map(|sample| sample.received_s).collect();
        let after_s = |k: usize| times.get(k).zip(times.first()).map_or(0.0, |(t, first)| t - first);
        let of_sensor = |(sensor, samples): (&String, &Vec<Sample>)| -> Vec<Reading> {
            let sampled = samples.iter().enumerate().map(|(k, sample)| PositionedSample {
                sensor,
                sample: *sample,
                time_in_run_s: began + after_s(k),
                position: machine_position.clone(),
            });
            sampled.map(|sampled| to_reading(step, repeat_number, sampled)).collect()
        };
        step.sensors.iter().zip(samples).flat_map(of_sensor).collect()
    }
}

/// Reading of a sample, without temperatures: these are added when the reading is stored.
pub(super) fn to_reading(step: &Step, repeat_number: u32, sampled: PositionedSample<'_>) -> Reading {
    let PositionedSample { sensor, sample, time_in_run_s: t_s, position } = sampled;
    Reading {
        step: step.id,
        repeat: repeat_number,
        position,
        value_mm: sample.value_mm,
        sensor: sensor.to_owned(),
        t_s,
        flag: sample.flag,
        temperatures_c: Default::default(),
    }
}
