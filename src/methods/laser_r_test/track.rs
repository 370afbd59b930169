//! Time series of a continuous scan: axis positions by the control's stamps, and values of the sensor. The latency
//! τ relates the two clocks: the value stamped t + τ belongs to the position stamped t. Positions may be
//! interpolated, as axes have inertia. Values are never interpolated.

use nalgebra::Vector3;

use machine::record::reading::{Flag, Reading};

/// Time to either side over which a velocity is computed, s.
const SPAN_S: f64 = 5e-3;
/// Ratio of the distance between two stamps to the usual one, above which there is a gap.
const GAP: f64 = 5.0;
/// Distance after a reversal from which an axis is reliable, mm: its lost motion is taken up by then. The same
/// distance before the reversal is excluded too, otherwise the samples near turning points would have one direction
/// only.
const TURNED_MM: f64 = 0.05;
/// Fraction of the fastest speed below which an axis counts as standing. Its lost motion is uncertain there.
const STANDS: f64 = 0.05;
/// Largest error of interpolated positions, mm. Samples at a larger one, where the velocity changes too abruptly
/// for the stamps, are not used.
const UNSURE_MM: f64 = 0.1e-3;
/// Apparent motion of an axis at standstill, mm.
const STANDSTILL_JITTER_MM: f64 = 2e-3;

/// Readings of one scan in the order of time.
#[derive(Debug, Clone)]
pub struct PositionHistory {
    t_s: Vec<f64>,
    /// Positions X, Y, Z at the stamps, and their derivatives by time.
    xyz: Vec<Vector3<f64>>,
    slopes: Vec<Vector3<f64>>,
    /// For each stamp, whether positions between it and the next one can be interpolated.
    sure: Vec<bool>,
    /// Direction of the last motion at each stamp: [`ways`] of each axis.
    last_motion_sign: Vec<Option<Vector3<f64>>>,
    /// Fastest speed, mm/s.
    fastest: f64,
    /// Distance between two stamps above which there is a gap, s.
    gap_s: f64,
    /// Stamps and values of the sensor without flags.
    said: Vec<(f64, f64)>,
}

/// A value, with the axis positions at the time of its measurement.
#[derive(Debug, Clone, Copy)]
pub struct TimedSample {
    pub xyz: Vector3<f64>,
    /// Velocity in mm/s, and sign of the last motion along each axis (0 before the first motion).
    pub velocity: Vector3<f64>,
    pub last_motion_sign: Vector3<f64>,
    pub value: f64,
    pub t_s: f64,
}

impl PositionHistory {
    pub fn new(readings: &[&Reading]) -> Self {
        let mut sorted = readings.to_vec();
        sorted.sort_by(|one, other| one.t_s.total_cmp(&other.t_s));
        let good = sorted.iter().filter(|reading| reading.flag == Flag::None);
        let said = good.filter_map(|reading| Some((reading.t_s, reading.value_mm?))).collect();
        sorted.dedup_by(|later, earlier| later.t_s <= earlier.t_s);
        let t_s: Vec<f64> = sorted.iter().map(|reading| reading.t_s).collect();
        let xyz: Vec<Vector3<f64>> = sorted.iter().map(|reading| reading.position.xyz()).collect();
        let mut apart: Vec<f64> = t_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        apart.sort_by(f64::total_cmp);
        let gap_s = GAP * apart.get(apart.len() / 2).copied().unwrap_or_default();
        let slopes = slopes(&t_s, &xyz, gap_s);
        let sure = sure(&t_s, &xyz);
        let fastest = slopes.iter().map(|slope| slope.norm()).fold(0.0, f64::max);
        let mut last_motion_sign: Vec<Option<Vector3<f64>>> = Vec::with_capacity(xyz.len());
        // After a gap the direction of the last motion is unknown.
        let apart = |k: &usize| t_s.get(k - 1..=*k).is_none_or(|pair| pair[1] - pair[0] > gap_s);
        let mut from = 0;
        for to in (1..xyz.len()).filter(apart).chain([xyz.len()]) {
            last_motion_sign
                .extend(xyz.get(from..to).map(self::last_motion_sign).unwrap_or_default());
            from = to;
        }
        Self { last_motion_sign, slopes, sure, fastest, t_s, xyz, gap_s, said }
    }

