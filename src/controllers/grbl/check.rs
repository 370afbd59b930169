//! Grbl's lines carry no check sum. What the control says is therefore compared with what it was
//! told, and what matters is heard twice.

use super::message::{Message, Status};
use crate::base::{Axis, Position};
use crate::controllers::ControllerError;
use crate::gcode::Dialect;
use crate::record::machine::AxisSpec;

/// A control stands where it was sent to within this, mm or degrees: coarser than a step of any
/// machine that can measure, finer than what a collision could come of.
const ARRIVED: f64 = 0.02;

/// How far from its target an axis may stand, mm or rad.
pub(super) fn tolerance(axis: Axis, spec: Option<&AxisSpec>) -> f64 {
    let step_mm = spec.map_or(0.0, |spec| spec.resolution_um * 1e-3);
    if axis.is_linear() { ARRIVED.max(2.0 * step_mm) } else { axis.from_edge(ARRIVED) }
}

/// The axis of `target` that stands farthest off, if any is out of tolerance.
pub(super) fn astray(
    target: &Position,
    stands: &Position,
    tolerance: impl Fn(Axis) -> f64,
) -> Option<ControllerError> {
    let off = |(axis, value): &(Axis, f64)| (value - stands.at(*axis)).abs() / tolerance(*axis);
    let (axis, wanted) = target.iter().max_by(|one, other| off(one).total_cmp(&off(other)))?;
    // A position that is no number is no arrival.
    if off(&(axis, wanted)) <= 1.0 {
        return None;
    }
    let told = |value: f64| format!("{axis}{:.3}", axis.to_edge(value));
    Some(ControllerError::Astray { wanted: told(wanted), stands: told(stands.at(axis)) })
}

/// A contact lies between where the probing move began and where it came to rest, axis by axis.
pub(super) fn off_the_way(
    from: &Position,
    rest: &Position,
    contact: &Position,
    tolerance: impl Fn(Axis) -> f64,
) -> Option<ControllerError> {
    let nearest = |(axis, at): (Axis, f64)| {
        let (one, other) = (from.at(axis), rest.at(axis));
        (axis, at.clamp(one.min(other), one.max(other)))
    };
    let on_the_way: Position = contact.iter().map(nearest).collect();
    astray(&on_the_way, contact, tolerance)
}

/// Groups of modal words, one of each in force.
const GROUPS: [&[&str]; 5] = [
    &["G17", "G18", "G19"],
    &["G20", "G21"],
    &["G90", "G91"],
    &["G93", "G94", "G95"],
    &["G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3"],
];

/// Before anything moves.
pub(super) fn probe_open(status: &Status) -> Result<(), ControllerError> {
    if !status.probe_closed {
        return Ok(());
    }
    Err(ControllerError::NotReady {
        state: "the probe reads closed".to_owned(),
        remedy: "free the stylus; check the probe's battery, cable and polarity".to_owned(),
    })
}

/// The inputs that the machine file declares, by their letters.
pub(super) fn probe_health(status: &Status, dialect: &Dialect) -> Result<(), ControllerError> {
    let mut inputs = dialect.health_inputs();
    match inputs.find(|(input, _)| status.pins.contains(input)) {
        Some((_, fault)) => Err(ControllerError::Probe { fault }),
        None => Ok(()),
    }
}

/// What `head` says of each group must be in force (`$G`), and the offsets in use zero (`$#`).
pub(super) fn modes(
    head: &[String],
    modes: &[Message],
    offsets: &[Message],
) -> Result<(), ControllerError> {
    let in_force = modes.iter().find_map(|message| match message {
        Message::Modes(words) => Some(words),
        _ => None,
    });
    let unlike = |what: String| ControllerError::NotReady {
        state: format!("its modes are not as set: {what}"),
        remedy: "start again; if it comes again, check the dialect and the cable".to_owned(),
    };
    let in_force = in_force.ok_or_else(|| unlike("it does not tell them".to_owned()))?;
    let mut slot = "G54";
    for group in GROUPS {
        let code = head.iter().filter(|line| !line.starts_with('('));
        let mut said = code.flat_map(|line| line.split_whitespace());
        let Some(wanted) = said.rfind(|word| group.contains(word)) else { continue };
        if !in_force.iter().any(|word| word == wanted) {
            return Err(unlike(format!("{wanted} is not in force")));
        }
        slot = wanted;
    }
    for name in [slot, "G92"] {
        let zero = offsets.iter().any(|message| {
            matches!(message, Message::Offset { name: said, values }
                if said == name && values.iter().all(|value| *value == 0.0))
        });
        if !zero {
            return Err(unlike(format!("the offset {name} is not zero")));
        }
    }
    Ok(())
}
