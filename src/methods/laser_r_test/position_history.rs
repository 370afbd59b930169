//! Time series of a continuous scan: axis positions by the control's stamps, and values of the sensor. The latency
//! τ relates the two clocks: the value stamped t + τ belongs to the position stamped t. Positions may be
//! interpolated, as axes have inertia. Values are never interpolated.

use nalgebra::Vector3;

use machine::record::reading::{Reading, ReadingFlag};

/// Time before and after an instant over which its velocity is computed, s.
const VELOCITY_HALF_SPAN_S: f64 = 5e-3;
/// Ratio of the time between two stamps to its median, above which there is a gap.
const MIN_GAP_TO_MEDIAN_INTERVAL_RATIO: f64 = 5.0;
/// Samples within this distance after a reversal of an axis are excluded, mm: its lost motion is taken up by then. The
/// same distance before the reversal is excluded too, otherwise the samples near turning points would have one
/// direction only.
const REVERSAL_EXCLUSION_DISTANCE_MM: f64 = 0.05;
/// Fraction of the fastest speed of the scan below which a sample is excluded: the lost motion is uncertain at
/// standstill.
const STANDSTILL_SPEED_RATIO: f64 = 0.05;
/// Largest error of interpolated positions, mm. Samples with a larger error, where the velocity changes too abruptly
/// for the stamps, are not used.
const MAX_INTERPOLATION_ERROR_MM: f64 = 0.1e-3;
/// Apparent motion of an axis at standstill, mm.
const STANDSTILL_JITTER_MM: f64 = 2e-3;

/// Readings of one scan in the order of time.
#[derive(Debug, Clone)]
pub struct PositionHistory {
    stamp_times_s: Vec<f64>,
    /// Positions X, Y, Z at the stamps, mm.
    stamp_xyz: Vec<Vector3<f64>>,
    /// Derivatives of `stamp_xyz` by time, mm/s.
    stamp_velocities: Vec<Vector3<f64>>,
    /// For each stamp, whether positions between it and the next one can be interpolated.
    is_interval_interpolable: Vec<bool>,
    /// Direction of the last motion at each stamp: [`last_motion_signs_of_axis`] of each axis.
    last_motion_signs: Vec<Option<Vector3<f64>>>,
    /// Fastest speed, mm/s.
    max_speed_mm_s: f64,
    /// Time between two stamps above which there is a gap, s.
    min_gap_s: f64,
    /// Time stamp, s, and value, mm, of each sensor reading without a flag.
    sensor_times_and_values: Vec<(f64, f64)>,
}

/// A sensor reading, with position and velocity of X, Y and Z at its time (stamp minus latency).
#[derive(Debug, Clone, Copy)]
pub struct TimedSample {
    pub xyz: Vector3<f64>,
    /// Velocity of X, Y, Z, mm/s.
    pub velocity: Vector3<f64>,
    /// Sign of the last motion of each of X, Y, Z; 0 before the first motion.
    pub last_motion_sign: Vector3<f64>,
    pub reading_mm: f64,
    /// Time stamp of the reading, not corrected for the latency, s.
    pub sensor_stamp_s: f64,
}

impl PositionHistory {
    /// Readings with a flag give a position only. Of several readings with the same time, one gives the position.
    pub fn new(readings: &[&Reading]) -> Self {
        let mut sorted = readings.to_vec();
        sorted.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
        let good = sorted.iter().filter(|reading| reading.flag == ReadingFlag::None);
        let values = good.filter_map(|reading| Some((reading.t_s, reading.value_mm?))).collect();
        sorted.dedup_by(|later, earlier| later.t_s <= earlier.t_s);
        let t_s: Vec<f64> = sorted.iter().map(|reading| reading.t_s).collect();
        let xyz: Vec<Vector3<f64>> = sorted.iter().map(|reading| reading.position.xyz_or_zero()).collect();
        let intervals = stamp_intervals(&t_s, &xyz);
        let mut durations_s: Vec<f64> = intervals.iter().map(|interval| interval.duration_s).collect();
        durations_s.sort_by(f64::total_cmp);
        let min_gap_s =
            MIN_GAP_TO_MEDIAN_INTERVAL_RATIO * durations_s.get(durations_s.len() / 2).copied().unwrap_or_default();
        let stamp_velocities: Vec<_> = (0..xyz.len()).map(|k| stamp_velocity(&intervals, k, min_gap_s)).collect();
        let is_interpolable = (0..intervals.len()).map(|i| is_interval_interpolable(&intervals, i)).collect();
        let max_speed_mm_s = stamp_velocities.iter().map(|velocity| velocity.norm()).fold(0.0, f64::max);
        let mut last_motion_sign: Vec<Option<Vector3<f64>>> = Vec::with_capacity(xyz.len());
        // After a gap the direction of the last motion is unknown.
        let apart = |k: &usize| t_s.get(k - 1..=*k).is_none_or(|pair| pair[1] - pair[0] > min_gap_s);
        let mut from = 0;
        for to in (1..xyz.len()).filter(apart).chain([xyz.len()]) {
            last_motion_sign.extend(xyz.get(from..to).map(self::last_motion_signs).unwrap_or_default());
            from = to;
        }
        Self {
            last_motion_signs: last_motion_sign,
            stamp_velocities,
            is_interval_interpolable: is_interpolable,
            max_speed_mm_s,
            stamp_times_s: t_s,
            stamp_xyz: xyz,
            min_gap_s,
            sensor_times_and_values: values,
        }
    }

