//! Computes the distances of the stylus centre from the ball centre from the readings.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;

use super::setup::{QualificationSetup, SEARCH_LABEL_PREFIX};
use crate::{IdentifyError, MethodRefusal};
use estimation::sphere::fit_sphere;
use machine::frame::Point;
use machine::record::plan::Step;
use machine::record::reading::{Reading, ReadingFlag};
use machine::{Axis, Position};

/// One touch.
#[derive(Debug, Clone)]
pub struct MeasuredTouch {
    pub label: String,
    /// Unit vector from the centre of the fitted sphere to the stylus centre, machine frame.
    pub normal_in_machine: Vector3<f64>,
    /// The same unit vector in the spindle frame.
    pub normal_in_spindle: Vector3<f64>,
    /// Distance of the stylus centre from the centre of the sphere fitted to the slow touches, minus both stated
    /// radii, mm.
    pub radial_deviation_mm: f64,
    /// Axis positions X, Y and Z, mm.
    pub axis_positions_mm: Vector3<f64>,
    /// Whether the feed is greater than the measuring feed.
    pub is_fast: bool,
    /// Index of the nearest orientation in [`ObservedTouches::spindle_orientations_deg`].
    pub spindle_orientation_index: usize,
    /// Time of the touch on the clock of the run, s.
    pub time_in_run_s: f64,
    /// Number of interruptions before the touch.
    pub earlier_interruption_count: usize,
    /// Index of the group: touches of one direction, orientation, feed and part of the run between interruptions.
    pub group_index: usize,
}

/// Slow and fast touches of one ball, with all repeats, without search touches and flagged readings.
pub struct ObservedTouches {
    pub touches: Vec<MeasuredTouch>,
    /// Orientations of the spindle, degrees. Only 0 if the spindle is not turned.
    pub spindle_orientations_deg: Vec<f64>,
    /// Speed of slow and of fast touches, mm/s.
    pub speeds_mm_s: [f64; 2],
    /// Sum of the stated radii of ball and stylus ball, mm.
    pub stated_radius_sum_mm: f64,
    /// Times of the first and the last touch, s.
    first_and_last_time_s: [f64; 2],
}

impl ObservedTouches {
    /// Time of a touch, scaled from −1 to 1 over the run.
    pub fn relative_time(&self, touch: &MeasuredTouch) -> f64 {
        let [first, last] = self.first_and_last_time_s;
        if last > first { (2.0 * touch.time_in_run_s - first - last) / (last - first) } else { 0.0 }
    }

    pub fn group_count(&self) -> usize {
        self.touches.iter().map(|touch| touch.group_index + 1).max().unwrap_or(0)
    }
}

/// A reading with its step.
struct StepReading<'a> {
    step: &'a Step,
    reading: &'a Reading,
    /// Positions of all axes: those of the reading, the others from the step.
    position: Position,
    /// Nominal stylus centre, table frame, mm.
    stylus_centre_in_table_mm: Vector3<f64>,
}

impl StepReading<'_> {
    fn is_fast(&self, setup: &QualificationSetup<'_>) -> bool {
        self.step.feed_mm_min > setup.plan.probe.feed_mm_min
    }
}

