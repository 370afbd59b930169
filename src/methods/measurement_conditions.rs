//! Time and temperatures of the measurements that are compared with all others.

use std::collections::BTreeMap;

use crate::outlier_repeats::{is_part_of_measurement, readings_of_latest_repeats};
use machine::record::plan::{FIRST_REPEAT_NUMBER_AFTER_STOP, Plan, Sampling, Step};
use machine::record::reading::{Reading, ReadingFlag};

/// Means over the readings of one measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasurementConditions {
    /// Time on the clock of the readings, s.
    pub t_s: f64,
    /// Temperature by thermometer, °C.
    pub temperatures_c: BTreeMap<String, f64>,
}

type ReadingsByLabel<'r> = BTreeMap<String, Vec<&'r Reading>>;

/// Conditions of each measurement, in the order of `labels`. A label that occurs several times is measured in several
/// passes. `None`: no reading belongs to the label.
pub fn measurement_conditions(
    plan: &Plan,
    readings: &[Reading],
    labels: &[&str],
) -> Vec<Option<MeasurementConditions>> {
    let readings = readings_of_latest_repeats(readings, u32::MAX);
    let by_label = group_by_reading_label(plan, &readings);
    let mut remaining = BTreeMap::new();
    for label in labels {
        let count = labels.iter().filter(|other| *other == label).count();
        remaining.entry(*label).or_insert_with(|| conditions_of_label(&by_label, label, count).into_iter());
    }
    labels.iter().map(|label| remaining.get_mut(label)?.next()).collect()
}

/// Valid readings by their label.
fn group_by_reading_label<'r>(plan: &Plan, readings: &'r [Reading]) -> ReadingsByLabel<'r> {
    let steps: BTreeMap<u32, &Step> = plan.steps.iter().map(|step| (step.id, step)).collect();
    let mut by_label = ReadingsByLabel::new();
    for reading in readings.iter().filter(|reading| matches!(reading.flag, ReadingFlag::None | ReadingFlag::Gap)) {
        if let Some(step) = steps.get(&reading.step) {
            by_label.entry(reading_label(step, reading)).or_default().push(reading);
        }
    }
    by_label
}

/// Label of the step; for a sample at a point of a path, with the number of the point and the name of the sensor, as in
/// the labels of the R-test: `forward/3/x`.
fn reading_label(step: &Step, reading: &Reading) -> String {
    let scan = step.scan.as_ref().filter(|scan| matches!(scan.sampling, Sampling::Dwell { .. }));
    match scan.and_then(|scan| scan.nearest_point_index(&reading.position)) {
        Some(point) => format!("{}/{}/{}", step.label, point + 1, reading.sensor),
        None => step.label.clone(),
    }
}

/// Conditions of the `count` measurements with this label, in the order of their passes.
fn conditions_of_label(by_label: &ReadingsByLabel<'_>, label: &str, count: usize) -> Vec<MeasurementConditions> {
    let from_label = by_label.range(label.to_owned()..).take_while(|(own, _)| own.starts_with(label));
    let own = from_label.filter(|(own, _)| is_part_of_measurement(own, label)).flat_map(|(_, readings)| readings);
    let mut passes = BTreeMap::<u32, Vec<&Reading>>::new();
    own.for_each(|reading| passes.entry(reading.repeat).or_default().push(reading));
    let after_stops = passes.split_off(&FIRST_REPEAT_NUMBER_AFTER_STOP);
    let newest: Vec<_> = passes.last_key_value().map(|(_, readings)| readings.clone()).into_iter().collect();
    // Most methods use the newest pass only, and some also references after a stop.
    let after_stops: Vec<_> = after_stops.into_values().collect();
    let all = [passes.into_values().collect(), after_stops.clone()].concat();
    let used = [all.clone(), [newest.clone(), after_stops].concat(), newest].into_iter().find(|of| of.len() == count);
    match used {
        Some(passes) => passes.iter().filter_map(|readings| mean_conditions(readings)).collect(),
        // Not all passes are used, and the estimate does not state which.
        None => mean_conditions(&all.concat()).map_or(Vec::new(), |mean| vec![mean; count]),
    }
}

