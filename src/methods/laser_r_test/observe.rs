//! Conversion of readings to means at dwell points, or in the cells of a continuous scan.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::latency::{LatencyEstimate, TimedScan, fit_latency};
use super::measured_scan::{MeasuredScan, SampleMean};
use super::position_history::PositionHistory;
use super::scan_cells::{average_samples_by_cell, describe_sparse_motions};
use super::scan_purpose::ScanPurpose;
use super::setup::LaserSetup;
use crate::decision::reference_check::largest_shift_limit_mm;
use crate::{IdentifyError, MethodRefusal};
use machine::Position;
use machine::record::plan::{FIRST_REPEAT_NUMBER_AFTER_STOP, Plan, Sampling, Step};
use machine::record::reading::{Reading, ReadingFlag};

/// Largest motion of an axis that counts as standing still, mm.
const MAX_STANDSTILL_MOTION_MM: f64 = 0.005;

/// All scans, and the data that was not used.
#[derive(Debug, Clone, Default)]
pub struct ObservedScans {
    /// Scans with usable data; continuous ones corrected for latency and lost motion.
    pub scans: Vec<MeasuredScan>,
    /// Descriptions of the scans without usable data, or whose data do not determine the centre.
    pub skipped_scans: Vec<String>,
    /// Number of unused samples by reason, without those of `unreliable_sample_count`.
    pub excluded_sample_counts_by_reason: BTreeMap<&'static str, usize>,
    /// Number of all samples of the newest repeats, used or not.
    pub sample_count: usize,
    /// Scatter of the samples at each dwell point and in each cell: Σ(sample − mean)² in mm², and its degrees of
    /// freedom.
    pub scatter_square_sum_and_dof: (f64, usize),
    /// Latency of the continuous scans. `None` if there are no continuous scans.
    pub latency: Option<LatencyEstimate>,
    /// Number of valid samples of continuous scans that are not used: near a reversal or at standstill of an axis, at
    /// an abrupt change of velocity, or without a position.
    pub unreliable_sample_count: usize,
    /// Interruptions with readings after them.
    pub interruptions: Vec<Interruption>,
    /// Descriptions of motions of continuous scans with too few samples.
    pub sparse_motions: Vec<String>,
    /// Times in s and axis positions X, Y, Z in mm of all readings, in the order of time.
    pub positions_by_time: Vec<(f64, Vector3<f64>)>,
}

/// Interruption of the measurement.
#[derive(Debug, Clone, Copy)]
pub struct Interruption {
    /// Time of the last reading before the interruption, on the clock of the run, s.
    pub time_in_run_s: f64,
    /// Largest shift that the check of the references after the interruption accepts, mm.
    pub shift_limit_mm: f64,
}

/// One measurement of the plan before the correction for latency and lost motion.
struct UncorrectedScan {
    /// The means of a continuous scan are empty until the correction.
    measured_scan: MeasuredScan,
    /// Samples of a continuous scan, and X, Y, Z of its path. `None`: the scan is not continuous.
    history_and_path: Option<(PositionHistory, Vec<Vector3<f64>>)>,
    /// Number of steps of the measurement: 1 for a scan, or the number of touches.
    step_count: usize,
}

impl ObservedScans {
    /// Standard deviation of one sample from the samples at dwell points and in cells, mm. `None`: no point or cell
    /// has two samples.
    pub fn sample_scatter_mm(&self) -> Option<f64> {
        let (squares, dof) = self.scatter_square_sum_and_dof;
        (dof > 0).then(|| (squares / dof as f64).sqrt())
    }

    pub fn describe_excluded_samples(&self) -> Option<String> {
        let count: usize = self.excluded_sample_counts_by_reason.values().sum();
        let counts: Vec<String> =
            self.excluded_sample_counts_by_reason.iter().map(|(why, count)| format!("{why} {count}")).collect();
        (count > 0).then(|| format!("{count} of {} samples were not used: {}", self.sample_count, counts.join(", ")))
    }
}

