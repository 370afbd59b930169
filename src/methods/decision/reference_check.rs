//! The references of a plan: reference points that are touched, or measured by a sensor, repeatedly to see whether the
//! machine has moved.

use nalgebra::Vector3;

use super::reference_shifts::{ReferencePair, ReferenceShift, ShiftLimits, TouchScatter};
use machine::frame::unit_vector;
use machine::record::plan::{FIRST_REPEAT_NUMBER_AFTER_STOP, Plan, Stage, Step, StepKind};
use machine::record::reading::{Reading, ReadingFlag};
use machine::{Axis, Position};

/// Distance below which positions are the same reference point, mm or rad.
const EQUAL_POSITION_TOLERANCE: f64 = 1e-9;
/// Cosine of 1°, the angle within which two directions are the same.
const MIN_SAME_DIRECTION_COSINE: f64 = 0.999_85;

/// One reference point and its readings before the stop.
struct ReferencePoint<'a> {
    /// The last measurement of the point before the stop.
    newest: ReferenceMeasurement<'a>,
    /// Measurements of the point before the stop, in their order.
    measurements: Vec<ReferenceMeasurement<'a>>,
}

/// Reading of one touch of a reference point, or the mean of all samples taken there at one time. Each point of a scan
/// is a reference point of its own: the points on the flanks detect a displacement across the beam.
#[derive(Clone, Copy)]
struct ReferenceMeasurement<'a> {
    step: &'a Step,
    /// Number within the scan: point by point, and at each point sensor by sensor.
    scan_measurement_index: usize,
    /// Repeat number of the readings; from `FIRST_REPEAT_NUMBER_AFTER_STOP` on they were taken after a stop.
    repeat_number: u32,
    /// Position of the surface against the direction of the touch, or minus the mean distance that the sensor measured,
    /// mm. Only differences have a meaning.
    outward_position_mm: f64,
    /// Time of the first good reading on the clock of the run, s.
    time_in_run_s: f64,
}

/// Measurements of the references since the artefact was last mounted, in the order of measurement. Flagged readings
/// are ignored, except those with the flag `Gap`: they are good, only earlier readings were lost.
fn reference_measurements<'a>(plan: &'a Plan, readings: &[Reading]) -> Vec<ReferenceMeasurement<'a>> {
    let good = |reading: &&Reading| matches!(reading.flag, ReadingFlag::None | ReadingFlag::Gap);
    let same = |one: &Reading, other: &Reading| (one.step, one.repeat) == (other.step, other.repeat);
    let is_same_position =
        |one: &Reading, other: &Reading| one.position == other.position && one.sensor == other.sensor;
    let measurement = |(point, readings): (usize, &[Reading])| {
        let (first, count) = (readings.iter().find(good)?, readings.iter().filter(good).count());
        let is_read = |step: &&Step| step.id == first.step && step.kind == StepKind::Reference;
        let step = plan.steps.iter().find(is_read)?;
        let found = readings.iter().filter(good).map(|reading| outward_position_mm(step, reading));
        let outward_position_mm = found.sum::<f64>() / count as f64;
        Some(ReferenceMeasurement {
            step,
            scan_measurement_index: point,
            repeat_number: first.repeat,
            outward_position_mm,
            time_in_run_s: first.t_s,
        })
    };
    let readings = readings_since_last_mount(plan, readings);
    let steps = readings.chunk_by(same);
    steps.flat_map(|step| step.chunk_by(is_same_position).enumerate().filter_map(measurement)).collect()
}

/// Readings since the artefact was last mounted; only these can be compared.
fn readings_since_last_mount<'r>(plan: &Plan, readings: &'r [Reading]) -> &'r [Reading] {
    let last_read = readings.iter().map(|reading| reading.step).max();
    let mounts = plan.steps.iter().filter(|step| step.mount.is_some() && Some(step.id) < last_read);
    let mounted = mounts.map(|step| step.id).max();
    let first = readings.iter().position(|reading| Some(reading.step) > mounted);
    first.and_then(|first| readings.get(first..)).unwrap_or_default()
}

/// The reference points that were measured before a stop, for comparison with the measurements after it.
pub struct ReferencePoints<'a> {
    plan: &'a Plan,
    points: Vec<ReferencePoint<'a>>,
}

