//! Computes the contact positions along the touches from the readings.

use super::feeds::{TouchFeeds, acceleration_distance_mm};
use super::touch_path::SEARCH_STEP_LABEL;
use crate::identification::declared_sources::control_resolution_mm;
use crate::{IdentifyError, MethodRefusal};
use machine::record::plan::{Plan, Step};
use machine::record::reading::{Reading, ReadingFlag};
use machine::{Axis, Position};

/// Minimum number of measured touches at one feed. Fewer have no usable scatter and are refused.
const MIN_MEASURED_TOUCHES_PER_FEED: usize = 3;
/// Largest difference of an axis between starts of touches that count as the same, mm; for a rotary axis the same
/// number in rad.
const SAME_START_TOLERANCE_MM_OR_RAD: f64 = 1e-3;

/// One touch.
#[derive(Debug, Clone, Copy)]
pub struct ObservedTouch {
    /// Distance along the touch from its start to the latched position, mm.
    pub contact_distance_mm: f64,
    /// Index of the feed: 0 slow, 1 fast.
    pub feed_index: usize,
    /// Time of the touch on the clock of the run, s. If all touches have the same time, a number instead: the index of
    /// the step (from 0, without the search touch) plus the repeat number times the number of these steps.
    pub time_in_run_s_or_order: f64,
    /// Number of interruptions before the touch.
    pub earlier_interruption_count: usize,
}

/// Touches of a run, with all repeats, without the search touch and without flagged readings.
pub struct ObservedTouches {
    pub touches: Vec<ObservedTouch>,
    /// Slow and fast feed, mm/min.
    pub feeds_mm_min: [f64; 2],
    /// Resolution of the displayed position along the touch, mm.
    pub resolution_mm: f64,
    /// Mean of the contact distances at both feeds, mm. The fit subtracts this mean.
    pub mean_contact_distance_mm: f64,
    /// Whether the readings have different times. If not, their order is used.
    pub has_times: bool,
}

impl ObservedTouches {
    /// Slow and fast speed, mm/s.
    pub fn speeds_mm_s(&self) -> [f64; 2] {
        self.feeds_mm_min.map(|feed| feed / 60.0)
    }
}

/// Unit vector in X, Y and Z of the machine from the start of a touch to its end, and length in mm. Both are zero for
/// a touch without length.
fn touch_direction_and_length(step: &Step) -> ([f64; 3], f64) {
    let displacement = Axis::LINEAR.map(|axis| step.to.get_or_zero(axis) - step.from.get_or_zero(axis));
    let length = displacement.iter().map(|part| part * part).sum::<f64>().sqrt();
    (displacement.map(|part| if length > 0.0 { part / length } else { 0.0 }), length)
}

/// Distance of `position` from the start of the touch, along the touch, mm. `None`: X, Y or Z is missing.
fn distance_along_touch(step: &Step, position: &Position) -> Option<f64> {
    let mut sum = 0.0;
    for (axis, part) in Axis::LINEAR.into_iter().zip(touch_direction_and_length(step).0) {
        sum += part * (position.get(axis)? - step.from.get_or_zero(axis));
    }
    Some(sum)
}

/// Checks that the search found the part where touches at both feeds are possible.
///
/// # Errors
/// The search has no reading, or the part is too near to the start or to the end of the touch: a fast touch would not
/// be at its feed at contact.
pub fn check_search_result(plan: &Plan, feeds: &TouchFeeds, readings: &[Reading]) -> Result<(), MethodRefusal> {
    let search = plan.steps.iter().find(|step| step.label == SEARCH_STEP_LABEL);
    let contact = search.and_then(|step| {
        let reading = readings.iter().find(|reading| reading.step == step.id)?;
        Some((distance_along_touch(step, &reading.position)?, touch_direction_and_length(step).1))
    });
    let Some((at, length)) = contact else {
        return Err(MethodRefusal::new("the first touch has no reading", "start the run again"));
    };
    if at >= feeds.fast_run_up_mm && length - at >= feeds.fast_touch_margin_mm {
        return Ok(());
    }
    Err(MethodRefusal::new(
        format!(
            "the first contact was after {at:.3} mm of a touch of {length:.3} mm; a touch at {} \
             mm/min needs {:.3} mm before the contact and {:.3} mm beyond it",
            feeds.fast_feed_mm_min, feeds.fast_run_up_mm, feeds.fast_touch_margin_mm
        ),
        "the part is not within uncertainty_mm of its stated position: correct centre_mm \
                  in [artefact], or mount the part again",
    ))
}