/// Reads the newest repeat of each scan of the plan (poses, heights, latency and search), without the references
/// measured again after a stop.
///
/// # Errors
/// A reading belongs to no step of the plan, the latency is not determined, or an interruption has no references
/// after it.
pub fn observe_scans(setup: &LaserSetup<'_>, readings: &[Reading]) -> Result<ObservedScans, IdentifyError> {
    IdentifyError::check_known_steps(setup.plan, readings)?;
    let mut of_step: BTreeMap<u32, Vec<&Reading>> = BTreeMap::new();
    for reading in readings.iter().filter(|reading| reading.repeat < FIRST_REPEAT_NUMBER_AFTER_STOP) {
        of_step.entry(reading.step).or_default().push(reading);
    }
    let mut observed = ObservedScans { positions_by_time: positions_by_time(readings), ..ObservedScans::default() };
    let mut uncorrected_scans: Vec<UncorrectedScan> = Vec::new();
    for steps in setup.plan.steps.chunk_by(|a, b| measurement_label(a) == measurement_label(b)) {
        let Some((first, purpose)) = steps.first().and_then(|s| Some((s, ScanPurpose::from_step_label(&s.label)?)))
        else {
            continue;
        };
        let newest = |step: &Step| of_step.get(&step.id).map(|all| readings_of_newest_repeat(all));
        let Some(all) = steps.iter().map(newest).collect::<Option<Vec<_>>>() else {
            observed.skipped_scans.push(format!("{}: no readings", measurement_label(first)));
            continue;
        };
        uncorrected_scans.push(read_uncorrected_scan(setup, first, purpose, steps.len(), &all.concat(), &mut observed));
    }
    observed.latency = estimate_latency(setup, &uncorrected_scans)?;
    observed.interruptions = find_interruptions(setup.plan, readings)?;
    for uncorrected_scan in uncorrected_scans {
        add_corrected_scan(setup, uncorrected_scan, &mut observed);
    }
    Ok(observed)
}

fn positions_by_time(readings: &[Reading]) -> Vec<(f64, Vector3<f64>)> {
    let mut path: Vec<_> = readings.iter().map(|r| (r.t_s, r.position.xyz_or_zero())).collect();
    path.sort_by(|a, b| a.0.total_cmp(&b.0));
    path
}

/// Interruptions with readings after them.
///
/// # Errors
/// The readings contain no references that were measured again after an interruption.
fn find_interruptions(plan: &Plan, readings: &[Reading]) -> Result<Vec<Interruption>, IdentifyError> {
    let ordinary: Vec<&Reading> = readings.iter().filter(|r| r.repeat < FIRST_REPEAT_NUMBER_AFTER_STOP).collect();
    let has_later_readings = |gap_s: &f64| ordinary.iter().any(|reading| reading.t_s > *gap_s);
    let with_limit = |gap_s: f64| match largest_shift_limit_mm(plan, readings, gap_s) {
        Some(shift_limit_mm) => Ok(Interruption { time_in_run_s: gap_s, shift_limit_mm }),
        None => Err(MethodRefusal::new(
            format!(
                "the run was interrupted {gap_s:.0} s after its start, and the readings contain no references after \
                 the interruption"
            ),
            format!(
                "take the readings as `trued export` writes them: those of references measured again have a repeat \
                 of {FIRST_REPEAT_NUMBER_AFTER_STOP} and more"
            ),
        )),
    };
    let times_s = plan.interruption_times_s.iter().copied().filter(has_later_readings);
    Ok(times_s.map(with_limit).collect::<Result<_, _>>()?)
}

/// Estimates the latency from the latency scans. `None`: there are no continuous scans.
fn estimate_latency(
    setup: &LaserSetup<'_>,
    uncorrected_scans: &[UncorrectedScan],
) -> Result<Option<LatencyEstimate>, IdentifyError> {
    if uncorrected_scans.iter().all(|uncorrected_scan| uncorrected_scan.history_and_path.is_none()) {
        return Ok(None);
    }
    let latency_scans = uncorrected_scans.iter().filter(|scan| scan.measured_scan.purpose == ScanPurpose::Latency);
    let timed = latency_scans.filter_map(|UncorrectedScan { measured_scan, history_and_path: history, .. }| {
        let (history, _) = history.as_ref()?;
        Some(TimedScan { scan: measured_scan, position_history: history })
    });
    fit_latency(setup, &timed.collect::<Vec<_>>()).map(Some)
}

/// Adds a measurement to `observed`, corrected for latency and lost motion.
fn add_corrected_scan(setup: &LaserSetup<'_>, uncorrected_scan: UncorrectedScan, observed: &mut ObservedScans) {
    let UncorrectedScan { mut measured_scan, history_and_path: history, step_count } = uncorrected_scan;
    if let (Some((history, path)), Some(latency)) = (&history, &observed.latency) {
        let mut samples = history.timed_samples(latency.latency_s);
        samples.iter_mut().for_each(|sample| sample.xyz = latency.corrected_xyz(sample.xyz, sample.last_motion_sign));
        observed.unreliable_sample_count += history.valid_reading_count() - samples.len();
        let sparse = describe_sparse_motions(path, &samples).into_iter();
        observed.sparse_motions.extend(sparse.map(|text| format!("{}: {text}", measured_scan.label)));
        let (sample_means, within) = average_samples_by_cell(setup, &measured_scan, &samples);
        measured_scan.sample_means = sample_means;
        observed.scatter_square_sum_and_dof.0 += within.0;
        observed.scatter_square_sum_and_dof.1 += within.1;
    }
    match measured_scan.sample_means.len() < step_count {
        true => observed.skipped_scans.push(format!("{}: no usable sample", measured_scan.label)),
        false => observed.scans.push(measured_scan),
    }
}

