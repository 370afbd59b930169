//! From readings to revolutions at equal angles.

use estimation::revolutions::{
    AngleSample, ChannelRevolutions, RejectedRevolutions, ResampleFilter, Resampler, StopScan, append_revolutions,
    common_and_rejected_revolutions, invalidate_saturated_samples, remove_channels_with_fewer_revolutions,
};
use std::collections::BTreeSet;

use super::settings::TurnSampling;
use super::setup::MultiprobeSetup;
use super::step_label::StepLabel;
use crate::{IdentifyError, readings_of_last_repeat};
use machine::record::plan::Step;
use machine::record::reading::{Reading, ReadingFlag};

/// Data extracted from the readings.
#[derive(Default)]
pub struct ObservedRevolutions {
    /// Revolutions of each channel at each index, forward and backward, in the order of time: deviations m = −value,
    /// mm.
    pub all_rows: Vec<ChannelRevolutions>,
    /// Revolutions of the forward turns alone, also of channels that `all_rows` omits. The revolutions of a forward
    /// turn follow one another without a gap.
    pub forward_rows: Vec<ChannelRevolutions>,
    /// Descriptions of omitted data.
    pub omission_descriptions: Vec<String>,
    /// Number of pairs of stop and channel without any distance. 0 for continuous turns.
    pub channel_stops_without_distance_count: usize,
    /// Duration of one forward revolution of the last mounting, s.
    pub forward_revolution_duration_s: f64,
}

/// Revolutions of all mountings.
///
/// # Errors
/// A reading belongs to no step of the plan, or a mounting has no turn.
pub fn observe_revolutions(
    setup: &MultiprobeSetup<'_>,
    readings: &[Reading],
) -> Result<ObservedRevolutions, IdentifyError> {
    IdentifyError::check_known_steps(setup.plan, readings)?;
    let filter = ResampleFilter::new(setup.settings.positions);
    let mut observed = ObservedRevolutions::default();
    for index in 0..setup.settings.indexes {
        let mut rows: Vec<ChannelRevolutions> = Vec::new();
        for step in &setup.plan.steps {
            let is_forward = match step.label.parse() {
                Ok(StepLabel::ForwardTurn(number)) if number == index + 1 => true,
                Ok(StepLabel::BackwardTurn(number)) if number == index + 1 => false,
                _ => continue,
            };
            let own = readings_of_last_repeat(step, readings)?;
            let (mut of_scan, rejected) = scan_revolutions(setup, &filter, step, index, &own);
            if !is_forward {
                // The revolutions come in the order of the angle.
                of_scan.iter_mut().for_each(|row| row.revolutions.reverse());
            }
            observed.record_rejected_revolutions(setup, step, rejected);
            observed.channel_stops_without_distance_count += count_missing_channel_stops(setup, step, &own);
            if is_forward {
                observed.forward_rows.extend(of_scan.iter().cloned());
                observed.forward_revolution_duration_s = time_span_s(&own) / setup.settings.revolutions as f64;
            }
            append_revolutions(&mut rows, of_scan);
        }
        observed.add_complete_rows(setup, index, rows);
    }
    Ok(observed)
}

/// Number of pairs of stop and channel of one turn without any distance. 0 for continuous turns.
fn count_missing_channel_stops(setup: &MultiprobeSetup<'_>, step: &Step, readings: &[&Reading]) -> usize {
    if !uses_dwell_sampling(setup) {
        return 0;
    }
    let stop =
        |reading: &Reading| stops_of_scan(setup, step).stop_index(reading.position.get_or_zero(setup.measured_axis));
    let measured = readings.iter().filter(|reading| reading.value_mm.is_some());
    let measured: BTreeSet<(i64, &str)> = measured.map(|r| (stop(r), r.sensor.as_str())).collect();
    let stops = step.scan.as_ref().map_or(0, |scan| scan.path.len());
    (stops * setup.plan.sensors.len()).saturating_sub(measured.len())
}

fn uses_dwell_sampling(setup: &MultiprobeSetup<'_>) -> bool {
    setup.settings.sampling == TurnSampling::Dwell
}

/// Equal angles of the scan. Missing stops are interpolated only with dwell sampling.
fn stops_of_scan(setup: &MultiprobeSetup<'_>, step: &Step) -> StopScan {
    StopScan {
        stops_per_revolution: setup.settings.positions,
        ends_rad: [&step.from, &step.to].map(|end| end.get_or_zero(setup.measured_axis)),
        fill_harmonic_count: uses_dwell_sampling(setup).then_some(setup.settings.harmonics),
    }
}

fn time_span_s(readings: &[&Reading]) -> f64 {
    let times = || readings.iter().map(|reading| reading.t_s);
    times().fold(f64::NEG_INFINITY, f64::max) - times().fold(f64::INFINITY, f64::min)
}

/// Revolutions of one scan that all its usable channels share, in the order of the angle, and the rejected ones.
fn scan_revolutions(
    setup: &MultiprobeSetup<'_>,
    filter: &ResampleFilter,
    step: &Step,
    index: usize,
    readings: &[&Reading],
) -> (Vec<ChannelRevolutions>, Vec<RejectedRevolutions>) {
    let channel = |name: &String| {
        let samples = channel_samples(setup, readings.iter().filter(|reading| reading.sensor == *name));
        let stops = stops_of_scan(setup, step);
        // A run resamples a continuous turn to equal angles before it stores the readings.
        match uses_dwell_sampling(setup) || stops.has_all_samples_at_stops(&samples) {
            true => stops.mean_at_stops(&samples),
            false => Resampler::resample_scan(filter, stops.ends_rad, &samples),
        }
    };
    let names = setup.layout.channels.iter().map(|channel| &channel.name);
    common_and_rejected_revolutions(index, &names.map(channel).collect::<Vec<_>>())
}

/// Deviations m = −value (see `model.rs`): a surface that moves towards a sensor decreases its value. Samples without a
/// value, with a flag other than `Gap`, or in a saturated range are marked invalid.
fn channel_samples<'r>(
    setup: &MultiprobeSetup<'_>,
    readings: impl Iterator<Item = &'r &'r Reading>,
) -> Vec<AngleSample> {
    let sample = |reading: &&Reading| AngleSample {
        angle_rad: reading.position.get_or_zero(setup.measured_axis),
        value: -reading.value_mm.unwrap_or(f64::NAN),
        is_valid: reading.value_mm.is_some() && matches!(reading.flag, ReadingFlag::None | ReadingFlag::Gap),
    };
    let mut samples: Vec<AngleSample> = readings.map(sample).collect();
    invalidate_saturated_samples(&mut samples);
    samples
}

impl ObservedRevolutions {
    fn record_rejected_revolutions(
        &mut self,
        setup: &MultiprobeSetup<'_>,
        step: &Step,
        rejected: Vec<RejectedRevolutions>,
    ) {
        for of_channel in rejected {
            let name = &setup.layout.channels[of_channel.channel_index].name;
            self.omission_descriptions.push(format!("{}: {name}: {of_channel}", step.label));
        }
    }

    /// Adds the rows of an index. Channels with missing revolutions are omitted.
    fn add_complete_rows(&mut self, setup: &MultiprobeSetup<'_>, index: usize, mut rows: Vec<ChannelRevolutions>) {
        for row in remove_channels_with_fewer_revolutions(&mut rows) {
            let name = &setup.layout.channels[row.channel_index].name;
            self.omission_descriptions.push(format!(
                "mounting {}: {name} is not used: its revolutions in one direction are incomplete",
                index + 1
            ));
        }
        self.all_rows.extend(rows);
    }
}
