//! From readings to positions along the touch.

use std::collections::BTreeSet;

use super::feeds::{Feeds, run_up_mm};
use super::plan::SEARCH;
use crate::identification::declared::display_step_mm;
use crate::{IdentifyError, Refused};
use machine::record::plan::{Plan, Step};
use machine::record::reading::{Flag, Reading};
use machine::{Axis, Position};

/// Minimum number of touches at one feed for a scatter.
const LEAST_TOUCHES: usize = 3;
/// Largest distance between starts that count as the same, mm.
const SAME_MM: f64 = 1e-3;

/// One touch.
#[derive(Debug, Clone, Copy)]
pub struct Touch {
    /// Distance from the start towards contact, mm.
    pub along_mm: f64,
    /// Index of the feed: 0 is the slow one.
    pub feed: usize,
    pub t_s: f64,
    /// Number of interruptions before the touch.
    pub segment: usize,
}

pub struct Observed {
    pub touches: Vec<Touch>,
    /// Slow and fast feed, mm/min.
    pub feeds_mm_min: [f64; 2],
    /// Resolution of the displayed position along the touch, mm.
    pub resolution_mm: f64,
    /// Mean distance from the start of the touches to contact, mm.
    pub way_mm: f64,
    /// Whether the readings have times. If not, their order is used.
    pub timed: bool,
}

impl Observed {
    /// Slow and fast speed, mm/s.
    pub fn speeds(&self) -> [f64; 2] {
        self.feeds_mm_min.map(|feed| feed / 60.0)
    }
}

/// Unit vector from the start of a touch towards its end, and length in mm. Both are zero for a touch without
/// length.
fn direction(step: &Step) -> ([f64; 3], f64) {
    let way = Axis::LINEAR.map(|axis| step.to.at(axis) - step.from.at(axis));
    let length = way.iter().map(|part| part * part).sum::<f64>().sqrt();
    (way.map(|part| if length > 0.0 { part / length } else { 0.0 }), length)
}

fn along(step: &Step, position: &Position) -> Option<f64> {
    let mut sum = 0.0;
    for (axis, part) in Axis::LINEAR.into_iter().zip(direction(step).0) {
        sum += part * (position.get(axis)? - step.from.at(axis));
    }
    Some(sum)
}

/// Checks that the search found the part where touches at both feeds are possible.
///
/// # Errors
/// The part is so near to the start, or so far from it, that a fast touch would not have its feed.
pub fn check_found(plan: &Plan, feeds: &Feeds, readings: &[Reading]) -> Result<(), Refused> {
    let search = plan.steps.iter().find(|step| step.label == SEARCH);
    let found = search.and_then(|step| {
        let reading = readings.iter().find(|reading| reading.step == step.id)?;
        Some((along(step, &reading.position)?, direction(step).1))
    });
    let Some((at, length)) = found else {
        return Err(Refused {
            why: "the first touch has no reading".to_owned(),
            instead: "start the run again".to_owned(),
        });
    };
    if at >= feeds.run_up_mm && length - at >= feeds.room_mm {
        return Ok(());
    }
    Err(Refused {
        why: format!(
            "the part was met after {at:.3} mm of a touch of {length:.3} mm; to meet it at \
             {} mm/min the touch must go {:.3} mm before and may go on {:.3} mm beyond",
            feeds.fast_mm_min, feeds.run_up_mm, feeds.room_mm
        ),
        instead: "the part does not stand within uncertainty_mm of where the file says: correct \
                  [artefact] centre_mm, or set it up anew"
            .to_owned(),
    })
}