/// # Errors
/// Readings do not belong to the plan, are missing or do not fit a sphere.
pub fn observe_touches(setup: &QualificationSetup<'_>, readings: &[Reading]) -> Result<ObservedTouches, IdentifyError> {
    let step_readings = match_readings(setup, readings)?;
    let slow = step_readings.iter().filter(|step_reading| !step_reading.is_fast(setup));
    let points: Vec<[f64; 3]> = slow.map(|step_reading| step_reading.stylus_centre_in_table_mm.into()).collect();
    let sphere = fit_sphere(&points).map_err(|reason| {
        MethodRefusal::new(
            format!("the slow touches do not fit a sphere: {reason}"),
            "give plan and readings of a complete run of probe-qualification",
        )
    })?;
    let radius_mm = setup.measured_ball()?.radius_mm + setup.plan.probe.ball_radius_mm;
    let table = setup.chain.machine_from_table(&setup.rotary_nearest_zero, &[]).rotation;
    let mut groups = BTreeMap::new();
    let touch = |step_reading: &StepReading<'_>| {
        let from_centre = table * (step_reading.stylus_centre_in_table_mm - Vector3::from(sphere.centre));
        let normal = from_centre.normalize();
        let gaps = setup.plan.interruption_times_s.iter();
        let earlier_interruption_count = gaps.filter(|gap| step_reading.reading.t_s > **gap).count();
        let number = groups.len();
        MeasuredTouch {
            label: step_reading.step.label.clone(),
            normal_in_machine: normal,
            normal_in_spindle: setup.chain.machine_from_spindle(&step_reading.position, &[]).rotation.inverse()
                * normal,
            radial_deviation_mm: from_centre.norm() - radius_mm,
            axis_positions_mm: step_reading.position.xyz_or_zero(),
            is_fast: step_reading.is_fast(setup),
            spindle_orientation_index: setup.nearest_spindle_orientation_index(&step_reading.position),
            time_in_run_s: step_reading.reading.t_s,
            earlier_interruption_count,
            group_index: *groups
                .entry((direction_label(&step_reading.step.label), earlier_interruption_count))
                .or_insert(number),
        }
    };
    let touches: Vec<MeasuredTouch> = step_readings.iter().map(touch).collect();
    let times = || touches.iter().map(|touch| touch.time_in_run_s);
    Ok(ObservedTouches {
        spindle_orientations_deg: setup.spindle_orientations_deg(),
        speeds_mm_s: [setup.plan.probe.feed_mm_min, setup.fast_feed_mm_min()].map(|feed| feed / 60.0),
        stated_radius_sum_mm: radius_mm,
        first_and_last_time_s: [times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max)],
        touches,
    })
}

/// All readings without a flag, except those of the search touches, each with its step. Error: readings do not belong
/// to the plan or are missing, or X, Y, Z or the time is not a finite number.
fn match_readings<'a>(
    setup: &QualificationSetup<'a>,
    readings: &'a [Reading],
) -> Result<Vec<StepReading<'a>>, IdentifyError> {
    let plan = setup.plan;
    IdentifyError::check_known_steps(plan, readings)?;
    let mut seen = BTreeSet::new();
    if let Some(twice) = readings.iter().find(|read| !seen.insert((read.step, read.repeat))) {
        return Err(IdentifyError::DuplicateReading { step: twice.step, repeat: twice.repeat });
    }
    let steps = plan.steps.iter().filter(|step| !step.label.starts_with(SEARCH_LABEL_PREFIX));
    let steps: BTreeMap<u32, &Step> = steps.map(|step| (step.id, step)).collect();
    if let Some(missing) = steps.values().find(|step| !seen.iter().any(|(id, _)| *id == step.id)) {
        return Err(IdentifyError::missing_reading(missing));
    }
    let tip = Point::from_vec(Vector3::from(plan.machine.tool_mm));
    let mut step_readings = Vec::new();
    for reading in readings.iter().filter(|reading| reading.flag == ReadingFlag::None) {
        let Some(step) = steps.get(&reading.step).copied() else { continue };
        let has = |axis| reading.position.get(axis).is_some_and(f64::is_finite);
        if !Axis::LINEAR.into_iter().all(has) || !reading.t_s.is_finite() {
            return Err(IdentifyError::IdentificationFailed(format!(
                "{}: X, Y, Z or the time of the reading is missing or not a number",
                step.label
            )));
        }
        let at = step.from.updated_by(&reading.position);
        let tip = setup.chain.tip_in_table(&at, tip, &[]).mm;
        step_readings.push(StepReading { step, reading, position: at, stylus_centre_in_table_mm: tip });
    }
    Ok(step_readings)
}

/// Label without the number of the round: the direction, orientation and feed of a touch.
fn direction_label(label: &str) -> String {
    label.rsplit_once('/').map_or(label, |(direction, _)| direction).to_owned()
}
