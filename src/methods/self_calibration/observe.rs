//! From readings to observations on the grid: positions of the ball centre along and across each ray.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;

use super::design::Design;
use super::gaps;
use super::model::{Layout, Observation};
use super::plan::{LOCATE_LABEL, touches_top};
use super::table_axis::TableAxis;
use crate::IdentifyError;
use crate::identification::KnownMotions;
use machine::Axis;
use machine::record::plan::{Plan, Step};
use machine::record::reading::{Flag, Reading};
use planning::Clearance;

/// The observations of one cycle with their common data.
pub struct Observed {
    pub observations: Vec<Observation>,
    /// Half the duration of the cycle, s: the unit of `Observation::time`.
    pub half_duration_s: f64,
    /// Whether the readings have times. If not, their order and the planned machine time are used.
    pub timed: bool,
    /// Times of the interruptions, as `Observation::time`.
    pub gaps: Vec<f64>,
    /// Number of readings between interruptions that are not connected with the rest.
    pub left_out: usize,
}

/// Largest deviation of the table from its planned angle, rad (0.1°). A larger one is a skipped index.
const INDEX_TOLERANCE: f64 = 1.8e-3;

/// The measured axis and its known properties.
pub struct ObservedAxis<'a> {
    pub axis: &'a TableAxis,
    /// Heights of the touches, machine frame, mm.
    pub heights: &'a [f64],
    /// Error motions that are subtracted from the observations.
    pub known: &'a KnownMotions<'a>,
}

impl ObservedAxis<'_> {
    /// Commanded angle of an observation, rad, within a revolution.
    pub fn angle(&self, design: &Design, seen: &Observation) -> f64 {
        design.angle(seen.c) * self.axis.sense
    }

    /// Derivative of each radius by an error motion of the axis along or about `component`.
    pub fn radii_by_motion(
        &self,
        layout: &Layout,
        observations: &[Observation],
        component: Axis,
    ) -> Vec<f64> {
        let of_radius = |seen: &Observation| {
            let normal = layout.normal(seen.phi);
            let across = Vector3::z().cross(&normal);
            let centre = self.axis.at_height(self.heights[seen.height])
                + seen.radius * normal
                + seen.lateral * across;
            self.axis.radius_by_motion(component, centre, normal)
        };
        observations.iter().map(of_radius).collect()
    }
}

/// # Errors
/// Missing or unknown steps, duplicates, or a table at another angle than planned.
pub fn observe(
    plan: &Plan,
    design: &Design,
    axis: &ObservedAxis<'_>,
    readings: &[Reading],
) -> Result<Observed, IdentifyError> {
    let by_step = sort_by_step(plan, readings)?;
    let (mut observations, mut order) = (Vec::new(), Vec::new());
    let cycle = plan.steps.iter().filter(|step| !step.label.starts_with(LOCATE_LABEL));
    for (i, step) in cycle.enumerate() {
        let Some(of_step) = by_step.get(&step.id).filter(|list| !list.is_empty()) else {
            return Err(IdentifyError::missing(step));
        };
        if touches_top(step) {
            continue;
        }
        for reading in of_step.iter().filter(|reading| reading.flag == Flag::None) {
            observations.push(reduce(design, axis, step, reading)?);
            order.push((reading.repeat as usize * plan.steps.len() + i) as f64);
        }
    }
    if observations.is_empty() {
        return Err(IdentifyError::Numerical("no reading is left: all are flagged".to_owned()));
    }
    let (mut gaps, left_out) = gaps::close(&mut observations, &plan.gaps_s)?;
    let mut half_duration_s = scale_times(&mut observations, &mut gaps);
    let timed = half_duration_s > 0.0;
    if !timed {
        for (seen, place) in observations.iter_mut().zip(order) {
            seen.time = place;
        }
        scale_times(&mut observations, &mut []);
        half_duration_s = planned_duration_s(plan) / 2.0;
    }
    Ok(Observed { observations, half_duration_s, timed, gaps, left_out })
}