impl<'a> ReferencePoints<'a> {
    /// Readings that were repeated after an earlier stop count only if the run continued after them;
    /// otherwise their agreement was never confirmed.
    pub fn from_readings(plan: &'a Plan, readings: &'a [Reading]) -> Self {
        let ordinary = |reading: &Reading| reading.repeat < FIRST_REPEAT_NUMBER_AFTER_STOP;
        let agreed = readings.iter().rposition(ordinary).map_or(0, |last| last + 1);
        let mut references: Vec<ReferencePoint<'a>> = Vec::new();
        for measurement in reference_measurements(plan, readings.get(..agreed).unwrap_or_default()) {
            let is_same_point = |reference: &&mut ReferencePoint<'_>| {
                reference.newest.scan_measurement_index == measurement.scan_measurement_index
                    && have_same_path(reference.newest.step, measurement.step)
            };
            match references.iter_mut().find(is_same_point) {
                Some(reference) => {
                    reference.newest = measurement;
                    reference.measurements.push(measurement);
                }
                None => references.push(ReferencePoint { newest: measurement, measurements: vec![measurement] }),
            }
        }
        Self { plan, points: references }
    }

    /// Whether the reference points cover every direction in which the references of the plan touch: each direction was
    /// touched before the stop. `false` without any reference point.
    pub fn covers_all_reference_directions(&self) -> bool {
        let mut reference_steps = self.plan.steps.iter().filter(|step| step.kind == StepKind::Reference);
        !self.points.is_empty()
            && reference_steps
                .all(|step| self.points.iter().any(|reference| have_same_direction(reference.newest.step, step)))
    }

    /// The stage that measures all reference points again, after the given stages.
    pub fn reference_repeat_stage(&self, stages: &[Stage]) -> Stage {
        let stops = stages.iter().filter(|stage| stage.repeat >= FIRST_REPEAT_NUMBER_AFTER_STOP).count();
        let last = stages.last();
        let touches =
            |stage: &&Stage| self.points.iter().any(|reference| stage.steps.contains(&reference.newest.step.id));
        // A stage records the artefact position for which its steps are planned; a later stage may assume another.
        let mut steps: Vec<u32> = self.points.iter().map(|reference| reference.newest.step.id).collect();
        // The points of a scan are reference points of one step.
        steps.dedup();
        let touching_stage = stages.iter().rev().find(touches);
        Stage {
            id: last.map_or(0, |stage| stage.id),
            name: "references after a stop".to_owned(),
            repeat: FIRST_REPEAT_NUMBER_AFTER_STOP + stops as u32,
            steps,
            found: touching_stage.or(last).and_then(|stage| stage.found.clone()),
        }
    }

    /// Number of times that the references are touched after a stop: 1, or 2 if the repeatability of touches is not
    /// declared or the method uses sensors, since it must then come from the references themselves.
    pub fn repeats_after_stop(&self) -> u32 {
        if self.declared_repeatability_mm().is_some() { 1 } else { 2 }
    }

    /// Declared repeatability of a touch, mm. `None` for a method with sensors: the repeatability of a mean of samples
    /// includes an unknown part from the machine.
    fn declared_repeatability_mm(&self) -> Option<f64> {
        let touched = self.plan.sensors.is_empty();
        self.plan.probe.repeatability_um.filter(|_| touched).map(|um| um * 1e-3)
    }

    /// Compares the first reading of each reference point after the stop (from `readings`) with the last reading before
    /// the stop. Returns the shifts, without points that have no reading after the stop, and the scatter that the
    /// limits follow from.
    pub fn shifts_and_scatter_after_stop(&self, readings: &[Reading]) -> (Vec<ReferenceShift>, TouchScatter) {
        let repeated = reference_measurements(self.plan, readings);
        let after = |reference: &ReferencePoint<'_>| -> Vec<f64> {
            let is_same_point = repeated.iter().filter(|measurement| reference.is_measured_by(measurement));
            is_same_point.map(|measurement| measurement.outward_position_mm).collect()
        };
        let both = |reference: &ReferencePoint<'_>| [reference.outward_positions_before_stop_mm(), after(reference)];
        let series: Vec<Vec<f64>> = self.points.iter().flat_map(both).collect();
        let scatter = TouchScatter::from_series(self.declared_repeatability_mm(), &series);
        let drift_mm_per_s = self.plan.machine.drift_um_per_h * 1e-3 / 3600.0;
        let pair = |reference: &ReferencePoint<'_>| {
            let before = &reference.newest;
            let after = repeated.iter().find(|measurement| reference.is_measured_by(measurement))?;
            Some(ReferencePair {
                label: reference.label(),
                position_before_after_mm: [before, after].map(|measurement| measurement.outward_position_mm),
                times_in_run_before_after_s: [before.time_in_run_s, after.time_in_run_s],
                resolution_mm: self.resolution_along_touch_mm(before.step),
            })
        };
        let pairs: Vec<ReferencePair> = self.points.iter().filter_map(pair).collect();
        let limits = ShiftLimits::new(scatter, pairs.len(), drift_mm_per_s);
        let shifts = pairs.iter().map(|pair| ReferenceShift::from_pair(pair, &limits)).collect();
        (shifts, scatter)
    }

    /// Labels of the reference points that have no good reading in `readings`.
    pub fn labels_without_reading(&self, readings: &[Reading]) -> Vec<String> {
        let repeated = reference_measurements(self.plan, readings);
        let is_unread =
            |reference: &&ReferencePoint<'_>| !repeated.iter().any(|measurement| reference.is_measured_by(measurement));
        self.points.iter().filter(is_unread).map(ReferencePoint::label).collect()
    }

    /// One step of the displayed position along the touch, mm.
    fn resolution_along_touch_mm(&self, step: &Step) -> f64 {
        let width = |axis| self.plan.machine.axes.get(&axis).map_or(0.0, |spec| spec.resolution_um);
        let widths = Vector3::from(Axis::LINEAR.map(width));
        (touch_direction(step).component_mul(&widths) * 1e-3).norm()
    }
}

