//! Compares the machine file with the data that the control reports. Travel, speeds and accelerations in the machine
//! file may be smaller than those of the control.

use devices::controllers::{DeviceInfo, ReportedAxisProperties};
use machine::Axis;
use machine::record::machine::{Machine, StatedAxis};

/// Amount by which a value may exceed that of the control, whose values are rounded: relative to that value, or for a
/// travel limit to the travel in the machine file.
const RELATIVE_ROUNDING_TOLERANCE: f64 = 1e-3;

/// A value of the machine file that exceeds that of the control, or an axis that the control does not have, and the
/// remedy.
#[derive(Debug, PartialEq)]
pub(super) struct MachineFileDifference {
    /// Axis whose travel in the machine file exceeds the control's limits; `None`: another difference.
    pub axis_beyond_limits: Option<Axis>,
    pub description: String,
    pub remedy: String,
}

/// Differences of all axes except S; none if the control reports no axes.
pub(super) fn machine_file_differences(machine: &Machine, info: &DeviceInfo) -> Vec<MachineFileDifference> {
    let mut differences = Vec::new();
    let axes = machine.axes.iter().filter(|(axis, _)| **axis != Axis::S);
    for (axis, spec) in axes {
        match info.axes.get(axis) {
            Some(info) => differences.extend(axis_differences(*axis, spec, info)),
            None if info.axes.is_empty() => {}
            None => differences.push(axis_missing_at_control(*axis, info)),
        }
    }
    differences
}

fn axis_missing_at_control(axis: Axis, info: &DeviceInfo) -> MachineFileDifference {
    let has: Vec<String> = info.axes.keys().map(Axis::to_string).collect();
    let has = has.join(", ");
    MachineFileDifference {
        axis_beyond_limits: None,
        description: format!("the machine file has an axis {axis}, but the control has only the axes {has}"),
        remedy: format!(
            "configure {axis} at the control; or, if the machine has no {axis}, remove it from [machine] \
            topology and remove [axes.{axis}]"
        ),
    }
}

/// Values of the machine file that exceed those of the control; smaller values are no difference.
fn axis_differences(axis: Axis, spec: &StatedAxis, info: &ReportedAxisProperties) -> Vec<MachineFileDifference> {
    let mut differences = Vec::new();
    let span = spec.max - spec.min;
    let slack = RELATIVE_ROUNDING_TOLERANCE * span;
    let below = info.travel_min.filter(|min| spec.min < min - slack);
    let above = info.travel_max.filter(|max| spec.max > max + slack);
    let ends = [below.map(|min| ("min", spec.min, min)), above.map(|max| ("max", spec.max, max))];
    for (key, stated, ends) in ends.into_iter().flatten() {
        differences.push(MachineFileDifference {
            axis_beyond_limits: Some(axis),
            description: format!(
                "the travel of {axis} exceeds the limits of the control: {key} = {stated} in the machine \
                file, {ends} at the control"
            ),
            remedy: format!("write {key} = {ends} in [axes.{axis}], or correct the limit at the control"),
        });
    }
    if let Some(travel) = info.travel_length.filter(|travel| span > travel + slack) {
        differences.push(MachineFileDifference {
            axis_beyond_limits: Some(axis),
            description: format!("{axis} has a travel of {span} in the machine file, but only {travel} at the control"),
            remedy: format!("reduce the range from min to max in [axes.{axis}], or correct the travel at the control"),
        });
    }
    let dynamics = [
        ("rapid_per_min", spec.rapid_per_min, info.rapid_per_min, "rapid speed"),
        ("acceleration_per_s2", spec.acceleration_per_s2, info.acceleration_per_s2, "acceleration"),
    ];
    for (key, stated, has, name) in dynamics {
        let Some(has) = has.filter(|has| stated > has * (1.0 + RELATIVE_ROUNDING_TOLERANCE)) else {
            continue;
        };
        differences.push(MachineFileDifference {
            axis_beyond_limits: None,
            description: format!(
                "the {name} of {axis} exceeds the value of the control: {key} = {stated} in the machine \
                file, {has} at the control"
            ),
            remedy: format!("write {key} = {has} in [axes.{axis}]: the braking distances are computed from this value"),
        });
    }
    differences
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::setup::MachineFile;

    fn machine_with_matching_info() -> (Machine, DeviceInfo) {
        let text = include_str!("../../config/simulated.toml").to_owned();
        let machine = MachineFile::parse("machine.toml", text).unwrap().machine;
        let info = |spec: &StatedAxis| ReportedAxisProperties {
            travel_min: Some(spec.min),
            travel_max: Some(spec.max),
            rapid_per_min: Some(spec.rapid_per_min),
            acceleration_per_s2: Some(spec.acceleration_per_s2),
            ..ReportedAxisProperties::default()
        };
        let axes = machine.axes.iter().filter(|(axis, _)| **axis != Axis::S);
        let axes = axes.map(|(axis, spec)| (*axis, info(spec))).collect();
        (machine, DeviceInfo { axes, ..DeviceInfo::default() })
    }

    #[test]
    fn only_values_beyond_those_of_the_control_are_reported() {
        let (machine, info) = machine_with_matching_info();
        assert_eq!(machine_file_differences(&machine, &info), []);
        assert_eq!(machine_file_differences(&machine, &DeviceInfo::default()), [], "the control reports no data");

        let descriptions_after = |change: fn(&mut ReportedAxisProperties)| {
            let mut info = info.clone();
            change(info.axes.get_mut(&Axis::X).unwrap());
            let differences = machine_file_differences(&machine, &info);
            differences.into_iter().map(|difference| difference.description).collect::<Vec<_>>()
        };
        let beyond = "the travel of X exceeds the limits of the control: max = 250 in the machine file, 200 \
            at the control";
        assert_eq!(descriptions_after(|x| x.travel_max = Some(200.0)), [beyond]);
        assert!(descriptions_after(|x| x.travel_max = Some(300.0)).is_empty(), "it may have more");
        let short = "X has a travel of 500 in the machine file, but only 400 at the control";
        assert_eq!(
            descriptions_after(|x| (x.travel_min, x.travel_max, x.travel_length) = (None, None, Some(400.0))),
            [short]
        );
        let dynamics = "the rapid speed of X exceeds the value of the control: rapid_per_min = 20000 in the machine \
            file, 5000 at the control";
        assert_eq!(descriptions_after(|x| x.rapid_per_min = Some(5000.0)), [dynamics]);
        assert_eq!(descriptions_after(|x| x.acceleration_per_s2 = Some(500.0)).len(), 1);

        let mut less = info.clone();
        less.axes.remove(&Axis::B);
        let differences = machine_file_differences(&machine, &less);
        let what = "the machine file has an axis B, but the control has only the axes X, Y, Z, C";
        assert_eq!(differences.iter().map(|difference| difference.description.as_str()).collect::<Vec<_>>(), [what]);
    }
}
