//! From readings to distances of the stylus centre from the centre of the ball.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;

use super::bench::{FIND, QualificationSetup};
use crate::{IdentifyError, Refused};
use estimation::sphere::fit_sphere;
use machine::frame::Point;
use machine::record::plan::Step;
use machine::record::reading::{Flag, Reading};
use machine::{Axis, Position};

/// One touch.
#[derive(Debug, Clone)]
pub struct Touch {
    pub label: String,
    /// Unit vector from the ball's centre to the stylus centre: in the machine frame, and in the spindle frame.
    pub normal: Vector3<f64>,
    pub in_spindle: Vector3<f64>,
    /// Distance of the stylus centre from the centre of the fitted sphere, less both stated radii, mm.
    pub beyond_mm: f64,
    /// Axis positions X, Y and Z, mm.
    pub axes_mm: Vector3<f64>,
    pub is_fast: bool,
    /// Index of the spindle orientation.
    pub orientation: usize,
    pub t_s: f64,
    /// Number of interruptions before the touch.
    pub segment: usize,
    /// Index of the group: touches of one direction, orientation, feed and segment.
    pub group: usize,
}

pub struct Observed {
    pub touches: Vec<Touch>,
    /// Orientations of the spindle, degrees. Only 0 if the spindle is not turned.
    pub orientations_deg: Vec<f64>,
    /// Speeds of slow and fast touches, mm/s.
    pub speeds: [f64; 2],
    /// Sum of the stated radii of ball and stylus ball, mm.
    pub radius_mm: f64,
    /// Times of the first and the last touch, s.
    times_s: [f64; 2],
}

impl Observed {
    /// Time of a touch, scaled from −1 to 1 over the run.
    pub fn time(&self, touch: &Touch) -> f64 {
        let [first, last] = self.times_s;
        if last > first { (2.0 * touch.t_s - first - last) / (last - first) } else { 0.0 }
    }

    pub fn groups(&self) -> usize {
        self.touches.iter().map(|touch| touch.group + 1).max().unwrap_or(0)
    }
}

/// A reading with its step.
struct StepReading<'a> {
    step: &'a Step,
    reading: &'a Reading,
    /// Positions of all axes.
    at: Position,
    /// Stylus centre, table frame, mm.
    tip: Vector3<f64>,
}

impl StepReading<'_> {
    fn is_fast(&self, bench: &QualificationSetup<'_>) -> bool {
        self.step.feed_mm_min > bench.plan.probe.feed_mm_min
    }
}

/// # Errors
/// Readings do not belong to the plan, are missing or do not fit a sphere.
pub fn observe(
    bench: &QualificationSetup<'_>,
    readings: &[Reading],
) -> Result<Observed, IdentifyError> {
    let taken = taken(bench, readings)?;
    let slow = taken.iter().filter(|taken| !taken.is_fast(bench));
    let points: Vec<[f64; 3]> = slow.map(|taken| taken.tip.into()).collect();
    let sphere = fit_sphere(&points).map_err(|why| Refused {
        why: format!("the slow touches make no sphere: {why}"),
        instead: "give plan and readings of a whole run of probe-qualification".to_owned(),
    })?;
    let radius_mm = bench.measured_ball()?.radius_mm + bench.plan.probe.ball_radius_mm;
    let table = bench.chain.machine_from_table(&bench.rotary, &[]).rotation;
    let mut groups = BTreeMap::new();
    let touch = |taken: &StepReading<'_>| {
        let from_centre = table * (taken.tip - Vector3::from(sphere.centre));
        let normal = from_centre.normalize();
        let gaps = bench.plan.gaps_s.iter();
        let segment = gaps.filter(|gap| taken.reading.t_s > **gap).count();
        let number = groups.len();
        Touch {
            label: taken.step.label.clone(),
            normal,
            in_spindle: bench.chain.machine_from_spindle(&taken.at, &[]).rotation.inverse()
                * normal,
            beyond_mm: from_centre.norm() - radius_mm,
            axes_mm: taken.at.xyz(),
            is_fast: taken.is_fast(bench),
            orientation: bench.orientation_of(&taken.at),
            t_s: taken.reading.t_s,
            segment,
            group: *groups.entry((direction(&taken.step.label), segment)).or_insert(number),
        }
    };
    let touches: Vec<Touch> = taken.iter().map(touch).collect();
    let times = || touches.iter().map(|touch| touch.t_s);
    Ok(Observed {
        orientations_deg: bench.orientations_deg(),
        speeds: [bench.plan.probe.feed_mm_min, bench.fast_mm_min()].map(|feed| feed / 60.0),
        radius_mm,
        times_s: [times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max)],
        touches,
    })
}

/// All valid readings except those of the search.
fn taken<'a>(
    bench: &QualificationSetup<'a>,
    readings: &'a [Reading],
) -> Result<Vec<StepReading<'a>>, IdentifyError> {
    let plan = bench.plan;
    IdentifyError::check_steps(plan, readings)?;
    let mut seen = BTreeSet::new();
    if let Some(twice) = readings.iter().find(|read| !seen.insert((read.step, read.repeat))) {
        return Err(IdentifyError::Duplicate { step: twice.step, repeat: twice.repeat });
    }
    let steps = plan.steps.iter().filter(|step| !step.label.starts_with(FIND));
    let steps: BTreeMap<u32, &Step> = steps.map(|step| (step.id, step)).collect();
    if let Some(missing) = steps.values().find(|step| !seen.iter().any(|(id, _)| *id == step.id)) {
        return Err(IdentifyError::missing(missing));
    }
    let tip = Point::from_vec(Vector3::from(plan.machine.tool_mm));
    let mut taken = Vec::new();
    for reading in readings.iter().filter(|reading| reading.flag == Flag::None) {
        let Some(step) = steps.get(&reading.step).copied() else { continue };
        let has = |axis| reading.position.get(axis).is_some_and(f64::is_finite);
        if !Axis::LINEAR.into_iter().all(has) || !reading.t_s.is_finite() {
            return Err(IdentifyError::Numerical(format!(
                "{}: the reading lacks X, Y, Z or its time as numbers",
                step.label
            )));
        }
        let at = step.from.updated_by(&reading.position);
        let tip = bench.chain.tip_in_table(&at, tip, &[]).mm;
        taken.push(StepReading { step, reading, at, tip });
    }
    Ok(taken)
}

/// Label without the number of the round.
fn direction(label: &str) -> String {
    label.rsplit_once('/').map_or(label, |(direction, _)| direction).to_owned()
}