    /// Values with the axis positions for this latency. Omitted are values at reversals, at abrupt changes of
    /// velocity, and without a nearby stamp.
    pub fn seen(&self, latency_s: f64) -> Vec<TimedSample> {
        let seen = |&(stamp_s, value): &(f64, f64)| {
            let t_s = stamp_s - latency_s;
            let (xyz, velocity) = (self.at(t_s)?, self.velocity(t_s)?);
            let node = self.t_s.partition_point(|stamp| *stamp <= t_s).checked_sub(1)?;
            let last_motion_sign = self.last_motion_sign.get(node).copied().flatten()?;
            // An axis may also have reversed between the two stamps.
            let next = self.t_s.partition_point(|stamp| *stamp < t_s);
            self.last_motion_sign.get(next).copied().flatten()?;
            let sure = self.t_s.get(node) == Some(&t_s) || self.sure.get(node) == Some(&true);
            let unknown =
                |k: usize| last_motion_sign[k] == 0.0 && velocity[k].abs() > STANDS * self.fastest;
            let stands = velocity.norm() < STANDS * self.fastest;
            let seen = TimedSample { xyz, velocity, last_motion_sign, value, t_s: stamp_s };
            (sure && !stands && !(0..3).any(unknown)).then_some(seen)
        };
        self.said.iter().filter_map(seen).collect()
    }

    /// The same sample with another latency, without another check of its reliability.
    pub fn again(&self, seen: &TimedSample, latency_s: f64) -> Option<TimedSample> {
        let t_s = seen.t_s - latency_s;
        Some(TimedSample { xyz: self.at(t_s)?, velocity: self.velocity(t_s)?, ..*seen })
    }

    /// Number of values.
    pub fn said(&self) -> usize {
        self.said.len()
    }

    /// Position between two stamps by cubic (Hermite) interpolation with their slopes. Linear interpolation would
    /// be wrong by the motion under acceleration, 1 um at 500 mm/s² and 4 ms.
    fn at(&self, t_s: f64) -> Option<Vector3<f64>> {
        let next = self.t_s.partition_point(|stamp| *stamp < t_s);
        let node = |k: usize| Some((*self.t_s.get(k)?, *self.xyz.get(k)?, *self.slopes.get(k)?));
        let (after, to, last) = node(next)?;
        if after == t_s {
            return Some(to);
        }
        let (before, from, first) = node(next.checked_sub(1)?)?;
        let (lasts, u) = (after - before, (t_s - before) / (after - before));
        let bent = (first * lasts - (to - from)) * (1.0 - u) - (last * lasts - (to - from)) * u;
        (lasts <= self.gap_s).then(|| from + (to - from) * u + bent * u * (1.0 - u))
    }

    /// Velocity from the stamped positions to either side, or to one side at the ends.
    fn velocity(&self, t_s: f64) -> Option<Vector3<f64>> {
        let (here, before, after) = (self.at(t_s)?, self.at(t_s - SPAN_S), self.at(t_s + SPAN_S));
        match (before, after) {
            (Some(before), Some(after)) => Some((after - before) / (2.0 * SPAN_S)),
            (None, Some(after)) => Some((after - here) / SPAN_S),
            (Some(before), None) => Some((here - before) / SPAN_S),
            (None, None) => None,
        }
    }
}

/// Whether the interpolation error between two stamps is small enough. For different accelerations at the ends it
/// is a sixteenth of the second difference of the neighbouring velocities, times the duration.
fn sure(t_s: &[f64], xyz: &[Vector3<f64>]) -> Vec<bool> {
    let nodes: Vec<(f64, Vector3<f64>)> = t_s.iter().copied().zip(xyz.iter().copied()).collect();
    let passes = |pair: &[(f64, Vector3<f64>)]| match pair {
        &[(t0, p0), (t1, p1)] => (t1 - t0, (p1 - p0) / (t1 - t0)),
        _ => (0.0, Vector3::zeros()),
    };
    let passes: Vec<(f64, Vector3<f64>)> = nodes.windows(2).map(passes).collect();
    let velocity = |k: usize| passes.get(k).map(|(_, velocity)| *velocity);
    let of = |(k, (lasts, own)): (usize, &(f64, Vector3<f64>))| {
        let before = k.checked_sub(1).and_then(velocity).unwrap_or(*own);
        let after = velocity(k + 1).unwrap_or(*own);
        (before + after - *own * 2.0).norm() * lasts / 16.0 <= UNSURE_MM
    };
    passes.iter().enumerate().map(of).collect()
}

