//! Orders of the error motion of a rotary axis that the measured angles cannot separate from its location
//! errors.

use machine::Axis;
use machine::record::plan::{Plan, StepKind};

/// Harmonic orders that are checked for aliasing.
const CHECKED_HARMONIC_ORDERS: std::ops::RangeInclusive<u32> = 1..=12;
/// Largest deviation of a cosine from 1, and of an angle, rad, that counts as none.
const COSINE_TOLERANCE: f64 = 1e-6;

/// Orders whose harmonics have the same value at all `angles`, rad. Empty if the axis does not turn.
fn aliased_orders(angles: &[f64]) -> Vec<u32> {
    let Some(first) = angles.first() else { return Vec::new() };
    let is_same = |by: f64| (by.cos() - 1.0).abs() < COSINE_TOLERANCE;
    if angles.iter().all(|angle| (angle - first).abs() < COSINE_TOLERANCE) {
        return Vec::new();
    }
    let is_aliased = |order: &u32| angles.iter().all(|angle| is_same(f64::from(*order) * (angle - first)));
    CHECKED_HARMONIC_ORDERS.filter(is_aliased).collect()
}

/// Default text for the quantity from which the error motions of an axis are inseparable.
pub const LOCATION_ERRORS_TEXT: &str = "its location errors";

/// A sentence for `not_identifiable`. `inseparable_from` names what the aliased orders cannot be separated from.
/// `None`: the angles separate all orders that are checked.
pub fn describe_aliased_orders(axis: Axis, angles: &[f64], inseparable_from: &str) -> Option<String> {
    let orders = aliased_orders(angles);
    let first = orders.first()?;
    let named: Vec<String> = orders.iter().map(u32::to_string).collect();
    let plural = if named.len() > 1 { "s" } else { "" };
    Some(format!(
        "error motions of {axis} at order{plural} {}: inseparable from {inseparable_from} ({axis} is measured in steps \
        of 360°/{first} only; add an angle between two steps)",
        named.join(", ")
    ))
}

/// The sentences of [`describe_aliased_orders`] for all rotary axes except the spindle, from the angles at which the
/// steps of a plan measure.
pub fn describe_plan_aliasing(plan: &Plan) -> Vec<String> {
    let rotary = plan.machine.axes.keys().filter(|axis| !axis.is_linear() && **axis != Axis::S);
    let of_axis = |axis: &Axis| {
        let measured = plan.steps.iter().filter(|step| step.kind != StepKind::Prompt);
        let angles: Vec<f64> = measured
            .flat_map(|step| match &step.scan {
                Some(scan) => scan.path.iter().map(|at| at.get_or_zero(*axis)).collect(),
                None => vec![step.from.get_or_zero(*axis)],
            })
            .collect();
        describe_aliased_orders(*axis, &angles, LOCATION_ERRORS_TEXT)
    };
    rotary.filter_map(of_axis).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_that_repeat_from_angle_to_angle_are_aliased() {
        let angles = |degrees: &[f64]| -> Vec<f64> { degrees.iter().map(|d| d.to_radians()).collect() };
        let orders = |degrees: &[f64]| aliased_orders(&angles(degrees));
        assert_eq!(orders(&[0.0, 90.0, 180.0, 270.0, 360.0]), [4, 8, 12]);
        assert_eq!(orders(&[30.0, -90.0, 150.0]), [3, 6, 9, 12]);
        // One angle between the others separates all orders; a single angle gives no orders.
        assert!(orders(&[0.0, 90.0, 180.0, 200.0]).is_empty());
        assert!(orders(&[45.0, 45.0]).is_empty() && orders(&[]).is_empty());
        let line = describe_aliased_orders(Axis::C, &angles(&[0.0, 90.0, 270.0]), LOCATION_ERRORS_TEXT).unwrap();
        assert!(line.starts_with("error motions of C at orders 4, 8, 12: "), "{line}");
        assert!(line.contains("steps of 360°/4 only"), "{line}");
    }
}
