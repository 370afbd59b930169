//! From readings to revolutions at equal angles.

use estimation::revolutions::{
    RejectedRevolutions, ResampleFilter, Resampler, RowRevolutions, Sample, Stops,
    append_revolutions, common_revolutions, reject_saturated, split_incomplete,
};
use std::collections::BTreeSet;

use super::label::Label;
use super::settings::TurnSampling;
use super::setup::Setup;
use crate::{IdentifyError, latest};
use machine::record::plan::Step;
use machine::record::reading::{Flag, Reading};

/// Data extracted from the readings.
#[derive(Default)]
pub struct Observed {
    /// Revolutions of each channel at each index, in the order of time.
    pub rows: Vec<RowRevolutions>,
    /// Revolutions of the forward turns alone. These are consecutive.
    pub forward: Vec<RowRevolutions>,
    /// Descriptions of omitted data.
    pub left_out: Vec<String>,
    /// Number of dwell points of a channel without a distance.
    pub missing_stops: usize,
    /// Duration of one revolution, s.
    pub revolution_s: f64,
}

/// # Errors
/// A reading belongs to no step of the plan, or a mounting has no turn.
pub fn observed(setup: &Setup<'_>, readings: &[Reading]) -> Result<Observed, IdentifyError> {
    IdentifyError::check_steps(setup.plan, readings)?;
    let filter = ResampleFilter::new(setup.settings.positions);
    let mut observed = Observed::default();
    for index in 0..setup.settings.indexes {
        let mut rows: Vec<RowRevolutions> = Vec::new();
        for step in &setup.plan.steps {
            let is_forward = match step.label.parse() {
                Ok(Label::Forward(number)) if number == index + 1 => true,
                Ok(Label::Backward(number)) if number == index + 1 => false,
                _ => continue,
            };
            let own = latest(step, readings)?;
            let (mut of_scan, rejected) = revolutions(setup, &filter, step, index, &own);
            if !is_forward {
                // The revolutions come in the order of the angle.
                of_scan.iter_mut().for_each(|row| row.revolutions.reverse());
            }
            observed.reject(setup, step, rejected);
            observed.missing_stops += missing_stops(setup, step, &own);
            if is_forward {
                observed.forward.extend(of_scan.iter().cloned());
                observed.revolution_s = duration_s(&own) / setup.settings.revolutions as f64;
            }
            append_revolutions(&mut rows, of_scan);
        }
        observed.keep(setup, index, rows);
    }
    Ok(observed)
}

/// Number of pairs of stop and channel without any distance.
fn missing_stops(setup: &Setup<'_>, step: &Step, readings: &[&Reading]) -> usize {
    if !is_dwell(setup) {
        return 0;
    }
    let stop = |reading: &Reading| stops(setup, step).number(reading.position.at(setup.axis));
    let seen = readings.iter().filter(|reading| reading.value_mm.is_some());
    let seen: BTreeSet<(i64, &str)> = seen.map(|r| (stop(r), r.sensor.as_str())).collect();
    let stops = step.scan.as_ref().map_or(0, |scan| scan.path.len());
    (stops * setup.plan.sensors.len()).saturating_sub(seen.len())
}

fn is_dwell(setup: &Setup<'_>) -> bool {
    setup.settings.sampling == TurnSampling::Dwell
}

fn stops(setup: &Setup<'_>, step: &Step) -> Stops {
    Stops {
        steps: setup.settings.positions,
        ends_rad: [&step.from, &step.to].map(|end| end.at(setup.axis)),
        filled_with: is_dwell(setup).then_some(setup.settings.harmonics),
    }
}

fn duration_s(readings: &[&Reading]) -> f64 {
    let times = || readings.iter().map(|reading| reading.t_s);
    times().fold(f64::NEG_INFINITY, f64::max) - times().fold(f64::INFINITY, f64::min)
}

/// Revolutions of one scan that all its usable channels share.
fn revolutions(
    setup: &Setup<'_>,
    filter: &ResampleFilter,
    step: &Step,
    index: usize,
    readings: &[&Reading],
) -> (Vec<RowRevolutions>, Vec<RejectedRevolutions>) {
    let channel = |name: &String| {
        let samples = samples(setup, readings.iter().filter(|reading| reading.sensor == *name));
        let stops = stops(setup, step);
        // A run resamples a continuous turn to equal angles before it stores the readings.
        match is_dwell(setup) || stops.contain_all(&samples) {
            true => stops.means(&samples),
            false => Resampler::of_turn(filter, stops.ends_rad, &samples),
        }
    };
    let names = setup.layout.channels.iter().map(|channel| &channel.name);
    common_revolutions(index, &names.map(channel).collect::<Vec<_>>())
}

/// Deviations m = −value (see `model.rs`): a surface that moves towards a sensor decreases its value.
fn samples<'r>(setup: &Setup<'_>, readings: impl Iterator<Item = &'r &'r Reading>) -> Vec<Sample> {
    let sample = |reading: &&Reading| Sample {
        angle_rad: reading.position.at(setup.axis),
        value: -reading.value_mm.unwrap_or(f64::NAN),
        is_valid: reading.value_mm.is_some() && matches!(reading.flag, Flag::None | Flag::Gap),
    };
    let mut samples: Vec<Sample> = readings.map(sample).collect();
    reject_saturated(&mut samples);
    samples
}

impl Observed {
    fn reject(&mut self, setup: &Setup<'_>, step: &Step, rejected: Vec<RejectedRevolutions>) {
        for of_channel in rejected {
            let name = &setup.layout.channels[of_channel.channel].name;
            self.left_out.push(format!("{}: {name}: {of_channel}", step.label));
        }
    }

    /// Adds the rows of an index. Channels with missing revolutions are omitted.
    fn keep(&mut self, setup: &Setup<'_>, index: usize, mut rows: Vec<RowRevolutions>) {
        for row in split_incomplete(&mut rows) {
            let name = &setup.layout.channels[row.channel].name;
            self.left_out.push(format!(
                "mounting {}: {name} is left out: it lacks whole revolutions in one direction",
                index + 1
            ));
        }
        self.rows.extend(rows);
    }
}