/// Derivatives at the stamps, from the parabola through each stamp and its neighbours. At a gap, from the one
/// neighbour on the same side.
fn slopes(t_s: &[f64], xyz: &[Vector3<f64>], gap_s: f64) -> Vec<Vector3<f64>> {
    let nodes: Vec<(f64, Vector3<f64>)> = t_s.iter().copied().zip(xyz.iter().copied()).collect();
    let between = |k: usize| match nodes.get(k..k + 2) {
        Some(&[(t0, p0), (t1, p1)]) if t1 - t0 <= gap_s => Some((t1 - t0, (p1 - p0) / (t1 - t0))),
        _ => None,
    };
    let slope = |k: usize| match (k.checked_sub(1).and_then(between), between(k)) {
        (Some((h0, d0)), Some((h1, d1))) => (d0 * h1 + d1 * h0) / (h0 + h1),
        (one, other) => one.or(other).map_or(Vector3::zeros(), |(_, slope)| slope),
    };
    (0..nodes.len()).map(slope).collect()
}

/// [`ways`] of X, Y and Z. `None` where one of them reverses.
fn last_motion_sign(places: &[Vector3<f64>]) -> Vec<Option<Vector3<f64>>> {
    let of = |k: usize| ways(&places.iter().map(|place| place[k]).collect::<Vec<f64>>());
    let [x, y, z] = [of(0), of(1), of(2)];
    let each = x.into_iter().zip(y).zip(z);
    each.map(|((x, y), z)| Some(Vector3::new(x?, y?, z?))).collect()
}

/// For each position of one axis, the sign of its last motion, or 0 if it has not moved yet. `None` from
/// [`TURNED_MM`] before a reversal until the axis has moved back by the same distance.
fn ways(places: &[f64]) -> Vec<Option<f64>> {
    let mut ways: Vec<Option<f64>> = Vec::with_capacity(places.len());
    let mut way = 0.0;
    let first = places.first().copied().unwrap_or_default();
    let (mut least, mut most) = (first, first);
    for place in places {
        (least, most) = (least.min(*place), most.max(*place));
        let turned = match (place - least > TURNED_MM, most - place > TURNED_MM) {
            (true, _) if way <= 0.0 => 1.0,
            (_, true) if way >= 0.0 => -1.0,
            _ => {
                ways.push(Some(way));
                continue;
            }
        };
        let extreme = if turned > 0.0 { least } else { most };
        let within = |k: usize, mm: f64| places.get(k).is_none_or(|p| (p - extreme) * turned <= mm);
        // A real standstill, not only one or two stamps near the turning point, between which the motion would
        // appear uniform.
        let stood =
            |k: usize| (k.saturating_sub(1)..=k + 1).all(|k| within(k, STANDSTILL_JITTER_MM));
        let beside = ways.iter_mut().enumerate().rev().take_while(|(k, _)| within(*k, TURNED_MM));
        beside.filter(|(k, _)| !stood(*k)).for_each(|(_, way)| *way = None);
        (way, least, most) = (turned, *place, *place);
        ways.push(Some(way));
    }
    ways
}

#[cfg(test)]
mod tests {
    use super::*;
    use machine::{Axis, Position};

    fn reading(t_s: f64, x: f64, flag: Flag) -> Reading {
        Reading {
            step: 0,
            repeat: 0,
            position: Position::new().with(Axis::X, x),
            value_mm: Some(x),
            sensor: String::new(),
            t_s,
            flag,
            temperatures_c: Default::default(),
        }
    }

