//! Motions of one scan. A scan touches nothing, so its moves are not guarded; the proof checks that all of it keeps
//! its distance.

use super::careful::{UnconfirmedApproach, is_in_nest, near_feed, nest_feed};
use super::clearance::LIFT;
use super::path::{Path, height};
use super::surroundings::Near;
use super::{Clearance, Confirmed, PlanningError, Start, limits, touch_block, turning};
use machine::record::motion::{Block, Motion};
use machine::record::plan::{Plan, Sampling, Scan, Step};
use machine::{Axis, Position};

/// Height above the first point at which the descent becomes a feed move, mm.
const SLOW_MM: f64 = 10.0;
/// Maximum distance from the first point at which the ball stays in a nest of sensors on the table, mm.
const NEST_WAY_MM: f64 = 1.0;

/// Blocks of one step. A touch is one block. A scan with dwell points is one block for each section after which
/// samples are taken, the first with the path to it. A continuous scan is the path to its first point and the scan,
/// without a rest.
///
/// # Errors
/// As [`touch_block`]; the points of a scan do not contain all axes, or its sampling is impossible.
pub fn step_blocks(
    plan: &Plan,
    step: &Step,
    repeat: u32,
    start: Start<'_>,
    clearance: &Clearance,
) -> Result<Vec<Block>, PlanningError> {
    match &step.scan {
        None => touch_block(plan, step, repeat, start, clearance).map(|block| vec![block]),
        Some(scan) => scan_blocks(plan, (step, scan), repeat, start, clearance),
    }
}

/// If the rotary axes or the spindle turn, the path leads up to the end of Z, turns and moves across; otherwise it
/// is no higher than its two ends. Then it leads down, the last part slowly, and from point to point. Until a scan
/// has confirmed the position of the machine, the path is careful ([`super::careful`]), and the descent to where
/// the sensor may reach a body is separate blocks ([`blocks_out_of_range`]). The path of the ball into a nest of
/// sensors on the table is always planned like this; between scans, the ball stays in the nest.
fn scan_blocks(
    plan: &Plan,
    (step, scan): (&Step, &Scan),
    repeat: u32,
    start: Start<'_>,
    clearance: &Clearance,
) -> Result<Vec<Block>, PlanningError> {
    check(plan, step, scan)?;
    let in_nest = is_in_nest(plan, step);
    let approach_feed = if in_nest { nest_feed(plan) } else { near_feed(plan, start.confirmed) };
    let mut path = Path::from(start.stands, approach_feed);
    let top_z = clearance.top_z;
    let mut blocks = Vec::new();
    let begins_in_place = scan.turns_only() && still_axes_stand_at(&path, scan);
    if begins_in_place || (in_nest && stays_in_nest(&path, &step.from, start.confirmed)) {
        turn_to(&mut path, plan, &step.from, clearance);
    } else if start.confirmed.is_all() && !in_nest {
        approach(&mut path, &step.from, top_z);
    } else {
        let low_z = low_z(step, &path, clearance)?;
        let careful = match in_nest {
            true => UnconfirmedApproach::to_nest(plan, clearance, low_z),
            false => UnconfirmedApproach::new(plan, clearance, low_z, start.confirmed),
        };
        careful.up(&mut path, &step.from);
        blocks.push(std::mem::take(&mut path.motions));
        careful.across_and_down(&mut path, &step.from);
        blocks.push(std::mem::take(&mut path.motions));
    }
    for (number, point) in scan.path.iter().enumerate() {
        let feed_mm_min = if number == 0 { approach_feed } else { step.feed_mm_min };
        path.feed(&point.only(|axis| axis != Axis::S), |to| Motion::Feed { to, feed_mm_min });
        match scan.sampling {
            Sampling::Dwell { dwell_s, .. } => {
                path.motions.push(Motion::Dwell { seconds: dwell_s });
            }
            Sampling::Continuous { .. } if number > 0 => continue,
            Sampling::Continuous { .. } => {}
        }
        blocks.push(std::mem::take(&mut path.motions));
    }
    blocks.push(path.motions);
    blocks.retain(|motions| !motions.is_empty());
    let block = |motions| Block { step: step.id, repeat, motions };
    let blocks: Vec<Block> = blocks.into_iter().map(block).collect();
    blocks.iter().try_for_each(|block| limits::check(block, &plan.machine))?;
    Ok(blocks)
}

/// Whether the axes that a scan does not move are at its start.
fn still_axes_stand_at(path: &Path, scan: &Scan) -> bool {
    let Some(first) = scan.path.first() else { return false };
    let is_still = |axis: Axis, at: f64| scan.path.iter().all(|point| point.at(axis) == at);
    let mut still = first.iter().filter(|(axis, at)| is_still(*axis, *at));
    still.all(|(axis, at)| path.stands_at(axis, at))
}

