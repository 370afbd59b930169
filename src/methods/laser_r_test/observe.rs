//! From readings to dwell points, or to cells of a continuous scan (see `cells.rs`).

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::bench::LaserSetup;
use super::cells::{cells, thin_ways};
use super::label::Pass;
use super::latency::{Latency, Timed, fit};
use super::spots::{Scanned, Spot};
use super::track::PositionHistory;
use crate::decision::reference_check::granted_mm;
use crate::{IdentifyError, Refused};
use machine::Position;
use machine::record::plan::{Plan, REPEAT_AFTER_STOP, Sampling, Scan, Step};
use machine::record::reading::{Flag, Reading};

/// Largest motion of an axis that counts as standing still, mm.
const STANDS_MM: f64 = 0.005;

/// All scans, and the data that was not used.
#[derive(Debug, Clone, Default)]
pub struct Observed {
    pub scans: Vec<Scanned>,
    /// Descriptions of the steps that contain no usable data.
    pub left_out: Vec<String>,
    /// Number of unused samples by reason.
    pub excluded: BTreeMap<&'static str, usize>,
    pub samples: usize,
    /// Scatter within dwell points and cells: Σ(sample less mean)² in mm², and its degrees of freedom.
    pub within: (f64, usize),
    /// Latency of the continuous scans. `None` if there are no continuous scans.
    pub latency: Option<Latency>,
    /// Number of samples of continuous scans at a reversal of an axis, or without a position.
    pub turning: usize,
    /// Interruptions of the measurement: time in s, and limit of the reference check in mm.
    pub stops: Vec<(f64, f64)>,
    /// Descriptions of motions of continuous scans with too few samples.
    pub thin: Vec<String>,
    /// Times in s and axis positions X, Y, Z in mm of all readings, in the order of time.
    pub path: Vec<(f64, Vector3<f64>)>,
}

/// One measurement of the plan with its usable data.
struct UncorrectedScan {
    scanned: Scanned,
    /// Samples of a continuous scan, and X, Y, Z of its path.
    track: Option<(PositionHistory, Vec<Vector3<f64>>)>,
    steps: usize,
}