/// `None` without readings.
fn mean_conditions(readings: &[&Reading]) -> Option<MeasurementConditions> {
    let t_s = mean(&readings.iter().map(|reading| reading.t_s).collect::<Vec<_>>())?;
    let mut by_thermometer = BTreeMap::<&str, Vec<f64>>::new();
    for (name, celsius) in readings.iter().flat_map(|reading| reading.temperatures_c.iter()) {
        by_thermometer.entry(name).or_default().push(celsius);
    }
    let means = by_thermometer.into_iter().filter_map(|(name, all)| Some((name.to_owned(), mean(&all)?)));
    Some(MeasurementConditions { t_s, temperatures_c: means.collect() })
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use machine::record::plan::StepKind;

    fn plan_with_labels(labels: &[&str]) -> Plan {
        let step = |(id, label): (u32, &&str)| Step {
            id,
            kind: StepKind::Touch,
            label: (*label).to_owned(),
            ..Step::default()
        };
        let mut plan: Plan = serde_json::from_value(serde_json::json!({
            "trued_plan": 1, "method": "", "settings": {}, "artefact": {"kind": "none"},
            "machine": {"name": "", "topology": "", "tool_mm": [0, 0, 0]}, "probe": {"ball_radius_mm": 3.0},
        }))
        .unwrap();
        plan.steps = (0..).zip(labels).map(step).collect();
        plan
    }

    /// A touch with the temperature 20 °C + t / 128.
    fn touch(step: u32, repeat: u32, t_s: f64) -> Reading {
        let temperatures = serde_json::json!({"table": 20.0 + t_s / 128.0});
        serde_json::from_value(serde_json::json!({
            "step": step, "repeat": repeat, "position": {}, "value_mm": null, "sensor": "probe", "t_s": t_s,
            "temperatures_c": temperatures,
        }))
        .unwrap()
    }

    fn times(plan: &Plan, readings: &[Reading], labels: &[&str]) -> Vec<Option<f64>> {
        let conditions = measurement_conditions(plan, readings, labels);
        conditions.into_iter().map(|conditions| conditions.map(|conditions| conditions.t_s)).collect()
    }

    #[test]
    fn touches_of_a_ball_are_one_measurement() {
        let plan = plan_with_labels(&["slow/001/3/+45", "slow/001/3/pole", "slow/001/31/pole"]);
        let readings = [touch(0, 0, 10.0), touch(1, 0, 30.0), touch(2, 0, 500.0)];
        let conditions = measurement_conditions(&plan, &readings, &["slow/001/3", "slow/001/31", "slow/002/3"]);
        let of = |t_s: f64, celsius| {
            Some(MeasurementConditions { t_s, temperatures_c: [("table".to_owned(), celsius)].into() })
        };
        assert_eq!(conditions, [of(20.0, 20.15625), of(500.0, 23.90625), None]);
    }

    #[test]
    fn each_pass_has_its_own_time() {
        let plan = plan_with_labels(&["1a/C000", "R1/P000"]);
        let (stop, again) = (FIRST_REPEAT_NUMBER_AFTER_STOP, machine::record::plan::FIRST_OUTLIER_REPEAT_NUMBER);
        let readings = [touch(0, 0, 1.0), touch(1, 0, 2.0), touch(0, 1, 3.0), touch(1, 1, 4.0), touch(1, stop, 9.0)];
        let all = ["1a/C000", "1a/C000", "R1/P000", "R1/P000", "R1/P000"];
        assert_eq!(times(&plan, &readings, &all), [1.0, 3.0, 2.0, 4.0, 9.0].map(Some));
        // The newest pass, alone and with the reference after the stop.
        assert_eq!(times(&plan, &readings, &["R1/P000", "1a/C000"]), [4.0, 3.0].map(Some));
        assert_eq!(times(&plan, &readings, &["R1/P000", "R1/P000"]), [4.0, 9.0].map(Some));
        assert_eq!(times(&plan, &readings, &["1a/C000"; 3]), [2.0; 3].map(Some));
        // A repeated outlier replaces its earlier readings; an excluded reading does not count.
        let mut repeated = [touch(0, 0, 1.0), touch(0, again, 7.0), touch(1, 0, 2.0)];
        repeated[2].flag = ReadingFlag::Excluded;
        assert_eq!(times(&plan, &repeated, &["1a/C000", "R1/P000"]), [Some(7.0), None]);
    }
}
