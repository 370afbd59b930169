//! The references of a plan: places that are touched, or measured by a sensor, repeatedly to see whether the
//! machine has moved.

use super::references::{Limits, ReferencePair, Scatter, Shift};
use machine::record::plan::{Plan, REPEAT_AFTER_STOP, Stage, Step, StepKind};
use machine::record::reading::{Flag, Reading};
use machine::{Axis, Position};

/// Distance below which positions are the same place, mm or rad.
const POSITION_TOLERANCE: f64 = 1e-9;
/// Cosine of 1°, the angle within which two directions are the same.
const MIN_DIRECTION_COSINE: f64 = 0.999_85;

/// One place and its readings before the stop.
struct Place<'a> {
    /// The newest step that touched the place.
    step: &'a Step,
    point: usize,
    /// Visits in the order of measurement.
    visits: Vec<Visit<'a>>,
}

/// Reading of one touch of a place, or the mean of all samples taken there at one time. Each point of a scan
/// is a place of its own: the points on the flanks detect a displacement across the beam.
#[derive(Clone, Copy)]
struct Visit<'a> {
    step: &'a Step,
    /// Number within the scan: point by point, and at each point sensor by sensor.
    point: usize,
    repeat: u32,
    /// Position of the surface against the direction of the touch, or along the normal of the scan, mm.
    outward_mm: f64,
    t_s: f64,
}

/// Visits of the references, in the order of measurement. Flagged readings are ignored, except good ones
/// before which others were lost.
fn visits<'a>(plan: &'a Plan, readings: &[Reading]) -> Vec<Visit<'a>> {
    let good = |reading: &&Reading| matches!(reading.flag, Flag::None | Flag::Gap);
    let same =
        |one: &Reading, other: &Reading| (one.step, one.repeat) == (other.step, other.repeat);
    let stands = |one: &Reading, other: &Reading| {
        one.position == other.position && one.sensor == other.sensor
    };
    let visit = |(point, readings): (usize, &[Reading])| {
        let (first, count) = (readings.iter().find(good)?, readings.iter().filter(good).count());
        let is_read = |step: &&Step| step.id == first.step && step.kind == StepKind::Reference;
        let step = plan.steps.iter().find(is_read)?;
        let found = readings.iter().filter(good).map(|reading| outward(step, reading));
        let outward_mm = found.sum::<f64>() / count as f64;
        Some(Visit { step, point, repeat: first.repeat, outward_mm, t_s: first.t_s })
    };
    let readings = since_last_mount(plan, readings);
    let steps = readings.chunk_by(same);
    steps.flat_map(|step| step.chunk_by(stands).enumerate().filter_map(visit)).collect()
}

/// Readings since the artefact was last mounted; only these can be compared.
fn since_last_mount<'r>(plan: &Plan, readings: &'r [Reading]) -> &'r [Reading] {
    let last_read = readings.iter().map(|reading| reading.step).max();
    let mounts = plan.steps.iter().filter(|step| step.mount.is_some() && Some(step.id) < last_read);
    let mounted = mounts.map(|step| step.id).max();
    let first = readings.iter().position(|reading| Some(reading.step) > mounted);
    first.and_then(|first| readings.get(first..)).unwrap_or_default()
}

/// The places that can be compared.
pub struct References<'a> {
    plan: &'a Plan,
    places: Vec<Place<'a>>,
}

