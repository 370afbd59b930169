//! Readings to revolutions at equal angles.

use std::collections::BTreeSet;
use std::f64::consts::TAU;

use estimation::linear::{self, LinearProblem, RANK_THRESHOLD};
use faer::Mat;

use super::diagnosis::saturated_ranges;
use super::filter::ResampleFilter;
use super::harmonics::RowRevolutions;
use super::label::Label;
use super::layout::AngleRange;
use super::resample::{RejectedRevolutions, Resampled, Resampler, Sample, common_revolutions};
use super::settings::TurnSampling;
use super::setup::Setup;
use crate::IdentifyError;
use machine::record::plan::Step;
use machine::record::reading::{Flag, Reading};

/// Share of the stops of a revolution that may be missing at most.
const MAX_FILLED: f64 = 0.15;

/// What the readings show.
#[derive(Default)]
pub struct Observed {
    /// Each channel at each index.
    pub rows: Vec<RowRevolutions>,
    /// The same of the turns forward alone: these revolutions follow each other.
    pub forward: Vec<RowRevolutions>,
    /// What was left out, in words.
    pub left_out: Vec<String>,
    /// Dwell points of a channel without a distance.
    pub missing_stops: usize,
    /// Duration of one revolution, s.
    pub revolution_s: f64,
}

/// # Errors
/// A reading of no step of the plan; a mounting without a turn.
pub fn observed(setup: &Setup<'_>, readings: &[Reading]) -> Result<Observed, IdentifyError> {
    let known = |reading: &&Reading| setup.plan.steps.iter().any(|step| step.id == reading.step);
    if let Some(stray) = readings.iter().find(|reading| !known(reading)) {
        return Err(IdentifyError::UnknownStep { step: stray.step });
    }
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
            let (of_scan, rejected) = revolutions(setup, &filter, step, index, &own);
            observed.reject(setup, step, rejected);
            observed.missing_stops += missing_stops(setup, step, &own);
            if is_forward {
                observed.forward.extend(of_scan.iter().cloned());
                observed.revolution_s = duration_s(&own) / setup.settings.revolutions as f64;
            }
            join(&mut rows, of_scan);
        }
        observed.keep(setup, index, rows);
    }
    Ok(observed)
}

/// The readings of the last time that the step was measured.
fn latest<'r>(step: &Step, readings: &'r [Reading]) -> Result<Vec<&'r Reading>, IdentifyError> {
    let of_step = || readings.iter().filter(|reading| reading.step == step.id);
    let last = of_step().map(|reading| reading.repeat).max();
    let last =
        last.ok_or_else(|| IdentifyError::Missing { step: step.id, label: step.label.clone() })?;
    Ok(of_step().filter(|reading| reading.repeat == last).collect())
}

/// Pairs of stop and channel without any distance.
fn missing_stops(setup: &Setup<'_>, step: &Step, readings: &[&Reading]) -> usize {
    if setup.settings.sampling == TurnSampling::Continuous {
        return 0;
    }
    let stop = |reading: &Reading| {
        let degrees = reading.position.at(setup.axis).to_degrees();
        (degrees / 360.0 * setup.settings.positions as f64).round() as i64
    };
    let seen = readings.iter().filter(|reading| reading.value_mm.is_some());
    let seen: BTreeSet<(i64, &str)> = seen.map(|r| (stop(r), r.sensor.as_str())).collect();
    let stops = step.scan.as_ref().map_or(0, |scan| scan.path.len());
    (stops * setup.sensors.len()).saturating_sub(seen.len())
}

fn duration_s(readings: &[&Reading]) -> f64 {
    let times = readings.iter().map(|reading| reading.t_s);
    let [first, last] =
        times.fold([f64::MAX, f64::MIN], |[first, last], t| [first.min(t), last.max(t)]);
    (last - first).max(0.0)
}

/// Of one scan, those that all its usable channels share.
fn revolutions(
    setup: &Setup<'_>,
    filter: &ResampleFilter,
    step: &Step,
    index: usize,
    readings: &[&Reading],
) -> (Vec<RowRevolutions>, Vec<RejectedRevolutions>) {
    let channel = |name: &String| {
        let samples = samples(setup, readings.iter().filter(|reading| reading.sensor == *name));
        match setup.settings.sampling {
            TurnSampling::Dwell => stops(setup, step, &samples),
            TurnSampling::Continuous => {
                let [from, to] = [&step.from, &step.to].map(|end| end.at(setup.axis));
                let mut resampler = Resampler::new(filter, from, to);
                samples.iter().for_each(|sample| resampler.push(*sample));
                resampler.finish()
            }
        }
    };
    let names = setup.layout.channels.iter().map(|channel| &channel.name);
    common_revolutions(index, &names.map(channel).collect::<Vec<_>>())
}