impl ReferencePoint<'_> {
    /// Whether step and number within the scan are those of the reference point.
    fn is_measured_by(&self, measurement: &ReferenceMeasurement<'_>) -> bool {
        let identity =
            |measurement: &ReferenceMeasurement<'_>| (measurement.step.id, measurement.scan_measurement_index);
        identity(measurement) == identity(&self.newest)
    }

    fn label(&self) -> String {
        let ReferenceMeasurement { step, scan_measurement_index, .. } = self.newest;
        if step.scan.is_none() {
            return step.label.clone();
        }
        let sensors = step.sensors.len().max(1);
        let point = format!("{}, point {}", step.label, scan_measurement_index / sensors + 1);
        match step.sensors.get(scan_measurement_index % sensors) {
            Some(sensor) if sensors > 1 => format!("{point}, {sensor}"),
            _ => point,
        }
    }

    /// Readings of the reference point before any stop, mm.
    fn outward_positions_before_stop_mm(&self) -> Vec<f64> {
        let ordinary =
            self.measurements.iter().filter(|measurement| measurement.repeat_number < FIRST_REPEAT_NUMBER_AFTER_STOP);
        ordinary.map(|measurement| measurement.outward_position_mm).collect()
    }
}

/// Largest limit of the references that were measured again after the stop at `stop_time_s`, mm, as the run
/// compared them. `None`: `readings`, in the order of measurement, contain no such references.
pub fn largest_shift_limit_mm(plan: &Plan, readings: &[Reading], stop_time_s: f64) -> Option<f64> {
    // Readings before the stop may be slightly out of order in time, but precede it in the list.
    let last = readings.iter().rposition(|reading| reading.t_s <= stop_time_s)?;
    let (before, after) = readings.split_at(last + 1);
    let repeated = after.iter().take_while(|reading| reading.repeat >= FIRST_REPEAT_NUMBER_AFTER_STOP).count();
    let (shifts, _) =
        ReferencePoints::from_readings(plan, before).shifts_and_scatter_after_stop(after.get(..repeated)?);
    shifts.iter().map(|shift| shift.limit_mm).reduce(f64::max)
}

/// Unit vector of the touch; for a scan, the direction opposite to the normal of its surface.
fn touch_direction(step: &Step) -> Vector3<f64> {
    let direction = match step.scan {
        None => step.to.xyz_or_zero() - step.from.xyz_or_zero(),
        Some(_) => -Vector3::from(step.normal),
    };
    unit_vector(direction).unwrap_or_default()
}

/// Whether the touches have the same direction, within 1°.
fn have_same_direction(one: &Step, other: &Step) -> bool {
    touch_direction(one).dot(&touch_direction(other)) > MIN_SAME_DIRECTION_COSINE
}