    /// Values with the axis positions for this latency. Values near reversals, at standstill, at abrupt changes of
    /// velocity, and without a nearby stamp are omitted.
    pub fn timed_samples(&self, latency_s: f64) -> Vec<TimedSample> {
        let timed_sample = |&(stamp_s, reading_mm): &(f64, f64)| {
            let t_s = stamp_s - latency_s;
            let (xyz, velocity) = (self.position_at(t_s)?, self.velocity_at(t_s)?);
            let node = self.stamp_times_s.partition_point(|stamp| *stamp <= t_s).checked_sub(1)?;
            let last_motion_sign = self.last_motion_signs.get(node).copied().flatten()?;
            // An axis may also have reversed between the two stamps.
            let next = self.stamp_times_s.partition_point(|stamp| *stamp < t_s);
            self.last_motion_signs.get(next).copied().flatten()?;
            let is_sure =
                self.stamp_times_s.get(node) == Some(&t_s) || self.is_interval_interpolable.get(node) == Some(&true);
            let is_sign_unknown = |k: usize| {
                last_motion_sign[k] == 0.0 && velocity[k].abs() > STANDSTILL_SPEED_RATIO * self.max_speed_mm_s
            };
            let is_slow = velocity.norm() < STANDSTILL_SPEED_RATIO * self.max_speed_mm_s;
            let sample = TimedSample { xyz, velocity, last_motion_sign, reading_mm, sensor_stamp_s: stamp_s };
            (is_sure && !is_slow && !(0..3).any(is_sign_unknown)).then_some(sample)
        };
        self.sensor_times_and_values.iter().filter_map(timed_sample).collect()
    }

    /// The same sample with another latency, without another check of its reliability. `None`: there is no position.
    pub fn sample_at_latency(&self, sample: &TimedSample, latency_s: f64) -> Option<TimedSample> {
        let t_s = sample.sensor_stamp_s - latency_s;
        Some(TimedSample { xyz: self.position_at(t_s)?, velocity: self.velocity_at(t_s)?, ..*sample })
    }

    /// Number of sensor readings that have a value and no flag.
    pub fn valid_reading_count(&self) -> usize {
        self.sensor_times_and_values.len()
    }

    /// Position between two stamps by cubic (Hermite) interpolation with the velocities at the stamps. The error of
    /// linear interpolation under acceleration would be 1 um at 500 mm/s² and 4 ms. `None`: outside the stamps or in a
    /// gap.
    fn position_at(&self, t_s: f64) -> Option<Vector3<f64>> {
        let next = self.stamp_times_s.partition_point(|stamp| *stamp < t_s);
        let node =
            |k: usize| Some((*self.stamp_times_s.get(k)?, *self.stamp_xyz.get(k)?, *self.stamp_velocities.get(k)?));
        let (after, to, last) = node(next)?;
        if after == t_s {
            return Some(to);
        }
        let (before, from, first) = node(next.checked_sub(1)?)?;
        let (duration_s, u) = (after - before, (t_s - before) / (after - before));
        let bent = (first * duration_s - (to - from)) * (1.0 - u) - (last * duration_s - (to - from)) * u;
        (duration_s <= self.min_gap_s).then(|| from + (to - from) * u + bent * u * (1.0 - u))
    }

    /// Velocity from the interpolated positions before and after `t_s`; at the ends from one side only.
    fn velocity_at(&self, t_s: f64) -> Option<Vector3<f64>> {
        let (here, before, after) = (
            self.position_at(t_s)?,
            self.position_at(t_s - VELOCITY_HALF_SPAN_S),
            self.position_at(t_s + VELOCITY_HALF_SPAN_S),
        );
        match (before, after) {
            (Some(before), Some(after)) => Some((after - before) / (2.0 * VELOCITY_HALF_SPAN_S)),
            (None, Some(after)) => Some((after - here) / VELOCITY_HALF_SPAN_S),
            (Some(before), None) => Some((here - before) / VELOCITY_HALF_SPAN_S),
            (None, None) => None,
        }
    }
}