/// Label of the measurement of a step. A scan is a measurement of its own; the touches of one measurement share
/// their label.
fn measurement_label(step: &Step) -> &str {
    match step.scan {
        Some(_) => &step.label,
        None => step.label.rsplit_once('/').map_or(step.label.as_str(), |(label, _)| label),
    }
}

fn readings_of_newest_repeat<'a>(readings: &[&'a Reading]) -> Vec<&'a Reading> {
    let newest = readings.iter().map(|reading| reading.repeat).max();
    readings.iter().filter(|reading| Some(reading.repeat) == newest).copied().collect()
}

fn read_uncorrected_scan(
    setup: &LaserSetup<'_>,
    step: &Step,
    purpose: ScanPurpose,
    step_count: usize,
    readings: &[&Reading],
    observed: &mut ObservedScans,
) -> UncorrectedScan {
    let rotary = step.from.filter_axes(|axis| !axis.is_linear());
    let machine_from_xyz = setup.machine_from_xyz(&rotary);
    let mut samples: Vec<SampleMean> = Vec::new();
    for reading in readings {
        observed.sample_count += 1;
        // A touch has the distance 0.
        let reading_mm = if step.scan.is_some() { reading.value_mm } else { Some(0.0) };
        let Some(reading_mm) = reading_mm.filter(|_| reading.flag == ReadingFlag::None) else {
            let why = if reading.flag == ReadingFlag::None { "no value" } else { reading.flag.as_str() };
            *observed.excluded_sample_counts_by_reason.entry(why).or_default() += 1;
            continue;
        };
        let xyz = reading.position.xyz_or_zero();
        samples.push(SampleMean {
            linear_axis_positions_mm: xyz,
            spindle_displacement_from_table_mm: machine_from_xyz * xyz,
            reading_mm,
            sample_count: 1,
            time_in_run_s: reading.t_s,
            ..SampleMean::default()
        });
    }
    let continuous = step.scan.as_ref().filter(|scan| matches!(scan.sampling, Sampling::Continuous { .. }));
    let history_and_path =
        continuous.map(|scan| (PositionHistory::new(readings), scan.path.iter().map(Position::xyz_or_zero).collect()));
    let points = if continuous.is_some() { Vec::new() } else { group_into_points(step, samples) };
    let sample_means =
        points.iter().map(|all| average_samples(all, &mut observed.scatter_square_sum_and_dof)).collect();
    let (label, machine_from_spindle) = (measurement_label(step).to_owned(), setup.machine_from_spindle(&rotary));
    let measured_scan = MeasuredScan { purpose, label, machine_from_spindle, rotary_positions: rotary, sample_means };
    UncorrectedScan { measured_scan, history_and_path, step_count }
}

/// Groups samples of a step without continuous motion into points. Samples at unchanged axis positions belong to one
/// point; each touch is a point. The measured positions are used, not those of the plan, which may differ.
fn group_into_points(step: &Step, samples: Vec<SampleMean>) -> Vec<Vec<SampleMean>> {
    let mut points: Vec<Vec<SampleMean>> = Vec::new();
    for spot in samples {
        let xyz = spot.linear_axis_positions_mm;
        let is_same_point = |point: &&mut Vec<SampleMean>| {
            point[0].linear_axis_positions_mm.metric_distance(&xyz) < MAX_STANDSTILL_MOTION_MM
        };
        match points.last_mut().filter(is_same_point) {
            Some(point) if step.scan.is_some() => point.push(spot),
            _ => points.push(vec![spot]),
        }
    }
    points
}

/// Mean of the samples of one point; adds Σ(sample − mean)², mm², and its degrees of freedom to the second argument.
fn average_samples(all: &[SampleMean], square_sum_and_dof: &mut (f64, usize)) -> SampleMean {
    let count = all.len().max(1) as f64;
    let average = |pick: fn(&SampleMean) -> f64| all.iter().map(pick).sum::<f64>() / count;
    let sum = |pick: fn(&SampleMean) -> Vector3<f64>| all.iter().map(pick).sum::<Vector3<f64>>() / count;
    let reading_mm = average(|spot| spot.reading_mm);
    square_sum_and_dof.0 += all.iter().map(|spot| (spot.reading_mm - reading_mm).powi(2)).sum::<f64>();
    square_sum_and_dof.1 += all.len().saturating_sub(1);
    SampleMean {
        linear_axis_positions_mm: sum(|spot| spot.linear_axis_positions_mm),
        spindle_displacement_from_table_mm: sum(|spot| spot.spindle_displacement_from_table_mm),
        reading_mm,
        sample_count: all.len(),
        time_in_run_s: average(|spot| spot.time_in_run_s),
        ..SampleMean::default()
    }
}