/// Whether the ball is so near to the first point of a scan in a nest that it can stay in the nest. Until the
/// position is confirmed, no axis turns for this.
fn stays_in_nest(path: &Path, from: &Position, confirmed: Confirmed) -> bool {
    let is_in_place = |(axis, at): (Axis, f64)| match path.stands.get(axis) {
        Some(stands) if axis.is_linear() => (stands - at).abs() <= NEST_WAY_MM,
        Some(_) if axis != Axis::S && confirmed.is_all() => true,
        _ => path.stands_at(axis, at),
    };
    from.iter().all(is_in_place)
}

/// Turns to the first point, at the feed that is allowed until the position is confirmed.
fn turn_to(path: &mut Path, plan: &Plan, from: &Position, clearance: &Clearance) {
    for (axis, at) in from.iter().filter(|(axis, _)| !axis.is_linear() && *axis != Axis::S) {
        let chain = &clearance.about.chain;
        let feed_mm_min = turning::feed_at_most(plan, chain, axis, &path.stands);
        path.feed(&Position::new().with(axis, at), |to| Motion::Feed { to, feed_mm_min });
    }
}

/// Number of the `count` blocks of a scan that lead to where no declared body is within the range of its sensor:
/// straight up, then across and down. None once the position is confirmed; with sensors on the table, none if the
/// ball is already between them.
pub fn blocks_out_of_range(scan: &Scan, count: usize) -> usize {
    // The path to the first point is in the first of these blocks.
    let rest = match scan.sampling {
        Sampling::Dwell { .. } => scan.path.len(),
        Sampling::Continuous { .. } => 2,
    };
    count.saturating_sub(rest)
}

/// Height of Z above the first point from which on no declared body is within the range of a sensor, neither there
/// nor on the path to it at the upper end of Z.
fn low_z(step: &Step, path: &Path, clearance: &Clearance) -> Result<f64, PlanningError> {
    let from = &step.from;
    let stands = path.stands.only(|axis| matches!(axis, Axis::X | Axis::Y));
    let begins = from.updated_by(&stands);
    let out_of_range = |begins: &Position| {
        let near = |near: Near| PlanningError::InRangeAtTop {
            step: step.id,
            sensor: near.tool,
            body: near.obstacle,
        };
        clearance.about.z_out_of_range(begins, from, LIFT).map_err(near)
    };
    out_of_range(&begins)?;
    Ok(out_of_range(from)?.max(from.at(Axis::Z) + SLOW_MM).min(clearance.top_z))
}

fn approach(path: &mut Path, from: &Position, top_z: f64) {
    let z = from.at(Axis::Z);
    let still = |(axis, value): (Axis, f64)| axis.is_linear() || path.stands_at(axis, value);
    let level = match path.stands.get(Axis::Z) {
        Some(stands) if from.iter().all(still) => stands.max(z + SLOW_MM),
        _ => top_z,
    };
    path.rapid(&height(level.min(top_z)));
    path.rapid(&from.only(|axis| !axis.is_linear() && axis != Axis::S));
    path.orient(from.get(Axis::S));
    path.rapid(&from.only(|axis| matches!(axis, Axis::X | Axis::Y)));
    path.rapid(&height((z + SLOW_MM).min(top_z)));
}

fn check(plan: &Plan, step: &Step, scan: &Scan) -> Result<(), PlanningError> {
    let id = step.id;
    let wrong = |why| Err(PlanningError::NotAScan { step: id, why });
    let wanted = plan.machine.axes.keys().copied().filter(|axis| *axis != Axis::S);
    for axis in wanted {
        if scan.path.iter().any(|point| point.get(axis).is_none()) {
            return Err(PlanningError::Incomplete { step: id, axis });
        }
    }
    let (Some(first), Some(last)) = (scan.path.first(), scan.path.last()) else {
        return wrong("its path has no point");
    };
    let differs = |one: &Position, other: &Position| {
        let same = |(axis, value)| other.get(axis).is_none_or(|other| other == value);
        !one.iter().all(same)
    };
    if differs(first, &step.from) || differs(last, &step.to) {
        return wrong("it does not begin at `from` and end at `to`");
    }
    if !(step.feed_mm_min.is_finite() && step.feed_mm_min > 0.0) {
        return wrong("its feed is no speed");
    }
    let is_planned = |name: &String| plan.sensors.iter().any(|sensor| sensor.name == *name);
    if step.sensors.is_empty() || !step.sensors.iter().all(is_planned) {
        return wrong("the plan has no sensor of that name");
    }
    match scan.sampling {
        Sampling::Dwell { dwell_s, samples } if dwell_s >= 0.0 && samples > 0 => Ok(()),
        Sampling::Dwell { .. } => wrong("it rests for less than no time, or takes no sample"),
        Sampling::Continuous { .. }
            if scan.path.windows(2).all(|way| way.first() == way.last()) =>
        {
            wrong("samples are to be taken on its way, and it has no way")
        }
        Sampling::Continuous { rate_hz, .. } if !(rate_hz.is_finite() && rate_hz > 0.0) => {
            wrong("its rate takes no sample")
        }
        Sampling::Continuous { per_revolution: Some(count), .. }
            if count == 0 || scan.turned_axis().is_none() =>
        {
            wrong("`per_revolution` is for the turn of one rotary axis, and 1 or more")
        }
        Sampling::Continuous { .. } => Ok(()),
    }
}