/// Motion from one stamp to the next.
struct StampInterval {
    duration_s: f64,
    /// Mean velocity, mm/s.
    velocity: Vector3<f64>,
}

fn stamp_intervals(t_s: &[f64], xyz: &[Vector3<f64>]) -> Vec<StampInterval> {
    let interval = |(t, p): (&[f64], &[Vector3<f64>])| {
        let duration_s = t[1] - t[0];
        StampInterval { duration_s, velocity: (p[1] - p[0]) / duration_s }
    };
    t_s.windows(2).zip(xyz.windows(2)).map(interval).collect()
}

/// Whether the interpolation error in the interval `i` is small enough. For different accelerations at its ends the
/// error is a sixteenth of the second difference of the neighbouring velocities, times the duration.
fn is_interval_interpolable(intervals: &[StampInterval], i: usize) -> bool {
    let StampInterval { duration_s, velocity } = intervals[i];
    let neighbour = |k: Option<usize>| k.and_then(|k| intervals.get(k)).map_or(velocity, |interval| interval.velocity);
    let (before, after) = (neighbour(i.checked_sub(1)), neighbour(i.checked_add(1)));
    (before + after - velocity * 2.0).norm() * duration_s / 16.0 <= MAX_INTERPOLATION_ERROR_MM
}

/// Derivative at a stamp, from the parabola through the stamp and its neighbours. Next to a gap: mean velocity to the
/// neighbour on the same side of the gap.
fn stamp_velocity(intervals: &[StampInterval], stamp_index: usize, min_gap_s: f64) -> Vector3<f64> {
    let interval = |k: usize| intervals.get(k).filter(|interval| interval.duration_s <= min_gap_s);
    match (stamp_index.checked_sub(1).and_then(interval), interval(stamp_index)) {
        (Some(a), Some(b)) => (a.velocity * b.duration_s + b.velocity * a.duration_s) / (a.duration_s + b.duration_s),
        (before, after) => before.or(after).map_or(Vector3::zeros(), |interval| interval.velocity),
    }
}

/// [`last_motion_signs_of_axis`] of X, Y and Z. `None` near a reversal of one of them.
fn last_motion_signs(positions: &[Vector3<f64>]) -> Vec<Option<Vector3<f64>>> {
    let signs =
        |k: usize| last_motion_signs_of_axis(&positions.iter().map(|position| position[k]).collect::<Vec<f64>>());
    let [x, y, z] = [signs(0), signs(1), signs(2)];
    let each = x.into_iter().zip(y).zip(z);
    each.map(|((x, y), z)| Some(Vector3::new(x?, y?, z?))).collect()
}

/// For each position of one axis, the sign of its last motion, or 0 if it has not moved yet. `None` from
/// [`REVERSAL_EXCLUSION_DISTANCE_MM`] before a reversal until the axis has moved back by the same distance.
fn last_motion_signs_of_axis(positions: &[f64]) -> Vec<Option<f64>> {
    let mut signs: Vec<Option<f64>> = Vec::with_capacity(positions.len());
    let mut sign = 0.0;
    let first = positions.first().copied().unwrap_or_default();
    let (mut least, mut most) = (first, first);
    for position in positions {
        (least, most) = (least.min(*position), most.max(*position));
        let turned =
            match (position - least > REVERSAL_EXCLUSION_DISTANCE_MM, most - position > REVERSAL_EXCLUSION_DISTANCE_MM)
            {
                (true, _) if sign <= 0.0 => 1.0,
                (_, true) if sign >= 0.0 => -1.0,
                _ => {
                    signs.push(Some(sign));
                    continue;
                }
            };
        let extreme = if turned > 0.0 { least } else { most };
        let within = |k: usize, mm: f64| positions.get(k).is_none_or(|p| (p - extreme) * turned <= mm);
        // Standstill must last longer than one or two stamps near the turning point, between which the motion would
        // appear uniform.
        let is_standstill = |k: usize| (k.saturating_sub(1)..=k + 1).all(|k| within(k, STANDSTILL_JITTER_MM));
        let near_reversal =
            signs.iter_mut().enumerate().rev().take_while(|(k, _)| within(*k, REVERSAL_EXCLUSION_DISTANCE_MM));
        near_reversal.filter(|(k, _)| !is_standstill(*k)).for_each(|(_, sign)| *sign = None);
        (sign, least, most) = (turned, *position, *position);
        signs.push(Some(sign));
    }
    signs
}

