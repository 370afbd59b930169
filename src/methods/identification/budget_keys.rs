//! The keys of the machine file that determine the budget lines: which lines are assumed, and their
//! sensitivity to the declared size.

use machine::Axis;
use machine::record::artefact::{Artefact, Balls};
use machine::record::estimate::{BudgetLine, Estimate};
use machine::record::machine::StatedAxis;
use machine::record::plan::Plan;

use super::probe_map::ProbeMap;

/// A budget line, and the key of the machine file that declares its size.
struct BudgetLineKey {
    line_name: &'static str,
    /// Key of the machine file; `axes.*` means each of the axes.
    machine_file_key: &'static str,
    /// Declared size in the unit of the key; the largest one if there are several axes or sensors. 0: the line is
    /// proportional to no declared size.
    declared_size: fn(&Plan) -> f64,
}

const fn budget_line_key(line_name: &'static str, key: &'static str, declared_size: fn(&Plan) -> f64) -> BudgetLineKey {
    BudgetLineKey { line_name, machine_file_key: key, declared_size }
}

/// Keys by budget line. Of several keys of a line, the first gives its key and sensitivity; each can make the line
/// assumed.
const BUDGET_LINE_KEYS: [BudgetLineKey; 18] = [
    budget_line_key("repeatability of a touch", "probe.repeatability_um", |plan| {
        plan.probe.repeatability_um.unwrap_or_default()
    }),
    budget_line_key("resolution", "axes.*.resolution_um", largest_linear_resolution_um),
    budget_line_key("resolution of the axes", "axes.*.resolution_um", largest_linear_resolution_um),
    budget_line_key("probe lobing", "probe.lobing_um", |plan| match ProbeMap::from_plan(plan) {
        Ok(None) => plan.probe.lobing_um,
        _ => 0.0,
    }),
    budget_line_key("stylus offset", "probe.stylus_offset_um", |plan| plan.probe.u_stylus_offset_um),
    budget_line_key("backlash", "axes.*.backlash_um", |plan| largest_linear_axis_value(plan, |axis| axis.backlash_um)),
    budget_line_key("error motions of X, Y and Z", "axes.*.error_motion_um", |plan| {
        largest_linear_axis_value(plan, |axis| axis.error_motion_um)
    }),
    budget_line_key("angular error motions of X, Y and Z", "axes.*.angular_motion_urad", |plan| {
        largest_linear_axis_value(plan, |axis| axis.angular_motion_urad)
    }),
    budget_line_key("error motions of rotary axes", "axes.*.error_motion_um", |plan| {
        let is_rotary = |axis: &Axis| !axis.is_linear() && *axis != Axis::S;
        largest_axis_value(plan, is_rotary, |axis| axis.error_motion_um)
    }),
    budget_line_key("thermal drift", "machine.drift_um_per_h", |plan| plan.machine.drift_um_per_h),
    budget_line_key("squareness of X, Y and Z", "machine.squareness_urad", |plan| plan.machine.squareness_urad),
    budget_line_key("temperature of the certified length", "artefact.lengths.u_temperature_k", |_| 0.0),
    budget_line_key("temperature of the certified length", "artefact.lengths.expansion_um_per_m_k", |_| 0.0),
    budget_line_key("temperature of the artefact", "artefact.u_temperature_k", |plan| {
        artefact_balls(plan).and_then(|balls| balls.u_temperature_k).unwrap_or_default()
    }),
    budget_line_key("temperature of the artefact", "artefact.expansion_um_per_m_k", |_| 0.0),
    budget_line_key("certificate of the balls", "artefact.certificate_u_mm", |plan| {
        artefact_balls(plan).and_then(|balls| balls.certificate_u_mm).unwrap_or_default()
    }),
    budget_line_key("noise of the sensor", "sensor.noise_um", |plan| {
        plan.sensors.iter().filter_map(|sensor| sensor.noise_um).fold(0.0, f64::max)
    }),
    budget_line_key("linearity of the sensor", "sensor.linearity_um", |plan| {
        plan.sensors.iter().map(|sensor| sensor.linearity_um).fold(0.0, f64::max)
    }),
];
/// Prefix of the budget line for the error motions of one rotary axis.
const ROTARY_MOTION_LINE_PREFIX: &str = "error motions of ";

