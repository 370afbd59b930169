//! A step of a plan in words, for the operator.

use super::number::format_fixed;
use machine::Axis;
use machine::record::plan::{Step, StepKind};

/// Smallest component of a direction that is named: sin 17.5°.
const MIN_NAMED_COMPONENT: f64 = 0.3;

/// What the machine does in `step`, such as `touch in −X at C 45°`; for a prompt, the text of the prompt.
pub fn describe_step(step: &Step) -> String {
    let place: Vec<String> = step
        .from
        .iter()
        .filter(|(axis, _)| !axis.is_linear())
        .map(|(axis, rad)| describe_axis_value(axis, rad))
        .collect();
    let at = if place.is_empty() { String::new() } else { format!(" at {}", place.join(", ")) };
    let turned = step.scan.as_ref().and_then(|scan| scan.single_rotary_axis());
    match (step.kind, turned) {
        (StepKind::Prompt, _) => step.text.clone().unwrap_or_default(),
        (StepKind::Index, _) => format!("move to the measuring position{at}"),
        (StepKind::Touch, _) => format!("touch{}{at}", describe_touch_direction(step.normal)),
        (StepKind::Scan, Some(axis)) => format!("turn of {axis} with readings"),
        (StepKind::Scan, None) => format!("scan{at}"),
        (StepKind::Reference, _) if step.scan.is_some() => format!("reference scan{at}"),
        (StepKind::Reference, _) => format!("reference touch{}{at}", describe_touch_direction(step.normal)),
    }
}

/// A position of an axis with its unit: `X 12.345 mm`, `C 45°`. `value`: mm or rad.
pub fn describe_axis_value(axis: Axis, value: f64) -> String {
    let external = axis.to_mm_or_deg(value);
    let number = format_fixed(external, 3);
    let number = number.trim_end_matches('0').trim_end_matches('.');
    if axis.is_linear() { format!("{axis} {number} mm") } else { format!("{axis} {number}°") }
}

/// The stylus moves against the outward normal.
fn describe_touch_direction(normal: [f64; 3]) -> String {
    let named = Axis::LINEAR.into_iter().zip(normal).filter(|(_, component)| component.abs() > MIN_NAMED_COMPONENT);
    let named: Vec<String> =
        named.map(|(axis, component)| format!("{}{axis}", if component > 0.0 { '−' } else { '+' })).collect();
    if named.is_empty() { String::new() } else { format!(" in {}", named.join(" ")) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use machine::Position;

    #[test]
    fn steps_are_described_by_direction_and_rotary_position() {
        let from: Position = [(Axis::X, 50.0), (Axis::C, 45f64.to_radians()), (Axis::B, -0.0)].into_iter().collect();
        let touch = Step { kind: StepKind::Touch, from, normal: [0.8, -0.6, 0.0], ..Step::default() };
        assert_eq!(describe_step(&touch), "touch in −X +Y at B 0°, C 45°");
        let reference = Step { kind: StepKind::Reference, normal: [0.0, 0.0, 1.0], ..Step::default() };
        assert_eq!(describe_step(&reference), "reference touch in −Z");
        assert_eq!(describe_step(&Step::prompt("x".to_owned(), "Clamp it".to_owned())), "Clamp it");
        assert_eq!(describe_axis_value(Axis::X, -12.3456), "X −12.346 mm");
        assert_eq!(describe_axis_value(Axis::Z, 100.0), "Z 100 mm");
    }
}