#[cfg(test)]
mod tests {
    use super::*;
    use machine::{Axis, Position};

    fn reading(t_s: f64, x: f64, flag: ReadingFlag) -> Reading {
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
    fn sample_gets_the_position_one_latency_before_its_stamp() {
        let x = |t: f64| 10.0 * t;
        let all: Vec<Reading> =
            (0..=100).map(|i| f64::from(i) * 0.01).map(|t| reading(t, x(t), ReadingFlag::None)).collect();
        let history = PositionHistory::new(&all.iter().rev().collect::<Vec<_>>());
        let found = |latency: f64| {
            let seen = history.timed_samples(latency);
            *seen.iter().find(|seen| (seen.sensor_stamp_s - 0.5).abs() < 1e-9).unwrap()
        };
        assert!((found(0.02).xyz.x - 4.8).abs() < 1e-9);
        assert!((found(0.015).xyz.x - 4.85).abs() < 1e-9);
        assert!((found(-0.02).xyz.x - 5.2).abs() < 1e-9);
        assert!((found(0.02).velocity.x - 10.0).abs() < 1e-9);
        assert_eq!((found(0.02).reading_mm, found(0.02).last_motion_sign), (5.0, Vector3::x()));
        // Two values at the beginning have no position, as the stamps start later. At the next ones the axis has
        // not moved far enough.
        assert_eq!(history.valid_reading_count(), 101);
        assert!((97..=98).contains(&history.timed_samples(0.02).len()), "{}", history.timed_samples(0.02).len());
    }

    /// Acceleration: exact to the last digit at 500 mm/s² and stamps 4 ms apart.
    #[test]
    fn sample_position_is_exact_under_acceleration() {
        let x = |t: f64| 250.0 * t * t;
        let times = (0..=20).map(|i| f64::from(i) * 4e-3);
        let all: Vec<Reading> = times.map(|t| reading(t, x(t), ReadingFlag::None)).collect();
        let seen = PositionHistory::new(&all.iter().collect::<Vec<_>>()).timed_samples(2e-3);
        let fast: Vec<&TimedSample> = seen.iter().filter(|seen| (0.01..0.075).contains(&seen.sensor_stamp_s)).collect();
        assert!(fast.len() > 10);
        assert!(fast.iter().all(|seen| (seen.xyz.x - x(seen.sensor_stamp_s - 2e-3)).abs() < 1e-12));
    }

    #[test]
    fn gaps_and_flagged_values_give_no_samples() {
        let time = |i: u32| f64::from(i) * 0.01 + if i > 50 { 1.0 } else { 0.0 };
        let flag = |i| if i == 20 { ReadingFlag::Range } else { ReadingFlag::None };
        let all: Vec<Reading> = (0..=100).map(|i| reading(time(i), 10.0 * time(i), flag(i))).collect();
        let history = PositionHistory::new(&all.iter().collect::<Vec<_>>());
        let seen = history.timed_samples(0.005);
        assert!(seen.iter().all(|seen| (seen.sensor_stamp_s - 0.2).abs() > 1e-9));
        // The first two values and the first two after the gap are omitted.
        assert_eq!((history.valid_reading_count(), seen.len()), (100, 96));
        assert!(seen.iter().all(|seen| (seen.xyz.x - 10.0 * (seen.sensor_stamp_s - 0.005)).abs() < 1e-9));
    }

    #[test]
    fn samples_near_a_reversal_are_excluded() {
        let trembling = |i: u32| f64::from(i % 2) * 1e-3;
        let up = (0..100).map(|i| f64::from(i) * 0.01);
        let down = (0..100).map(|i| 0.99 - f64::from(i) * 0.01);
        let places: Vec<f64> = (0..50).map(trembling).chain(up).chain(down).collect();
        let ways = last_motion_signs_of_axis(&places);
        let count = |way| ways.iter().filter(|found| **found == way).count();
        assert_eq!(ways[10], Some(0.0));
        assert_eq!((ways[60], ways[160]), (Some(1.0), Some(-1.0)));
        // Samples between the stamps on either side of the turning point are omitted as well.
        assert_eq!((ways[149], ways[150], ways[152]), (None, None, None));
        // Positions before the reversal are omitted over the same distance as after it.
        assert_eq!((ways[143], ways[146]), (Some(1.0), None));
        // Excluded: 10 to 50 um from the start, and the range before and after the reversal.
        assert!((15..=18).contains(&count(None)), "{ways:?}");
    }
}