/// Distances to contact of all touches with their repeats, except the search and flagged readings.
///
/// # Errors
/// Readings do not belong to the plan or are missing; the plan has not exactly two feeds or too few touches at one of
/// them; touches are of different positions or contact the part before they reach their feed.
pub fn observe_touches(plan: &Plan, readings: &[Reading]) -> Result<ObservedTouches, IdentifyError> {
    let steps: Vec<&Step> = plan.steps.iter().filter(|step| step.label != SEARCH_STEP_LABEL).collect();
    IdentifyError::check_known_and_unique(plan, readings)?;
    if let Some(step) = steps.iter().find(|step| readings.iter().all(|reading| reading.step != step.id)) {
        return Err(IdentifyError::missing_reading(step));
    }
    let feeds_mm_min = slow_and_fast_feed(&steps)?;
    let first = *steps.first().ok_or_else(|| incomplete_run_error("the plan has no touches".to_owned()))?;
    let (mut touches, mut orders): (Vec<ObservedTouch>, Vec<f64>) = (Vec::new(), Vec::new());
    for (index, step) in steps.iter().enumerate() {
        let is_elsewhere =
            |(axis, value): (Axis, f64)| (first.from.get_or_zero(axis) - value).abs() > SAME_START_TOLERANCE_MM_OR_RAD;
        if step.from.iter().any(is_elsewhere) {
            let reason = format!("{} and {} start at different positions", step.label, first.label);
            return Err(incomplete_run_error(reason));
        }
        let of_step = readings.iter().filter(|reading| reading.step == step.id);
        for reading in of_step.filter(|reading| reading.flag == ReadingFlag::None) {
            let contact_distance_mm = contact_distance_at_full_feed(plan, step, reading)?;
            touches.push(ObservedTouch {
                contact_distance_mm,
                feed_index: usize::from(step.feed_mm_min == feeds_mm_min[1]),
                time_in_run_s_or_order: reading.t_s,
                earlier_interruption_count: plan.interruption_times_s.iter().filter(|gap| reading.t_s > **gap).count(),
            });
            orders.push((index + reading.repeat as usize * steps.len()) as f64);
        }
    }
    let has_times = touches.windows(2).any(|pair| pair[0].time_in_run_s_or_order != pair[1].time_in_run_s_or_order);
    if !has_times {
        touches.iter_mut().zip(orders).for_each(|(touch, order)| touch.time_in_run_s_or_order = order);
    }
    check_touch_count(&touches, feeds_mm_min)?;
    let resolution_mm = control_resolution_mm(plan, touch_direction_and_length(first).0.into());
    let mean_contact_distance_mm =
        touches.iter().map(|touch| touch.contact_distance_mm).sum::<f64>() / touches.len() as f64;
    Ok(ObservedTouches { touches, feeds_mm_min, resolution_mm, mean_contact_distance_mm, has_times })
}

/// Slow and fast feed, mm/min. Error: the steps do not have exactly two different feeds.
fn slow_and_fast_feed(steps: &[&Step]) -> Result<[f64; 2], IdentifyError> {
    let mut feeds: Vec<f64> = steps.iter().map(|step| step.feed_mm_min).collect();
    feeds.sort_by(f64::total_cmp);
    feeds.dedup();
    match feeds.as_slice() {
        [slow, fast] if *slow > 0.0 && fast.is_finite() => Ok([*slow, *fast]),
        _ => Err(incomplete_run_error(format!("the plan has {} different feeds, two are needed", feeds.len()))),
    }
}

/// Distance from the start of a touch to the latched position, mm. Error: the contact is nearer to the start or to the
/// end than the acceleration distance, or X, Y, Z or the time is not a finite number.
fn contact_distance_at_full_feed(plan: &Plan, step: &Step, reading: &Reading) -> Result<f64, IdentifyError> {
    let (label, length) = (&step.label, touch_direction_and_length(step).1);
    let at = distance_along_touch(step, &reading.position).filter(|at| at.is_finite() && reading.t_s.is_finite());
    let at = at.ok_or_else(|| {
        IdentifyError::IdentificationFailed(format!("{label}: X, Y, Z or the time of the reading is not a number"))
    })?;
    let run_up = acceleration_distance_mm(&plan.machine, step.feed_mm_min);
    if at >= run_up && length - at >= run_up {
        return Ok(at);
    }
    Err(MethodRefusal::new(
        format!(
            "{label}: contact after {at:.4} mm of {length:.4} mm; at {} mm/min the axes need \
             {run_up:.4} mm to accelerate, and as much to stop",
            step.feed_mm_min
        ),
        "measure again with the part nearer to its stated position, or with a lower \
                  fast_feed_mm_min",
    )
    .into())
}

fn check_touch_count(touches: &[ObservedTouch], feeds_mm_min: [f64; 2]) -> Result<(), IdentifyError> {
    for (index, feed) in feeds_mm_min.iter().enumerate() {
        let count = touches.iter().filter(|touch| touch.feed_index == index).count();
        if count < MIN_MEASURED_TOUCHES_PER_FEED {
            return Err(incomplete_run_error(format!(
                "{count} touches at {feed} mm/min, at least {MIN_MEASURED_TOUCHES_PER_FEED} are needed"
            )));
        }
    }
    Ok(())
}

fn incomplete_run_error(why: String) -> IdentifyError {
    let instead = "use the plan and readings of a complete latch-delay run".to_owned();
    MethodRefusal::new(why, instead).into()
}
