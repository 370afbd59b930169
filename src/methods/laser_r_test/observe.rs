//! Readings → dwell points.

use std::collections::BTreeMap;

use glam::{DMat3, DVec3};

use super::bench::Bench;
use super::label::Pass;
use super::model::linear;
use crate::base::Position;
use crate::methods::IdentifyError;
use crate::record::plan::{REPEAT_AFTER_STOP, Sampling, Step};
use crate::record::reading::{Flag, Reading};

/// One place at which samples were taken, their mean.
#[derive(Debug, Clone, Copy)]
pub struct Spot {
    /// X, Y, Z.
    pub xyz: DVec3,
    /// The same as how far the spindle stands from the table, machine frame.
    pub at: DVec3,
    /// Reading.
    pub value: f64,
    pub samples: usize,
    pub t_s: f64,
}

/// One step's dwell points. The rotary axes stand.
#[derive(Debug, Clone)]
pub struct Scanned {
    pub pass: Pass,
    pub label: String,
    /// All rotary axes.
    pub rotary: Position,
    /// Spindle frame to machine frame.
    pub spindle: DMat3,
    pub spots: Vec<Spot>,
}

/// All scans, and what was not used.
#[derive(Debug, Clone, Default)]
pub struct Observed {
    pub scans: Vec<Scanned>,
    /// Steps without anything to identify from, in words.
    pub left_out: Vec<String>,
    /// Samples by why they were not used.
    pub excluded: BTreeMap<&'static str, usize>,
    pub samples: usize,
    /// Within dwell points: Σ(sample less mean)² in mm², and its degrees of freedom.
    pub within: (f64, usize),
}

impl Observed {
    /// Standard deviation of one sample as the samples at dwell points show it, mm.
    pub fn scatter_mm(&self) -> Option<f64> {
        let (squares, dof) = self.within;
        (dof > 0).then(|| (squares / dof as f64).sqrt())
    }

    pub fn excluded_in_words(&self) -> Option<String> {
        let count: usize = self.excluded.values().sum();
        let of = self.excluded.iter().map(|(why, count)| format!("{why} {count}"));
        let of: Vec<String> = of.collect();
        (count > 0).then(|| {
            format!("{count} of {} samples were not used: {}", self.samples, of.join(", "))
        })
    }
}

/// The newest readings of each scan of the plan, whether of poses, heights or the search.
///
/// # Errors
/// A reading of no step of the plan.
pub fn observe(bench: &Bench<'_>, readings: &[Reading]) -> Result<Observed, IdentifyError> {
    let mut of_step: BTreeMap<u32, Vec<&Reading>> = BTreeMap::new();
    for reading in readings.iter().filter(|reading| reading.repeat < REPEAT_AFTER_STOP) {
        of_step.entry(reading.step).or_default().push(reading);
    }
    let known = |id: &u32| bench.plan.steps.iter().any(|step| step.id == *id);
    if let Some(step) = of_step.keys().find(|id| !known(id)) {
        return Err(IdentifyError::UnknownStep { step: *step });
    }
    let mut observed = Observed::default();
    for step in &bench.plan.steps {
        let (Some(pass), Some(_)) = (Pass::of(&step.label), &step.scan) else { continue };
        let Some(readings) = of_step.get(&step.id) else {
            observed.left_out.push(format!("{}: no readings", step.label));
            continue;
        };
        let newest = readings.iter().map(|reading| reading.repeat).max();
        let newest = readings.iter().filter(|reading| Some(reading.repeat) == newest);
        let scanned = scanned(bench, step, pass, newest.copied(), &mut observed);
        if scanned.spots.is_empty() {
            observed.left_out.push(format!("{}: no sample that could be used", step.label));
        } else {
            observed.scans.push(scanned);
        }
    }
    Ok(observed)
}

fn scanned<'a>(
    bench: &Bench<'_>,
    step: &Step,
    pass: Pass,
    readings: impl Iterator<Item = &'a Reading>,
    observed: &mut Observed,
) -> Scanned {
    let rotary = step.from.only(|axis| !axis.is_linear());
    let travel = bench.travel(&rotary);
    let mut bins: BTreeMap<usize, Vec<Spot>> = BTreeMap::new();
    for (count, reading) in readings.enumerate() {
        observed.samples += 1;
        let Some(value) = reading.value_mm.filter(|_| reading.flag == Flag::None) else {
            let why = if reading.flag == Flag::None { "no value" } else { reading.flag.as_str() };
            *observed.excluded.entry(why).or_default() += 1;
            continue;
        };
        let xyz = linear(&reading.position);
        let spot = Spot { xyz, at: travel * xyz, value, samples: 1, t_s: reading.t_s };
        bins.entry(bin(step, xyz, count)).or_default().push(spot);
    }
    let spots = bins.into_values().map(|all| mean(&all, &mut observed.within)).collect();
    Scanned { pass, label: step.label.clone(), spindle: bench.spindle(&rotary), rotary, spots }
}

/// Which samples are of one point: at dwells the nearest of the path, on the way each by itself.
fn bin(step: &Step, xyz: DVec3, count: usize) -> usize {
    let Some(scan) = &step.scan else { return count };
    if let Sampling::Continuous { .. } = scan.sampling {
        return count;
    }
    let away = |at: &Position| linear(at).distance_squared(xyz);
    let points = scan.path.iter().enumerate();
    points.min_by(|a, b| away(a.1).total_cmp(&away(b.1))).map_or(count, |(index, _)| index)
}

fn mean(all: &[Spot], within: &mut (f64, usize)) -> Spot {
    let count = all.len().max(1) as f64;
    let of = |pick: fn(&Spot) -> f64| all.iter().map(pick).sum::<f64>() / count;
    let sum = |pick: fn(&Spot) -> DVec3| all.iter().map(pick).sum::<DVec3>() / count;
    let value = of(|spot| spot.value);
    within.0 += all.iter().map(|spot| (spot.value - value).powi(2)).sum::<f64>();
    within.1 += all.len().saturating_sub(1);
    Spot {
        xyz: sum(|spot| spot.xyz),
        at: sum(|spot| spot.at),
        value,
        samples: all.len(),
        t_s: of(|spot| spot.t_s),
    }
}