impl<'a> References<'a> {
    /// Readings that were repeated after an earlier stop count only if the run continued after them;
    /// otherwise their agreement was never confirmed.
    pub fn of(plan: &'a Plan, readings: &'a [Reading]) -> Self {
        let ordinary = |reading: &Reading| reading.repeat < REPEAT_AFTER_STOP;
        let agreed = readings.iter().rposition(ordinary).map_or(0, |last| last + 1);
        let mut places: Vec<Place<'a>> = Vec::new();
        for visit in visits(plan, readings.get(..agreed).unwrap_or_default()) {
            let there = |place: &&mut Place<'_>| {
                place.point == visit.point && same_place(place.step, visit.step)
            };
            match places.iter_mut().find(there) {
                Some(place) => {
                    place.step = visit.step;
                    place.visits.push(visit);
                }
                None => {
                    let Visit { step, point, .. } = visit;
                    places.push(Place { step, point, visits: vec![visit] });
                }
            }
        }
        Self { plan, places }
    }

    /// Whether the places cover every direction in which the references of the plan touch: each direction was
    /// touched before the stop.
    pub fn see_all(&self) -> bool {
        let mut wanted = self.plan.steps.iter().filter(|step| step.kind == StepKind::Reference);
        !self.places.is_empty()
            && wanted.all(|step| self.places.iter().any(|place| same_way(place.step, step)))
    }

    /// The stage that measures all places again, after the given stages.
    pub fn stage(&self, stages: &[Stage]) -> Stage {
        let stops = stages.iter().filter(|stage| stage.repeat >= REPEAT_AFTER_STOP).count();
        let last = stages.last();
        let touches =
            |stage: &&Stage| self.places.iter().any(|place| stage.steps.contains(&place.step.id));
        // The steps are planned for the artefact as found in that stage, not for what a later stage searches.
        let mut steps: Vec<u32> = self.places.iter().map(|place| place.step.id).collect();
        // The points of a scan are places of one step.
        steps.dedup();
        let theirs = stages.iter().rev().find(touches);
        Stage {
            id: last.map_or(0, |stage| stage.id),
            name: "references after a stop".to_owned(),
            repeat: REPEAT_AFTER_STOP + stops as u32,
            steps,
            found: theirs.or(last).and_then(|stage| stage.found.clone()),
        }
    }

    /// Number of times that the references are touched after a stop. If the repeatability of touches is not
    /// declared, it must come from the references themselves.
    pub fn rounds(&self) -> u32 {
        if self.declared_mm().is_some() { 1 } else { 2 }
    }

    /// Declared repeatability of a touch, mm. The repeatability of means of samples is not declared: the part
    /// of the machine is unknown.
    fn declared_mm(&self) -> Option<f64> {
        let touched = self.plan.sensors.is_empty();
        self.plan.probe.repeatability_um.filter(|_| touched).map(|um| um * 1e-3)
    }

    /// Compares the first reading of each place after the stop (from `readings`) with the last reading before
    /// the stop. Returns the shifts, and the scatter that the limits follow from.
    pub fn compare(&self, readings: &[Reading]) -> (Vec<Shift>, Scatter) {
        let again = visits(self.plan, readings);
        let after = |place: &Place<'_>| -> Vec<f64> {
            let there = again.iter().filter(|visit| place.is_of(visit));
            there.map(|visit| visit.outward_mm).collect()
        };
        let series: Vec<Vec<f64>> =
            self.places.iter().flat_map(|place| [place.series(), after(place)]).collect();
        let scatter = Scatter::of(self.declared_mm(), &series);
        let drift_mm_per_s = self.plan.machine.drift_um_per_h * 1e-3 / 3600.0;
        let pairs: Vec<ReferencePair> = self
            .places
            .iter()
            .filter_map(|place| {
                let is_new = |visit: &&Visit<'_>| place.is_of(visit);
                let (before, after) = (place.visits.last()?, again.iter().find(is_new)?);
                Some(ReferencePair {
                    label: place.label(),
                    position_mm: [before, after].map(|visit| visit.outward_mm),
                    t_s: [before.t_s, after.t_s],
                    resolution_mm: self.resolution(place.step),
                })
            })
            .collect();
        let limits = Limits::new(scatter, pairs.len(), drift_mm_per_s);
        let shifts = pairs.iter().map(|pair| Shift::of(pair, &limits)).collect();
        (shifts, scatter)
    }

    /// Labels of the places that have no reading in `readings`.
    pub fn unseen(&self, readings: &[Reading]) -> Vec<String> {
        let again = visits(self.plan, readings);
        let is_seen = |place: &&Place<'_>| !again.iter().any(|visit| place.is_of(visit));
        self.places.iter().filter(is_seen).map(Place::label).collect()
    }

    /// One step of the displayed position along the touch, mm.
    fn resolution(&self, step: &Step) -> f64 {
        let width = |axis| self.plan.machine.axes.get(&axis).map_or(0.0, |spec| spec.resolution_um);
        let parts = direction(step).map(|(axis, part)| (part * width(axis) * 1e-3).powi(2));
        parts.iter().sum::<f64>().sqrt()
    }
}

impl Place<'_> {
    fn is_of(&self, visit: &Visit<'_>) -> bool {
        (visit.step.id, visit.point) == (self.step.id, self.point)
    }

    fn label(&self) -> String {
        match self.step.scan {
            None => self.step.label.clone(),
            Some(_) => {
                let sensors = self.step.sensors.len().max(1);
                let point = format!("{}, point {}", self.step.label, self.point / sensors + 1);
                match self.step.sensors.get(self.point % sensors) {
                    Some(sensor) if sensors > 1 => format!("{point}, {sensor}"),
                    _ => point,
                }
            }
        }
    }

    /// Readings of the place before any stop, mm.
    fn series(&self) -> Vec<f64> {
        let ordinary = self.visits.iter().filter(|visit| visit.repeat < REPEAT_AFTER_STOP);
        ordinary.map(|visit| visit.outward_mm).collect()
    }
}

