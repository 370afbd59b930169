//! From readings to observations at the grid angles: positions of the ball centre along and across each ray.

use std::f64::consts::{PI, TAU};

use super::design::AngleGridDesign;
use super::interruptions;
use super::model::RadiusObservation;
use super::plan::{LOCATE_LABEL_PREFIX, is_top_touch};
use super::setup::SelfCalibrationSetup;
use crate::IdentifyError;
use machine::record::plan::{Plan, Step};
use machine::record::reading::{Reading, ReadingFlag};
use planning::SafeHeights;

/// The observations of the flank touches of a run, with their common data. Readings of locating and top touches,
/// flagged readings and readings in too short segments are left out.
pub struct ObservedReadings {
    pub observations: Vec<RadiusObservation>,
    /// Half the duration of the measurement, without interruptions, s: the unit of
    /// [`RadiusObservation::relative_time`]. Without times, half the planned machine time.
    pub half_duration_s: f64,
    /// Whether the readings have times. If not, their order and the planned machine time are used.
    pub has_times: bool,
    /// Times of the interruptions, on the scale of [`RadiusObservation::relative_time`].
    pub interruption_times: Vec<f64>,
    /// Number of readings that are not used: too few directions were touched between their interruptions.
    pub short_segment_reading_count: usize,
}

/// Largest deviation of the table from its planned angle, rad (0.1°). A larger deviation is treated as a skipped index
/// position.
const TABLE_ANGLE_TOLERANCE_RAD: f64 = 1.8e-3;
/// Largest deviation of an angle of the plan from the grid, in steps of the grid.
const GRID_TOLERANCE_STEPS: f64 = 1.8e-3;

/// # Errors
/// A step has no reading, a reading has no step, a reading occurs twice, all readings are flagged, a step is not on the
/// grid, the table was not at the planned angle, or the run was interrupted and the readings have no times.
pub fn extract_observations(
    setup: &SelfCalibrationSetup<'_>,
    readings: &[Reading],
) -> Result<ObservedReadings, IdentifyError> {
    let plan = setup.plan;
    IdentifyError::check_known_and_unique(plan, readings)?;
    let (mut observations, mut order) = (Vec::new(), Vec::new());
    let steps_after_locating = plan.steps.iter().filter(|step| !step.label.starts_with(LOCATE_LABEL_PREFIX));
    for (i, step) in steps_after_locating.enumerate() {
        let of_step: Vec<&Reading> = readings.iter().filter(|reading| reading.step == step.id).collect();
        if of_step.is_empty() {
            return Err(IdentifyError::missing_reading(step));
        }
        if is_top_touch(step) {
            continue;
        }
        for reading in of_step.iter().filter(|reading| reading.flag == ReadingFlag::None) {
            observations.push(reduce_reading(setup, step, reading)?);
            order.push((reading.repeat as usize * plan.steps.len() + i) as f64);
        }
    }
    if observations.is_empty() {
        return Err(IdentifyError::IdentificationFailed("all readings are flagged".to_owned()));
    }
    let (mut interruption_times, short_segment_reading_count) =
        interruptions::remove_interruptions(&mut observations, &plan.interruption_times_s)?;
    let mut half_duration_s = scale_times(&mut observations, &mut interruption_times);
    let has_times = half_duration_s > 0.0;
    if !has_times {
        for (observation, place) in observations.iter_mut().zip(order) {
            observation.relative_time = place;
        }
        scale_times(&mut observations, &mut []);
        half_duration_s = planned_duration_s(plan) / 2.0;
    }
    Ok(ObservedReadings { observations, half_duration_s, has_times, interruption_times, short_segment_reading_count })
}

/// Machine time of the plan, s, or 5 s per touch if it cannot be planned.
fn planned_duration_s(plan: &Plan) -> f64 {
    SafeHeights::above_plan_artefact(plan)
        .and_then(|safe_heights| planning::plan_blocks_and_time_s(plan, &safe_heights))
        .map_or(5.0 * plan.steps.len() as f64, |(_, seconds)| seconds)
}

/// The observation of a reading, without the known error motions. The grid indices follow from the planned angles.
/// Error: the table was not at the planned angle, or the step is not on the grid.
fn reduce_reading(
    setup: &SelfCalibrationSetup<'_>,
    step: &Step,
    reading: &Reading,
) -> Result<RadiusObservation, IdentifyError> {
    let SelfCalibrationSetup { design, axis, heights_in_machine_mm: heights, known_motions, .. } = setup;
    let name = axis.axis;
    let planned = step.from.get_or_zero(name);
    let actual = reading.position.get(name).unwrap_or(planned);
    // Full turns are ignored: a control may count them differently.
    let off = (actual - planned + PI).rem_euclid(TAU) - PI;
    if off.abs() > TABLE_ANGLE_TOLERANCE_RAD {
        return Err(IdentifyError::IdentificationFailed(format!(
            "step {} ({}): {name} was at {:.4}° instead of {:.4}°; check for a skipped index position",
            step.id,
            step.label,
            actual.to_degrees(),
            planned.to_degrees()
        )));
    }
    let [nx, ny, _] = step.normal;
    let phi = ny.atan2(nx);
    if (nx.hypot(ny) - 1.0).abs() > 1e-3 || !is_on_grid(design, phi) || !is_on_grid(design, planned) {
        return Err(IdentifyError::IdentificationFailed(format!(
            "step {} ({}): `normal` or {name} is not on the grid of {} positions",
            step.id, step.label, design.angle_count
        )));
    }
    let centre = axis.corrected_ball_centre(step, reading, known_motions);
    let height = nearest_height_index(heights, centre.z);
    let off = centre - axis.axis_point_at_height(heights[height]);
    Ok(RadiusObservation {
        step_id: step.id,
        height_index: height,
        c_index: grid_index_from_rad(design, planned * axis.clockwise_sign),
        phi_index: grid_index_from_rad(design, phi),
        along_ray_mm: off.x * nx + off.y * ny,
        across_ray_mm: -off.x * ny + off.y * nx,
        time_s: reading.t_s,
        relative_time: reading.t_s,
    })
}

fn is_on_grid(design: &AngleGridDesign, angle: f64) -> bool {
    let index = angle / TAU * design.angle_count as f64;
    (index - index.round()).abs() < GRID_TOLERANCE_STEPS
}

fn grid_index_from_rad(design: &AngleGridDesign, angle: f64) -> usize {
    let index = (angle / TAU * design.angle_count as f64).round() as i64;
    index.rem_euclid(design.angle_count as i64) as usize
}

fn nearest_height_index(heights: &[f64], z: f64) -> usize {
    let distance = |i: &usize| (heights[*i] - z).abs();
    (0..heights.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
}

/// Scales the times to −1 … 1 around the middle of the measurement. Returns half its duration, s; if all times are
/// equal, 0, and all times become 0.
fn scale_times(observations: &mut [RadiusObservation], interruption_times: &mut [f64]) -> f64 {
    let times = || observations.iter().map(|observation| observation.relative_time);
    let first = times().fold(f64::INFINITY, f64::min);
    let last = times().fold(f64::NEG_INFINITY, f64::max);
    let half = if last > first { (last - first) / 2.0 } else { 0.0 };
    for time in observations.iter_mut().map(|observation| &mut observation.relative_time).chain(interruption_times) {
        *time = if half > 0.0 { (*time - first - half) / half } else { 0.0 };
    }
    half
}
