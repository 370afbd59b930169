//! Compares the machine file with the data that the control reports. A file that claims less than the control
//! has is correct.

use devices::controllers::{DeviceInfo, ReportedAxis};
use machine::Axis;
use machine::record::machine::{AxisSpec, Machine};

/// Relative tolerance for rounded values of the control.
const ROUNDED: f64 = 1e-3;

/// A difference and its remedy.
#[derive(Debug, PartialEq)]
pub(super) struct Difference {
    /// Axis whose travel in the machine file exceeds the control's limits.
    pub beyond_limits: Option<Axis>,
    pub what: String,
    pub remedy: String,
}

pub(super) fn differences(machine: &Machine, says: &DeviceInfo) -> Vec<Difference> {
    let mut found = Vec::new();
    let axes = machine.axes.iter().filter(|(axis, _)| **axis != Axis::S);
    for (axis, spec) in axes {
        match says.axes.get(axis) {
            Some(says) => found.extend(of_axis(*axis, spec, says)),
            None if says.axes.is_empty() => {}
            None => found.push(missing(*axis, says)),
        }
    }
    found
}

fn missing(axis: Axis, says: &DeviceInfo) -> Difference {
    let has: Vec<String> = says.axes.keys().map(Axis::to_string).collect();
    let has = has.join(", ");
    Difference {
        beyond_limits: None,
        what: format!(
            "the machine file has an axis {axis} that the control does not drive: it has {has}"
        ),
        remedy: format!(
            "set {axis} up at the control; or take it out of [machine] topology and [axes.{axis}] if \
             the machine has none"
        ),
    }
}

fn of_axis(axis: Axis, spec: &AxisSpec, says: &ReportedAxis) -> Vec<Difference> {
    let mut found = Vec::new();
    let span = spec.max - spec.min;
    let slack = ROUNDED * span;
    let below = says.min.filter(|min| spec.min < min - slack);
    let above = says.max.filter(|max| spec.max > max + slack);
    let ends = [below.map(|min| ("min", spec.min, min)), above.map(|max| ("max", spec.max, max))];
    for (key, stated, ends) in ends.into_iter().flatten() {
        found.push(Difference {
            beyond_limits: Some(axis),
            what: format!(
                "{axis} travels beyond the control's limits: {key} = {stated}, there {ends}"
            ),
            remedy: format!(
                "write {key} = {ends} in [axes.{axis}], or correct the limit at the control"
            ),
        });
    }
    if let Some(travel) = says.travel.filter(|travel| span > travel + slack) {
        found.push(Difference {
            beyond_limits: Some(axis),
            what: format!(
                "{axis} travels {span} in the machine file, but only {travel} by the control's limits"
            ),
            remedy: format!(
                "bring min and max of [axes.{axis}] nearer together, or correct the control"
            ),
        });
    }
    let swift = [
        ("rapid_per_min", spec.rapid_per_min, says.rapid_per_min, "rapid speed"),
        ("acceleration_per_s2", spec.acceleration_per_s2, says.acceleration_per_s2, "acceleration"),
    ];
    for (key, stated, has, name) in swift {
        let Some(has) = has.filter(|has| stated > has * (1.0 + ROUNDED)) else { continue };
        found.push(Difference {
            beyond_limits: None,
            what: format!(
                "the {name} of {axis} is above the control's: {key} = {stated}, there {has}"
            ),
            remedy: format!("write {key} = {has} in [axes.{axis}]: braking is reckoned with it"),
        });
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::setup::MachineFile;

    fn introduction() -> (Machine, DeviceInfo) {
        let text = include_str!("../../config/simulated.toml").to_owned();
        let machine = MachineFile::parse("machine.toml", text).unwrap().machine;
        let says = |spec: &AxisSpec| ReportedAxis {
            min: Some(spec.min),
            max: Some(spec.max),
            rapid_per_min: Some(spec.rapid_per_min),
            acceleration_per_s2: Some(spec.acceleration_per_s2),
            ..ReportedAxis::default()
        };
        let axes = machine.axes.iter().filter(|(axis, _)| **axis != Axis::S);
        let axes = axes.map(|(axis, spec)| (*axis, says(spec))).collect();
        (machine, DeviceInfo { axes, ..DeviceInfo::default() })
    }

    #[test]
    fn only_what_the_machine_file_claims_beyond_the_control_is_told() {
        let (machine, says) = introduction();
        assert_eq!(differences(&machine, &says), []);
        assert_eq!(differences(&machine, &DeviceInfo::default()), [], "it tells nothing");

        let told = |change: fn(&mut ReportedAxis)| {
            let mut says = says.clone();
            change(says.axes.get_mut(&Axis::X).unwrap());
            let found = differences(&machine, &says);
            found.into_iter().map(|difference| difference.what).collect::<Vec<_>>()
        };
        let beyond = "X travels beyond the control's limits: max = 250, there 200";
        assert_eq!(told(|x| x.max = Some(200.0)), [beyond]);
        assert!(told(|x| x.max = Some(300.0)).is_empty(), "it may have more");
        let short = "X travels 500 in the machine file, but only 400 by the control's limits";
        assert_eq!(told(|x| (x.min, x.max, x.travel) = (None, None, Some(400.0))), [short]);
        let swift =
            "the rapid speed of X is above the control's: rapid_per_min = 20000, there 5000";
        assert_eq!(told(|x| x.rapid_per_min = Some(5000.0)), [swift]);
        assert_eq!(told(|x| x.acceleration_per_s2 = Some(500.0)).len(), 1);

        let mut less = says.clone();
        less.axes.remove(&Axis::B);
        let found = differences(&machine, &less);
        let what =
            "the machine file has an axis B that the control does not drive: it has X, Y, Z, C";
        assert_eq!(
            found.iter().map(|difference| difference.what.as_str()).collect::<Vec<_>>(),
            [what]
        );
    }
}