/// What a channel stays at, at its largest or smallest value, is no measurement.
fn samples<'r>(setup: &Setup<'_>, readings: impl Iterator<Item = &'r &'r Reading>) -> Vec<Sample> {
    let sample = |reading: &&Reading| Sample {
        angle_rad: reading.position.at(setup.axis),
        value_mm: reading.value_mm.unwrap_or(f64::NAN),
        is_valid: reading.value_mm.is_some() && matches!(reading.flag, Flag::None | Flag::Gap),
    };
    let mut samples: Vec<Sample> = readings.map(sample).collect();
    let valid: Vec<Sample> = samples.iter().filter(|sample| sample.is_valid).copied().collect();
    let saturated = saturated_ranges(&valid);
    let is_in = |deg: f64| {
        saturated.iter().any(|AngleRange { from_deg, to_deg }| (*from_deg..=*to_deg).contains(&deg))
    };
    samples.iter_mut().for_each(|sample| sample.is_valid &= !is_in(sample.angle_rad.to_degrees()));
    samples
}

/// The mean at each stop; the few that lack, from the harmonics of all others about them.
fn stops(setup: &Setup<'_>, step: &Step, samples: &[Sample]) -> Resampled {
    let positions = setup.settings.positions;
    let number =
        |angle_rad: f64| (angle_rad.to_degrees() / 360.0 * positions as f64).round() as i64;
    let [one, other] = [&step.from, &step.to].map(|end| number(end.at(setup.axis)));
    let (first, last) = (one.min(other), one.max(other));
    let mut sums = vec![(0.0, 0.0); (last - first + 1) as usize];
    for sample in samples.iter().filter(|sample| sample.is_valid) {
        let cell = usize::try_from(number(sample.angle_rad) - first).ok();
        if let Some((sum, count)) = cell.and_then(|cell| sums.get_mut(cell)) {
            (*sum, *count) = (*sum + sample.value_mm, *count + 1.0);
        }
    }
    let mean = |(sum, count): (f64, f64)| (count > 0.0).then_some(sum / count);
    let mut values: Vec<Option<f64>> = sums.into_iter().map(mean).collect();
    let ends = values.chunks_mut(positions);
    ends.for_each(|revolution| fill(revolution, setup.settings.harmonics, positions));
    Resampled::of_stops(positions, first, values)
}

/// Fills single gaps of a revolution with the least squares of its mean and harmonics, so that its harmonics are
/// those of the stops that are there. A longer gap, or many, stay.
fn fill(values: &mut [Option<f64>], harmonics: usize, positions: usize) {
    let missing: Vec<usize> = (0..values.len()).filter(|i| values[*i].is_none()).collect();
    let known: Vec<usize> = (0..values.len()).filter(|i| values[*i].is_some()).collect();
    let longest = positions / (2 * harmonics.max(1));
    let is_long = missing.windows(longest + 1).any(|run| run[longest] - run[0] == longest);
    if missing.is_empty()
        || is_long
        || values.len() < positions
        || missing.len() > (MAX_FILLED * positions as f64) as usize
    {
        return;
    }
    let row = |i: usize, j: usize| {
        let phase = (j.div_ceil(2) * i) as f64 * TAU / positions as f64;
        if j.is_multiple_of(2) { phase.cos() } else { phase.sin() }
    };
    let design = Mat::from_fn(known.len(), 2 * harmonics + 1, |i, j| row(known[i], j));
    let problem = LinearProblem {
        a: design.as_ref(),
        y: &known.iter().filter_map(|i| values[*i]).collect::<Vec<f64>>(),
        sigma: &vec![1.0; known.len()],
        constraints: None,
        rank_threshold: RANK_THRESHOLD,
    };
    let Ok(solution) = linear::solve(&problem) else { return };
    for i in missing {
        values[i] = Some(solution.x.iter().enumerate().map(|(j, x)| x * row(i, j)).sum());
    }
}

/// The revolutions of another scan of the same index.
fn join(rows: &mut Vec<RowRevolutions>, more: Vec<RowRevolutions>) {
    for of_scan in more {
        match rows.iter_mut().find(|row| row.row == of_scan.row) {
            Some(row) => row.revolutions.extend(of_scan.revolutions),
            None => rows.push(of_scan),
        }
    }
}

impl Observed {
    fn reject(&mut self, setup: &Setup<'_>, step: &Step, rejected: Vec<RejectedRevolutions>) {
        for of_channel in rejected {
            let name = &setup.layout.channels[of_channel.channel].name;
            self.left_out.push(format!("{}: {name}: {of_channel}", step.label));
        }
    }

    /// The channels of an index must have as many revolutions: those that lack some are left out.
    fn keep(&mut self, setup: &Setup<'_>, index: usize, mut rows: Vec<RowRevolutions>) {
        let most = rows.iter().map(|row| row.revolutions.len()).max().unwrap_or(0);
        for row in rows.iter().filter(|row| row.revolutions.len() < most) {
            let name = &setup.layout.channels[row.row.channel].name;
            self.left_out.push(format!(
                "mounting {}: {name} is left out: it lacks whole revolutions in one direction",
                index + 1
            ));
        }
        rows.retain(|row| row.revolutions.len() == most);
        self.rows.extend(rows);
    }
}