impl Observed {
    /// Standard deviation of one sample from the samples at dwell points, mm.
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

/// Reads the newest readings of each scan of the plan: poses, heights and search.
///
/// # Errors
/// A reading belongs to no step of the plan.
pub fn observe(bench: &LaserSetup<'_>, readings: &[Reading]) -> Result<Observed, IdentifyError> {
    IdentifyError::check_steps(bench.plan, readings)?;
    let mut of_step: BTreeMap<u32, Vec<&Reading>> = BTreeMap::new();
    for reading in readings.iter().filter(|reading| reading.repeat < REPEAT_AFTER_STOP) {
        of_step.entry(reading.step).or_default().push(reading);
    }
    let mut observed = Observed { path: path(readings), ..Observed::default() };
    let mut raws: Vec<UncorrectedScan> = Vec::new();
    for steps in bench.plan.steps.chunk_by(|one, other| measurement(one) == measurement(other)) {
        let Some((first, pass)) = steps.first().and_then(|s| Some((s, Pass::of(&s.label)?))) else {
            continue;
        };
        let newest = |step: &Step| of_step.get(&step.id).map(|all| newest(all));
        let Some(all) = steps.iter().map(newest).collect::<Option<Vec<_>>>() else {
            observed.left_out.push(format!("{}: no readings", measurement(first)));
            continue;
        };
        raws.push(raw(bench, (first, pass, steps.len()), &all.concat(), &mut observed));
    }
    observed.latency = latency(bench, &raws)?;
    observed.stops = stops(bench.plan, readings)?;
    for raw in raws {
        placed(bench, raw, &mut observed);
    }
    Ok(observed)
}

fn path(readings: &[Reading]) -> Vec<(f64, Vector3<f64>)> {
    let mut path: Vec<_> = readings.iter().map(|r| (r.t_s, r.position.xyz())).collect();
    path.sort_by(|one, other| one.0.total_cmp(&other.0));
    path
}

/// Times and limits of the interruptions. The limit is that of the reference measurements after the interruption.
fn stops(plan: &Plan, readings: &[Reading]) -> Result<Vec<(f64, f64)>, IdentifyError> {
    let ordinary = |reading: &&Reading| reading.repeat < REPEAT_AFTER_STOP;
    let goes_on = |gap_s: f64| readings.iter().filter(ordinary).any(|reading| reading.t_s > gap_s);
    let granted = |gap_s: f64| {
        let unseen = || Refused {
            why: format!(
                "the run was interrupted {gap_s:.0} s after it began, and there are no readings of its \
                 references from after that"
            ),
            instead: format!(
                "take the readings as `trued export` writes them: those of references measured again have \
                 a repeat of {REPEAT_AFTER_STOP} and more"
            ),
        };
        granted_mm(plan, readings, gap_s).map(|mm| (gap_s, mm)).ok_or_else(unseen)
    };
    let stops = plan.gaps_s.iter().copied().filter(|gap_s| goes_on(*gap_s)).map(granted);
    stops.collect::<Result<_, _>>().map_err(IdentifyError::Refused)
}

/// Estimates the latency from the latency scans.
fn latency(
    bench: &LaserSetup<'_>,
    raws: &[UncorrectedScan],
) -> Result<Option<Latency>, IdentifyError> {
    let timed = raws.iter().filter_map(|UncorrectedScan { scanned, track, .. }| {
        let track = track.as_ref().filter(|_| scanned.pass == Pass::Latency);
        let travel = bench.travel(&scanned.rotary);
        track.map(|(track, _)| Timed { travel, spindle: scanned.spindle, track })
    });
    let timed: Vec<Timed<'_>> = timed.collect();
    let continuous = raws.iter().any(|raw| raw.track.is_some());
    if continuous { fit(bench, &timed).map(Some) } else { Ok(None) }
}

/// Adds a measurement to `observed`, corrected for latency and lost motion.
fn placed(bench: &LaserSetup<'_>, raw: UncorrectedScan, observed: &mut Observed) {
    let UncorrectedScan { mut scanned, track, steps } = raw;
    if let (Some((track, path)), Some(latency)) = (&track, &observed.latency) {
        let mut seen = track.seen(latency.tau_s);
        seen.iter_mut().for_each(|one| one.xyz = latency.true_xyz(one.xyz, one.last_motion_sign));
        observed.turning += track.said() - seen.len();
        let thin = thin_ways(path, &seen).into_iter();
        observed.thin.extend(thin.map(|words| format!("{}: {words}", scanned.label)));
        let (spots, within) = cells(bench, &scanned, &seen);
        scanned.spots = spots;
        observed.within.0 += within.0;
        observed.within.1 += within.1;
    }
    match scanned.spots.len() < steps {
        true => observed.left_out.push(format!("{}: no sample that could be used", scanned.label)),
        false => observed.scans.push(scanned),
    }
}

/// Label of the measurement of a step. A scan is a measurement of its own; the touches of one measurement share
/// their label.
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

fn raw(
    bench: &LaserSetup<'_>,
    (step, pass, steps): (&Step, Pass, usize),
    readings: &[&Reading],
    observed: &mut Observed,
) -> UncorrectedScan {
    let rotary = step.from.only(|axis| !axis.is_linear());
    let travel = bench.travel(&rotary);
    let mut spots: Vec<Spot> = Vec::new();
    for reading in readings {
        observed.samples += 1;
        // A touch has the distance 0.
        let value = if step.scan.is_some() { reading.value_mm } else { Some(0.0) };
        let Some(value) = value.filter(|_| reading.flag == Flag::None) else {
            let why = if reading.flag == Flag::None { "no value" } else { reading.flag.as_str() };
            *observed.excluded.entry(why).or_default() += 1;
            continue;
        };
        let xyz = reading.position.xyz();
        let (velocity, last_motion_sign) = (Vector3::zeros(), Vector3::zeros());
        let (at, t_s) = (travel * xyz, reading.t_s);
        spots.push(Spot { xyz, at, value, samples: 1, t_s, velocity, last_motion_sign });
    }
    let track = step.scan.as_ref().filter(|scan| on_the_way(scan)).map(|scan| {
        (PositionHistory::new(readings), scan.path.iter().map(Position::xyz).collect())
    });
    let points = if track.is_some() { Vec::new() } else { points(step, spots) };
    let spots = points.iter().map(|all| mean(all, &mut observed.within)).collect();
    let (label, spindle) = (measurement(step).to_owned(), bench.spindle(&rotary));
    UncorrectedScan { scanned: Scanned { pass, label, spindle, rotary, spots }, track, steps }
}

fn on_the_way(scan: &Scan) -> bool {
    matches!(scan.sampling, Sampling::Continuous { .. })
}

/// Groups samples into points. Samples at unchanged axis positions belong to one point; each touch is a point. The
/// measured positions are used, not those of the plan, which may differ.
fn points(step: &Step, spots: Vec<Spot>) -> Vec<Vec<Spot>> {
    let dwells = |scan: &Scan| matches!(scan.sampling, Sampling::Dwell { .. });
    let mut points: Vec<Vec<Spot>> = Vec::new();
    for spot in spots {
        let stands = |point: &&mut Vec<Spot>| {
            let first = point.first();
            first.is_some_and(|first| first.xyz.metric_distance(&spot.xyz) < STANDS_MM)
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
    let sum = |pick: fn(&Spot) -> Vector3<f64>| all.iter().map(pick).sum::<Vector3<f64>>() / count;
    let value = of(|spot| spot.value);
    within.0 += all.iter().map(|spot| (spot.value - value).powi(2)).sum::<f64>();
    within.1 += all.len().saturating_sub(1);
    Spot {
        xyz: sum(|spot| spot.xyz),
        at: sum(|spot| spot.at),
        value,
        samples: all.len(),
        t_s: of(|spot| spot.t_s),
        velocity: Vector3::zeros(),
        last_motion_sign: Vector3::zeros(),
    }
}