/// Position against the direction of the touch, mm; for a sample, minus the distance to the surface, because only
/// changes count and the axes are at the same position for every sample of a point.
fn outward_position_mm(step: &Step, reading: &Reading) -> f64 {
    match reading.value_mm {
        Some(distance) => -distance,
        None => -touch_direction(step).dot(&reading.position.xyz_or_zero()),
    }
}

/// Whether both steps start and end at the same positions of all axes.
fn have_same_path(one: &Step, other: &Step) -> bool {
    let same = |a: &Position, b: &Position| {
        Axis::ALL.into_iter().all(|axis| match (a.get(axis), b.get(axis)) {
            (Some(a), Some(b)) => (a - b).abs() <= EQUAL_POSITION_TOLERANCE,
            (a, b) => a.is_none() && b.is_none(),
        })
    };
    same(&one.from, &other.from) && same(&one.to, &other.to)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan() -> Plan {
        serde_json::from_value(serde_json::json!({
            "trued_plan": 1, "method": "laser-r-test", "settings": {},
            "machine": {"name": "mill", "topology": "w-C-B-X-F-Z-Y-S-t"},
            "probe": {"ball_radius_mm": 3.0},
            "sensors": [{"name": "laser", "kind": "displacement", "zero_mm": [0, 0, -150],
                         "direction": [0, 0, -1], "range_mm": [-10, 10]}],
            "artefact": {"kind": "balls", "balls": []},
            "steps": [{"id": 4, "stage": 0, "kind": "reference", "label": "pose/first", "from": {"X": 0},
                       "to": {"X": 2}, "feed_mm_min": 600, "sensor": "laser", "normal": [0, 0, 1],
                       "path": [{"X": 0}, {"X": 1}, {"X": 2}], "dwell_s": 0.1, "samples": 1}],
        }))
        .unwrap()
    }

    fn readings(repeat: u32, flags: [ReadingFlag; 3]) -> Vec<Reading> {
        let reading = |(k, flag): (usize, ReadingFlag)| Reading {
            step: 4,
            repeat,
            position: Position::new().with(Axis::X, k as f64),
            value_mm: Some(0.5),
            sensor: "laser".to_owned(),
            t_s: f64::from(repeat) + k as f64,
            flag,
            temperatures_c: Default::default(),
        };
        flags.into_iter().enumerate().map(reading).collect()
    }

    /// A reference point without a new reading does not count as agreeing.
    #[test]
    fn unrepeated_references_are_named() {
        let (plan, before) = (plan(), readings(0, [ReadingFlag::None; 3]));
        let references = ReferencePoints::from_readings(&plan, &before);
        assert!(references.covers_all_reference_directions());
        let repeated = |flags| readings(FIRST_REPEAT_NUMBER_AFTER_STOP, flags);
        let compared = |after: &[Reading]| references.shifts_and_scatter_after_stop(after).0.len();
        let all = repeated([ReadingFlag::None, ReadingFlag::Gap, ReadingFlag::None]);
        assert_eq!((compared(&all), references.labels_without_reading(&all).len()), (3, 0));
        let some = repeated([ReadingFlag::None, ReadingFlag::Stale, ReadingFlag::Range]);
        assert_eq!(compared(&some), 1);
        assert_eq!(references.labels_without_reading(&some), ["pose/first, point 2", "pose/first, point 3"]);
        assert_eq!(references.labels_without_reading(&[]).len(), 3);
    }

    /// The samples of one point may end later than those of the next point. They still count as readings
    /// before the stop.
    #[test]
    fn shift_limit_is_found_in_slightly_disordered_readings() {
        let (plan, seen) = (plan(), [ReadingFlag::None; 3]);
        let mut all = readings(0, seen);
        let [.., earlier, last] = all.as_mut_slice() else { unreachable!() };
        let gap_s = last.t_s;
        earlier.t_s = gap_s + 0.1;
        for round in 0..2 {
            let mut repeated = readings(FIRST_REPEAT_NUMBER_AFTER_STOP + round, seen);
            repeated.iter_mut().for_each(|reading| reading.value_mm = Some(0.5 + 1e-4 * f64::from(round)));
            all.extend(repeated);
        }
        assert!(largest_shift_limit_mm(&plan, &all, gap_s).is_some());
        assert_eq!(largest_shift_limit_mm(&plan, &all[..3], gap_s + 0.1), None);
    }
}