/// Largest limit of the references that were measured again after the stop at `gap_s`, mm, as the run
/// compared them. `None`: `readings`, in the order of measurement, contain no such references.
pub fn granted_mm(plan: &Plan, readings: &[Reading], gap_s: f64) -> Option<f64> {
    // Readings before the stop may be slightly out of order in time, but precede it in the list.
    let last = readings.iter().rposition(|reading| reading.t_s <= gap_s)?;
    let (before, after) = readings.split_at(last + 1);
    let again = after.iter().take_while(|reading| reading.repeat >= REPEAT_AFTER_STOP).count();
    let (shifts, _) = References::of(plan, before).compare(after.get(..again)?);
    shifts.iter().map(|shift| shift.limit_mm).reduce(f64::max)
}

/// Unit vector of the touch; for a scan, the direction opposite to the normal of its surface.
fn direction(step: &Step) -> [(Axis, f64); 3] {
    let way = match step.scan {
        None => Axis::LINEAR.map(|axis| step.to.at(axis) - step.from.at(axis)),
        Some(_) => step.normal.map(|part| -part),
    };
    let length = way.iter().map(|part| part * part).sum::<f64>().sqrt();
    let [x, y, z] = way.map(|part| if length > 0.0 { part / length } else { 0.0 });
    let [ax, ay, az] = Axis::LINEAR;
    [(ax, x), (ay, y), (az, z)]
}

fn same_way(one: &Step, other: &Step) -> bool {
    let along: f64 =
        direction(one).iter().zip(direction(other)).map(|((_, a), (_, b))| a * b).sum();
    along > MIN_DIRECTION_COSINE
}

/// Position against the direction of the touch, mm; for a sample, minus the distance to the surface. The axes
/// are at the same position then, and only changes count.
fn outward(step: &Step, reading: &Reading) -> f64 {
    match reading.value_mm {
        Some(distance) => -distance,
        None => {
            let at = |(axis, part): (Axis, f64)| part * reading.position.at(axis);
            -direction(step).map(at).iter().sum::<f64>()
        }
    }
}

fn same_place(one: &Step, other: &Step) -> bool {
    let same = |a: &Position, b: &Position| {
        Axis::ALL.into_iter().all(|axis| match (a.get(axis), b.get(axis)) {
            (Some(a), Some(b)) => (a - b).abs() <= POSITION_TOLERANCE,
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

    fn readings(repeat: u32, flags: [Flag; 3]) -> Vec<Reading> {
        let reading = |(k, flag): (usize, Flag)| Reading {
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

    /// A place without a new reading does not count as agreeing.
    #[test]
    fn what_was_not_seen_again_is_named() {
        let (plan, before) = (plan(), readings(0, [Flag::None; 3]));
        let references = References::of(&plan, &before);
        assert!(references.see_all());
        let again = |flags| readings(REPEAT_AFTER_STOP, flags);
        let compared = |after: &[Reading]| references.compare(after).0.len();
        let all = again([Flag::None, Flag::Gap, Flag::None]);
        assert_eq!((compared(&all), references.unseen(&all).len()), (3, 0));
        let some = again([Flag::None, Flag::Stale, Flag::Range]);
        assert_eq!(compared(&some), 1);
        assert_eq!(references.unseen(&some), ["pose/first, point 2", "pose/first, point 3"]);
        assert_eq!(references.unseen(&[]).len(), 3);
    }

    /// The samples of one point may end later than those of the next point. They still count as readings
    /// before the stop.
    #[test]
    fn readings_a_little_out_of_order_hide_no_references() {
        let (plan, seen) = (plan(), [Flag::None; 3]);
        let mut all = readings(0, seen);
        let [.., earlier, last] = all.as_mut_slice() else { unreachable!() };
        let gap_s = last.t_s;
        earlier.t_s = gap_s + 0.1;
        for round in 0..2 {
            let mut again = readings(REPEAT_AFTER_STOP + round, seen);
            again
                .iter_mut()
                .for_each(|reading| reading.value_mm = Some(0.5 + 1e-4 * f64::from(round)));
            all.extend(again);
        }
        assert!(granted_mm(&plan, &all, gap_s).is_some());
        assert_eq!(granted_mm(&plan, &all[..3], gap_s + 0.1), None);
    }
}