fn largest_axis_value(plan: &Plan, includes_axis: fn(&Axis) -> bool, value: fn(&StatedAxis) -> f64) -> f64 {
    let axes = plan.machine.axes.iter().filter(|(axis, _)| includes_axis(axis));
    axes.map(|(_, spec)| value(spec)).fold(0.0, f64::max)
}

fn largest_linear_axis_value(plan: &Plan, value: fn(&StatedAxis) -> f64) -> f64 {
    largest_axis_value(plan, |axis| axis.is_linear(), value)
}

fn artefact_balls(plan: &Plan) -> Option<&Balls> {
    match &plan.artefact {
        Artefact::Balls(balls) => Some(balls),
        _ => None,
    }
}

fn largest_linear_resolution_um(plan: &Plan) -> f64 {
    largest_linear_axis_value(plan, |axis| axis.resolution_um)
}

/// Adds keys and sensitivities (u of the line per unit of the declared size) to the lines of the budgets, and marks
/// the lines whose size is wholly or partly assumed.
pub fn add_budget_sensitivities(estimate: &mut Estimate, plan: &Plan) {
    let parameters = estimate.parameters.iter_mut().flat_map(|parameter| &mut parameter.budget);
    for line in parameters {
        let Some((key, size)) = budget_key_and_size(line, plan) else { continue };
        line.assumed = plan.assumed.iter().any(|assumed| is_key_of_line(line, assumed));
        line.sensitivity = (size > 0.0).then(|| line.u / size);
        line.key = Some(key);
    }
}

/// Key of the line, and its declared size in the unit of the key. `None`: no key declares the line.
fn budget_key_and_size(line: &BudgetLine, plan: &Plan) -> Option<(String, f64)> {
    if let Some(sized) = BUDGET_LINE_KEYS.iter().find(|sized| sized.line_name == line.source) {
        return Some((sized.machine_file_key.to_owned(), (sized.declared_size)(plan)));
    }
    let name = line.source.strip_prefix(ROTARY_MOTION_LINE_PREFIX)?;
    let (axis, spec) = plan.machine.axes.iter().find(|(axis, _)| axis.name() == name)?;
    Some((format!("axes.{axis}.error_motion_um"), spec.error_motion_um))
}

/// Whether the key of the machine file, e.g. `axes.X.backlash_um`, determines the size of the line.
fn is_key_of_line(line: &BudgetLine, key: &str) -> bool {
    let (section, name) = key.rsplit_once('.').unwrap_or(("", key));
    let axis = section.strip_prefix("axes.");
    let mut sized = BUDGET_LINE_KEYS.iter().filter(|sized| sized.line_name == line.source).peekable();
    if sized.peek().is_none() {
        return name == "error_motion_um"
            && axis.is_some()
            && axis == line.source.strip_prefix(ROTARY_MOTION_LINE_PREFIX);
    }
    let is_linear = axis.is_none_or(|axis| ["X", "Y", "Z"].contains(&axis));
    let is_same = |sized: &BudgetLineKey| sized.machine_file_key.rsplit('.').next() == Some(name);
    sized.any(is_same) && is_linear != (line.source == "error motions of rotary axes")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budget_line_is_assumed_only_if_its_own_key_is() {
        let is_assumed = |source: &str, key: &str| {
            is_key_of_line(&BudgetLine { source: source.to_owned(), ..BudgetLine::default() }, key)
        };
        const LINEAR_MOTION_LINE: &str = "error motions of X, Y and Z";
        for (source, own, other) in [
            (LINEAR_MOTION_LINE, "axes.Z.error_motion_um", "axes.C.error_motion_um"),
            ("error motions of C", "axes.C.error_motion_um", "axes.B.error_motion_um"),
            ("error motions of rotary axes", "axes.B.error_motion_um", "axes.Z.error_motion_um"),
            ("backlash", "axes.X.backlash_um", "axes.X.error_motion_um"),
            ("probe lobing", "probe.lobing_um", "probe.stylus_offset_um"),
            ("thermal drift", "machine.drift_um_per_h", "machine.squareness_urad"),
        ] {
            assert!(is_assumed(source, own) && !is_assumed(source, other), "{source}");
        }
        assert!(is_assumed("temperature of the artefact", "artefact.expansion_um_per_m_k"));
        let length = "temperature of the certified length";
        assert!(is_assumed(length, "artefact.lengths.0.u_temperature_k"));
        assert!(!is_assumed("repeatability of a touch", "probe.lobing_um"));
    }
}