/// # Errors
/// Readings do not belong to the plan or are missing; the plan has not exactly two feeds or too few touches at one
/// of them; touches are of different positions or contact the part before they reach their feed.
pub fn observe(plan: &Plan, readings: &[Reading]) -> Result<Observed, IdentifyError> {
    let steps: Vec<&Step> = plan.steps.iter().filter(|step| step.label != SEARCH).collect();
    check_complete(plan, &steps, readings)?;
    let feeds_mm_min = two_feeds(&steps)?;
    let first = *steps.first().ok_or_else(|| refused("the plan has no touches".to_owned()))?;
    let mut touches = Vec::new();
    for (order, step) in steps.iter().enumerate() {
        let is_elsewhere =
            |(axis, value): (Axis, f64)| (first.from.at(axis) - value).abs() > SAME_MM;
        if step.from.iter().any(is_elsewhere) {
            return Err(refused(format!("{} begins elsewhere than {}", step.label, first.label)));
        }
        let of_step = readings.iter().filter(|reading| reading.step == step.id);
        for reading in of_step.filter(|reading| reading.flag == Flag::None) {
            let along_mm = at_full_feed(plan, step, reading)?;
            let feed = usize::from(step.feed_mm_min == feeds_mm_min[1]);
            let segment = plan.gaps_s.iter().filter(|gap| reading.t_s > **gap).count();
            let place = order + reading.repeat as usize * steps.len();
            touches.push((place, Touch { along_mm, feed, t_s: reading.t_s, segment }));
        }
    }
    let timed =
        touches.iter().any(|(_, touch)| Some(touch.t_s) != touches.first().map(|t| t.1.t_s));
    let touches: Vec<Touch> = touches
        .into_iter()
        .map(|(place, touch)| if timed { touch } else { Touch { t_s: place as f64, ..touch } })
        .collect();
    check_enough(&touches, feeds_mm_min)?;
    let resolution_mm = display_step_mm(plan, direction(first).0.into());
    let way_mm = touches.iter().map(|touch| touch.along_mm).sum::<f64>() / touches.len() as f64;
    Ok(Observed { touches, feeds_mm_min, resolution_mm, way_mm, timed })
}

fn check_complete(plan: &Plan, steps: &[&Step], readings: &[Reading]) -> Result<(), IdentifyError> {
    let mut seen = BTreeSet::new();
    for Reading { step, repeat, .. } in readings {
        if plan.steps.iter().all(|known| known.id != *step) {
            return Err(IdentifyError::UnknownStep { step: *step });
        }
        if !seen.insert((*step, *repeat)) {
            return Err(IdentifyError::Duplicate { step: *step, repeat: *repeat });
        }
    }
    let missing = steps.iter().find(|step| readings.iter().all(|read| read.step != step.id));
    missing.map_or(Ok(()), |step| Err(IdentifyError::missing(step)))
}

/// Slow and fast feed, mm/min.
fn two_feeds(steps: &[&Step]) -> Result<[f64; 2], IdentifyError> {
    let mut feeds: Vec<f64> = steps.iter().map(|step| step.feed_mm_min).collect();
    feeds.sort_by(f64::total_cmp);
    feeds.dedup();
    match feeds.as_slice() {
        [slow, fast] if *slow > 0.0 && fast.is_finite() => Ok([*slow, *fast]),
        _ => Err(refused(format!("{} feeds in the plan, two are needed", feeds.len()))),
    }
}

/// Distance from the start of a touch to the latched position, mm.
fn at_full_feed(plan: &Plan, step: &Step, reading: &Reading) -> Result<f64, IdentifyError> {
    let (label, length) = (&step.label, direction(step).1);
    let at = along(step, &reading.position).filter(|at| at.is_finite() && reading.t_s.is_finite());
    let at = at.ok_or_else(|| {
        IdentifyError::Numerical(format!(
            "{label}: the reading lacks X, Y, Z or its time as numbers"
        ))
    })?;
    let run_up = run_up_mm(&plan.machine, step.feed_mm_min);
    if at >= run_up && length - at >= run_up {
        return Ok(at);
    }
    Err(Refused {
        why: format!(
            "{label} was met after {at:.4} mm of {length:.4} mm: at {} mm/min the axes need {run_up:.4} mm \
             to come to their feed, and as much to rest",
            step.feed_mm_min
        ),
        instead: "measure again with the part nearer to where the file says, or a lower fast_feed_mm_min"
            .to_owned(),
    }
    .into())
}

fn check_enough(touches: &[Touch], feeds_mm_min: [f64; 2]) -> Result<(), IdentifyError> {
    for (index, feed) in feeds_mm_min.iter().enumerate() {
        let count = touches.iter().filter(|touch| touch.feed == index).count();
        if count < LEAST_TOUCHES {
            return Err(refused(format!(
                "{count} touches at {feed} mm/min, {LEAST_TOUCHES} are needed"
            )));
        }
    }
    Ok(())
}

fn refused(why: String) -> IdentifyError {
    let instead = "give plan and readings of a whole run of latch-delay".to_owned();
    Refused { why, instead }.into()
}
