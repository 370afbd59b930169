//! The machine file against what the control says of itself. Where the file asks for less than the
//! control has, nothing is wrong.

use crate::base::Axis;
use crate::controllers::{AxisSays, Introduction};
use crate::record::machine::{AxisSpec, Machine};

/// What a control prints is rounded: this share more is no difference.
const ROUNDED: f64 = 1e-3;

/// Each difference, and its remedy.
pub(super) fn differences(machine: &Machine, says: &Introduction) -> Vec<(String, String)> {
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

fn missing(axis: Axis, says: &Introduction) -> (String, String) {
    let has: Vec<String> = says.axes.keys().map(Axis::to_string).collect();
    let has = has.join(", ");
    (
        format!(
            "the machine file has an axis {axis} that the control does not drive: it has {has}"
        ),
        format!(
            "set {axis} up at the control; or take it out of [machine] topology and [axes.{axis}] if \
             the machine has none"
        ),
    )
}

fn of_axis(axis: Axis, spec: &AxisSpec, says: &AxisSays) -> Vec<(String, String)> {
    let mut found = Vec::new();
    let span = spec.max - spec.min;
    let slack = ROUNDED * span;
    let below = says.min.filter(|min| spec.min < min - slack);
    let above = says.max.filter(|max| spec.max > max + slack);
    let ends = [below.map(|min| ("min", spec.min, min)), above.map(|max| ("max", spec.max, max))];
    for (key, stated, ends) in ends.into_iter().flatten() {
        found.push((
            format!("{axis} travels beyond the control's limits: {key} = {stated}, there {ends}"),
            format!("write {key} = {ends} in [axes.{axis}], or correct the limit at the control"),
        ));
    }
    if let Some(travel) = says.travel.filter(|travel| span > travel + slack) {
        found.push((
            format!(
                "{axis} travels {span} in the machine file, but only {travel} by the control's limits"
            ),
            format!("bring min and max of [axes.{axis}] nearer together, or correct the control"),
        ));
    }
    let swift = [
        ("rapid_per_min", spec.rapid_per_min, says.rapid_per_min, "rapid speed"),
        ("acceleration_per_s2", spec.acceleration_per_s2, says.acceleration_per_s2, "acceleration"),
    ];
    for (key, stated, has, name) in swift {
        let Some(has) = has.filter(|has| stated > has * (1.0 + ROUNDED)) else { continue };
        found.push((
            format!("the {name} of {axis} is above the control's: {key} = {stated}, there {has}"),
            format!("write {key} = {has} in [axes.{axis}]: braking is reckoned with it"),
        ));
    }
    found
}
