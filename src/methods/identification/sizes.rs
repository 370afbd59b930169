//! The keys of the machine file that determine the budget lines: which lines are assumed, and their
//! sensitivity to the declared size.

use machine::Axis;
use machine::record::artefact::{Artefact, Balls};
use machine::record::estimate::{BudgetLine, Estimate};
use machine::record::machine::AxisSpec;
use machine::record::plan::Plan;

use super::probe_map::ProbeMap;

/// One line of a budget.
struct BudgetLineKey {
    line: &'static str,
    /// Key of the machine file; `axes.*` means each of the axes.
    key: &'static str,
    /// Declared size; the largest one if there are several axes or sensors. 0: the line is proportional to no
    /// declared size.
    size: fn(&Plan) -> f64,
}

const fn sized(line: &'static str, key: &'static str, size: fn(&Plan) -> f64) -> BudgetLineKey {
    BudgetLineKey { line, key, size }
}

const SIZES: [BudgetLineKey; 18] = [
    sized("repeatability of a touch", "probe.repeatability_um", |plan| {
        plan.probe.repeatability_um.unwrap_or_default()
    }),
    sized("resolution", "axes.*.resolution_um", resolution),
    sized("resolution of the axes", "axes.*.resolution_um", resolution),
    sized("probe lobing", "probe.lobing_um", |plan| match ProbeMap::of(plan) {
        Ok(None) => plan.probe.lobing_um,
        _ => 0.0,
    }),
    sized("stylus offset", "probe.stylus_offset_um", |plan| plan.probe.stylus_offset_um),
    sized("backlash", "axes.*.backlash_um", |plan| linear(plan, |axis| axis.backlash_um)),
    sized("error motions of X, Y and Z", "axes.*.error_motion_um", |plan| {
        linear(plan, |axis| axis.error_motion_um)
    }),
    sized("angular error motions of X, Y and Z", "axes.*.angular_motion_urad", |plan| {
        linear(plan, |axis| axis.angular_motion_urad)
    }),
    sized("error motions of rotary axes", "axes.*.error_motion_um", |plan| {
        let is_rotary = |axis: &Axis| !axis.is_linear() && *axis != Axis::S;
        largest(plan, is_rotary, |axis| axis.error_motion_um)
    }),
    sized("thermal drift", "machine.drift_um_per_h", |plan| plan.machine.drift_um_per_h),
    sized("squareness of X, Y and Z", "machine.squareness_urad", |plan| {
        plan.machine.squareness_urad
    }),
    sized("temperature of the certified length", "artefact.lengths.u_temperature_k", |_| 0.0),
    sized("temperature of the certified length", "artefact.lengths.expansion_um_per_m_k", |_| 0.0),
    sized("temperature of the artefact", "artefact.u_temperature_k", |plan| {
        balls(plan).and_then(|balls| balls.u_temperature_k).unwrap_or_default()
    }),
    sized("temperature of the artefact", "artefact.expansion_um_per_m_k", |_| 0.0),
    sized("certificate of the balls", "artefact.certificate_u_mm", |plan| {
        balls(plan).and_then(|balls| balls.certificate_u_mm).unwrap_or_default()
    }),
    sized("noise of the sensor", "sensor.noise_um", |plan| {
        plan.sensors.iter().filter_map(|sensor| sensor.noise_um).fold(0.0, f64::max)
    }),
    sized("linearity of the sensor", "sensor.linearity_um", |plan| {
        plan.sensors.iter().map(|sensor| sensor.linearity_um).fold(0.0, f64::max)
    }),
];
/// Prefix of the budget line for the error motions of one rotary axis.
const MOTIONS: &str = "error motions of ";

fn largest(plan: &Plan, is_meant: fn(&Axis) -> bool, of: fn(&AxisSpec) -> f64) -> f64 {
    let axes = plan.machine.axes.iter().filter(|(axis, _)| is_meant(axis));
    axes.map(|(_, spec)| of(spec)).fold(0.0, f64::max)
}

fn linear(plan: &Plan, of: fn(&AxisSpec) -> f64) -> f64 {
    largest(plan, |axis| axis.is_linear(), of)
}

fn balls(plan: &Plan) -> Option<&Balls> {
    match &plan.artefact {
        Artefact::Balls(balls) => Some(balls),
        _ => None,
    }
}

fn resolution(plan: &Plan) -> f64 {
    linear(plan, |axis| axis.resolution_um)
}

/// Adds keys and sensitivities to the lines of the budgets, and marks the lines whose size is wholly or
/// partly assumed.
pub fn add_sensitivities(estimate: &mut Estimate, plan: &Plan) {
    let parameters = estimate.parameters.iter_mut().flat_map(|parameter| &mut parameter.budget);
    for line in parameters {
        let Some((key, size)) = key_and_size(line, plan) else { continue };
        line.assumed = plan.assumed.iter().any(|assumed| is_of(line, assumed));
        line.sensitivity = (size > 0.0).then(|| line.u / size);
        line.key = Some(key);
    }
}

fn key_and_size(line: &BudgetLine, plan: &Plan) -> Option<(String, f64)> {
    if let Some(sized) = SIZES.iter().find(|sized| sized.line == line.source) {
        return Some((sized.key.to_owned(), (sized.size)(plan)));
    }
    let name = line.source.strip_prefix(MOTIONS)?;
    let (axis, spec) = plan.machine.axes.iter().find(|(axis, _)| axis.name() == name)?;
    Some((format!("axes.{axis}.error_motion_um"), spec.error_motion_um))
}

/// Whether the key of the machine file, e.g. `axes.X.backlash_um`, determines the size of the line.
fn is_of(line: &BudgetLine, key: &str) -> bool {
    let (section, name) = key.rsplit_once('.').unwrap_or(("", key));
    let axis = section.strip_prefix("axes.");
    let mut sized = SIZES.iter().filter(|sized| sized.line == line.source).peekable();
    if sized.peek().is_none() {
        return name == "error_motion_um"
            && axis.is_some()
            && axis == line.source.strip_prefix(MOTIONS);
    }
    let is_linear = axis.is_none_or(|axis| ["X", "Y", "Z"].contains(&axis));
    let is_same = |sized: &BudgetLineKey| sized.key.rsplit('.').next() == Some(name);
    sized.any(is_same) && is_linear != (line.source == "error motions of rotary axes")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_assumed_if_one_of_its_own_keys_is() {
        let is_assumed = |source: &str, key: &str| {
            is_of(&BudgetLine { source: source.to_owned(), ..BudgetLine::default() }, key)
        };
        const LINEAR: &str = "error motions of X, Y and Z";
        for (source, own, other) in [
            (LINEAR, "axes.Z.error_motion_um", "axes.C.error_motion_um"),
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