/// Machine time of the plan, s, or 5 s per touch if it cannot be planned.
fn planned_duration_s(plan: &Plan) -> f64 {
    Clearance::above(plan)
        .and_then(|clearance| planning::blocks(plan, &clearance))
        .map_or(5.0 * plan.steps.len() as f64, |(_, seconds)| seconds)
}

fn sort_by_step<'a>(
    plan: &Plan,
    readings: &'a [Reading],
) -> Result<BTreeMap<u32, Vec<&'a Reading>>, IdentifyError> {
    let mut by_step: BTreeMap<u32, Vec<&Reading>> =
        plan.steps.iter().map(|step| (step.id, Vec::new())).collect();
    for reading in readings {
        let Some(list) = by_step.get_mut(&reading.step) else {
            return Err(IdentifyError::UnknownStep { step: reading.step });
        };
        if list.iter().any(|other| other.repeat == reading.repeat) {
            let Reading { step, repeat, .. } = *reading;
            return Err(IdentifyError::Duplicate { step, repeat });
        }
        list.push(reading);
    }
    Ok(by_step)
}

fn reduce(
    design: &Design,
    observed: &ObservedAxis<'_>,
    step: &Step,
    reading: &Reading,
) -> Result<Observation, IdentifyError> {
    let ObservedAxis { axis, heights, known } = *observed;
    let name = axis.axis;
    let planned = step.from.at(name);
    let stood = reading.position.get(name).unwrap_or(planned);
    // A control may count full turns differently.
    let off = (stood - planned + PI).rem_euclid(TAU) - PI;
    if off.abs() > INDEX_TOLERANCE {
        return Err(IdentifyError::Numerical(format!(
            "step {} ({}): {name} stood at {:.4}° instead of {:.4}°; was an index skipped?",
            step.id,
            step.label,
            stood.to_degrees(),
            planned.to_degrees()
        )));
    }
    let [nx, ny, _] = step.normal;
    let phi = ny.atan2(nx);
    if (nx.hypot(ny) - 1.0).abs() > 1e-3 || !on_grid(design, phi) || !on_grid(design, planned) {
        return Err(IdentifyError::Numerical(format!(
            "step {} ({}): `normal` or {name} is not on the grid of {} positions",
            step.id, step.label, design.n
        )));
    }
    let centre = axis.corrected_ball_centre(step, reading, known);
    let height = nearest(heights, centre.z);
    let off = centre - axis.at_height(heights[height]);
    Ok(Observation {
        step: step.id,
        height,
        c: grid_index(design, planned * axis.sense),
        phi: grid_index(design, phi),
        radius: off.x * nx + off.y * ny,
        lateral: -off.x * ny + off.y * nx,
        time: reading.t_s,
    })
}

fn on_grid(design: &Design, angle: f64) -> bool {
    let index = angle / TAU * design.n as f64;
    (index - index.round()).abs() < INDEX_TOLERANCE
}

fn grid_index(design: &Design, angle: f64) -> usize {
    let index = (angle / TAU * design.n as f64).round() as i64;
    index.rem_euclid(design.n as i64) as usize
}

fn nearest(heights: &[f64], z: f64) -> usize {
    let distance = |i: &usize| (heights[*i] - z).abs();
    (0..heights.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
}

/// Scales the times to −1 … 1 around the middle of the cycle. Returns half the duration of the cycle, s.
fn scale_times(observations: &mut [Observation], gaps: &mut [f64]) -> f64 {
    let times = || observations.iter().map(|seen| seen.time);
    let first = times().fold(f64::INFINITY, f64::min);
    let last = times().fold(f64::NEG_INFINITY, f64::max);
    let half = if last > first { (last - first) / 2.0 } else { 0.0 };
    for time in observations.iter_mut().map(|seen| &mut seen.time).chain(gaps) {
        *time = if half > 0.0 { (*time - first - half) / half } else { 0.0 };
    }
    half
}
