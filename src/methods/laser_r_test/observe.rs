//! Readings → dwell points.

use std::collections::BTreeMap;

use glam::{DMat3, DVec3};

use super::bench::Bench;
use super::label::Pass;
use super::model::linear;
use crate::base::Position;
use crate::methods::IdentifyError;
use crate::record::plan::{REPEAT_AFTER_STOP, Sampling, Scan, Step};
use crate::record::reading::{Flag, Reading};

/// Axes that move less than this stand, mm.
const STANDS_MM: f64 = 0.005;

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
    for steps in bench.plan.steps.chunk_by(|one, other| measurement(one) == measurement(other)) {
        let Some((first, pass)) = steps.first().and_then(|s| Some((s, Pass::of(&s.label)?))) else {
            continue;
        };
        let label = measurement(first);
        let newest = |step: &Step| of_step.get(&step.id).map(|all| newest(all));
        let Some(all) = steps.iter().map(newest).collect::<Option<Vec<_>>>() else {
            observed.left_out.push(format!("{label}: no readings"));
            continue;
        };
        let scanned = scanned(bench, (first, pass), &all.concat(), &mut observed);
        if scanned.spots.len() < steps.len() {
            observed.left_out.push(format!("{label}: no sample that could be used"));
        } else {
            observed.scans.push(scanned);
        }
    }
    Ok(observed)
}

/// What a step belongs to: a scan is a measurement by itself, touches share theirs.
fn measurement(step: &Step) -> &str {
    match step.scan {
        Some(_) => &step.label,
        None => step.label.rsplit_once('/').map_or(step.label.as_str(), |(of, _)| of),
    }
}

fn newest<'a>(readings: &[&'a Reading]) -> Vec<&'a Reading> {
    let newest = readings.iter().map(|reading| reading.repeat).max();
    readings.iter().filter(|reading| Some(reading.repeat) == newest).copied().collect()
}

fn scanned(
    bench: &Bench<'_>,
    (step, pass): (&Step, Pass),
    readings: &[&Reading],
    observed: &mut Observed,
) -> Scanned {
    let rotary = step.from.only(|axis| !axis.is_linear());
    let travel = bench.travel(&rotary);
    let mut spots: Vec<Spot> = Vec::new();
    for reading in readings {
        observed.samples += 1;
        // A touch is at no distance.
        let value = if step.scan.is_some() { reading.value_mm } else { Some(0.0) };
        let Some(value) = value.filter(|_| reading.flag == Flag::None) else {
            let why = if reading.flag == Flag::None { "no value" } else { reading.flag.as_str() };
            *observed.excluded.entry(why).or_default() += 1;
            continue;
        };
        let xyz = linear(&reading.position);
        let spot = Spot { xyz, at: travel * xyz, value, samples: 1, t_s: reading.t_s };
        spots.push(spot);
    }
    let points = points(step, spots);
    let spots = points.iter().map(|all| mean(all, &mut observed.within)).collect();
    Scanned {
        pass,
        label: measurement(step).to_owned(),
        spindle: bench.spindle(&rotary),
        rotary,
        spots,
    }
}

/// Samples are of one point as long as the axes stand; on the way, and of touches, each is by itself.
/// Where the axes stood decides, not the plan: its points may have been others when it was measured.
fn points(step: &Step, spots: Vec<Spot>) -> Vec<Vec<Spot>> {
    let dwells = |scan: &Scan| matches!(scan.sampling, Sampling::Dwell { .. });
    let mut points: Vec<Vec<Spot>> = Vec::new();
    for spot in spots {
        let stands = |point: &&mut Vec<Spot>| {
            let first = point.first();
            first.is_some_and(|first| first.xyz.distance(spot.xyz) < STANDS_MM)
        };
        match points.last_mut().filter(stands) {
            Some(point) if step.scan.as_ref().is_some_and(dwells) => point.push(spot),
            _ => points.push(vec![spot]),
        }
    }
    points
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