    /// X leaves 0 at 10 mm/s. The value stamped 0.5 s was measured 20 ms earlier, at 4.8 mm.
    #[test]
    fn a_value_belongs_to_where_the_axes_stood_a_latency_ago() {
        let x = |t: f64| 10.0 * t;
        let all: Vec<Reading> =
            (0..=100).map(|i| f64::from(i) * 0.01).map(|t| reading(t, x(t), Flag::None)).collect();
        let track = PositionHistory::new(&all.iter().rev().collect::<Vec<_>>());
        let found = |latency: f64| {
            let seen = track.seen(latency);
            *seen.iter().find(|seen| (seen.t_s - 0.5).abs() < 1e-9).unwrap()
        };
        assert!((found(0.02).xyz.x - 4.8).abs() < 1e-9);
        assert!((found(0.015).xyz.x - 4.85).abs() < 1e-9);
        assert!((found(-0.02).xyz.x - 5.2).abs() < 1e-9);
        assert!((found(0.02).velocity.x - 10.0).abs() < 1e-9);
        assert_eq!((found(0.02).value, found(0.02).last_motion_sign), (5.0, Vector3::x()));
        // Two values at the beginning have no position, as the stamps start later. At the next ones the axis has
        // not moved far enough.
        assert_eq!(track.said(), 101);
        assert!((97..=98).contains(&track.seen(0.02).len()), "{}", track.seen(0.02).len());
    }

    /// Acceleration: exact to the last digit at 500 mm/s² and stamps 4 ms apart.
    #[test]
    fn an_axis_that_speeds_up_is_followed() {
        let x = |t: f64| 250.0 * t * t;
        let times = (0..=20).map(|i| f64::from(i) * 4e-3);
        let all: Vec<Reading> = times.map(|t| reading(t, x(t), Flag::None)).collect();
        let seen = PositionHistory::new(&all.iter().collect::<Vec<_>>()).seen(2e-3);
        let fast: Vec<&TimedSample> =
            seen.iter().filter(|seen| (0.01..0.075).contains(&seen.t_s)).collect();
        assert!(fast.len() > 10);
        assert!(fast.iter().all(|seen| (seen.xyz.x - x(seen.t_s - 2e-3)).abs() < 1e-12));
    }

    #[test]
    fn nothing_is_said_across_a_gap_and_nothing_of_flagged_values() {
        let time = |i: u32| f64::from(i) * 0.01 + if i > 50 { 1.0 } else { 0.0 };
        let flag = |i| if i == 20 { Flag::Range } else { Flag::None };
        let all: Vec<Reading> =
            (0..=100).map(|i| reading(time(i), 10.0 * time(i), flag(i))).collect();
        let track = PositionHistory::new(&all.iter().collect::<Vec<_>>());
        let seen = track.seen(0.005);
        assert!(seen.iter().all(|seen| (seen.t_s - 0.2).abs() > 1e-9));
        // The first two values and the first two after the gap are omitted.
        assert_eq!((track.said(), seen.len()), (100, 96));
        assert!(seen.iter().all(|seen| (seen.xyz.x - 10.0 * (seen.t_s - 0.005)).abs() < 1e-9));
    }

    #[test]
    fn an_axis_that_turns_round_is_not_trusted_until_it_has_come_back() {
        let trembling = |i: u32| f64::from(i % 2) * 1e-3;
        let up = (0..100).map(|i| f64::from(i) * 0.01);
        let down = (0..100).map(|i| 0.99 - f64::from(i) * 0.01);
        let places: Vec<f64> = (0..50).map(trembling).chain(up).chain(down).collect();
        let ways = ways(&places);
        let count = |way| ways.iter().filter(|found| **found == way).count();
        assert_eq!(ways[10], Some(0.0));
        assert_eq!((ways[60], ways[160]), (Some(1.0), Some(-1.0)));
        // Samples between the stamps on either side of the turning point are omitted as well.
        assert_eq!((ways[149], ways[150], ways[152]), (None, None, None));
        // Positions before the reversal are omitted over the same distance as after it.
        assert_eq!((ways[143], ways[146]), (Some(1.0), None));
        // 10 to 50 um from the start; to the reversal, and from there.
        assert!((15..=18).contains(&count(None)), "{ways:?}");
    }
}
