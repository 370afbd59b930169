//! Texts of the questions to the operator; the visible motion of a jog comes from the machine's kinematic
//! chain.

use nalgebra::Vector3;

use super::jog::RETRACT_INCREMENT_MM;
use machine::kinematics::{KinematicChain, MachineSide};
use machine::record::machine::{Carrier, Machine};
use machine::record::question::{Jog, OperatorQuestion, StylusState};
use machine::{Axis, Position};

/// Text of a question, with the possible answers on a terminal.
pub fn describe_question(question: &OperatorQuestion) -> String {
    match question {
        OperatorQuestion::DisplayedPosition(position) => format!(
            "The control reports the position {}. Does the display of the control show the same machine \
            coordinates? yes / no",
            format_position(position)
        ),
        OperatorQuestion::AllowJog { jog, visible_motion } => format!(
            "{} will move by {}: {visible_motion}. The axis moves back after your next answer.\nIs the path free, \
            and is the emergency stop within reach? yes / no",
            jog.axis,
            format_signed_amount(jog)
        ),
        OperatorQuestion::ObservedJog { jog, visible_motion } => format!(
            "Expected motion: {visible_motion}. Did the axis move like this? Keep clear: the axis moves back \
            after your answer.\ny  yes      r  same distance, opposite direction      n  no motion      ?  \
            repeat the jog\nX, Y, .. C  this axis moved instead      25  {} moved by {} (-25: opposite direction)",
            jog.axis,
            format_amount(jog.axis, 25)
        ),
        OperatorQuestion::StylusState(StylusState::Mounted) => {
            "The next checks need the touch probe. If a sensor is in the spindle, replace it by the probe, \
            and switch the probe on. Is the probe in the spindle? yes / no"
                .to_owned()
        }
        OperatorQuestion::StylusState(StylusState::Free) => {
            "Leave the stylus free. Is the stylus free of any contact? yes / no".to_owned()
        }
        OperatorQuestion::StylusState(StylusState::Deflected) => {
            "Deflect the stylus with a finger and hold it deflected. Is the stylus deflected now? yes / no".to_owned()
        }
        OperatorQuestion::AllowJogWithHold(jog) => format!(
            "{} will move by {} at {}/min, and the check sends a hold during the motion: the axis should \
            stop about half-way and stay there.\nIs the path free, and is the emergency stop within reach? yes / no",
            jog.axis,
            format_signed_amount(jog),
            format_amount(jog.axis, jog.feed_per_min)
        ),
        OperatorQuestion::HoldReleased { last_failure: not_yet } => {
            let not_yet = not_yet.as_ref().map_or(String::new(), |why| format!("The control is not ready: {why}.\n"));
            format!(
                "{not_yet}The control was stopped during a motion. Make the control ready for commands: if \
                it is in Hold, reset it (a resume would complete the held move), and home the machine if \
                the reset has cleared the homing. Is the control ready? yes / no"
            )
        }
        OperatorQuestion::RetractDirection { position, visible_motions, last_result } => {
            retract_question(position, visible_motions, last_result.as_deref())
        }
        OperatorQuestion::AllowAction { action: what } => format!("{what}\nyes / no"),
    }
}

fn retract_question(position: &Position, visible_motions: &[String], last_result: Option<&str>) -> String {
    let last_result = last_result.map_or(String::new(), |result| format!("{result}.\n"));
    format!(
        "{last_result}The probe reads closed: the stylus is probably in contact. The control reports the \
        position {}.\nOne axis can move out of contact by {RETRACT_INCREMENT_MM} mm, slowly. A further contact does \
        not stop this move: watch the stylus, and keep the emergency stop within reach.\n{}\nWhich axis and \
        direction lead straight out of the contact?\nZ+, Z-, X+ ..  make this step      n  no motion (also \
        if the display of the control shows another position)",
        format_position(position),
        visible_motions.join("\n"),
    )
}

/// Formats a position in mm and degrees.
pub(super) fn format_position(position: &Position) -> String {
    let position = position.iter().map(|(axis, at)| format!("{axis} {:.3}", axis.to_mm_or_deg(at)));
    position.collect::<Vec<_>>().join(" ")
}

pub(super) fn axis_unit(axis: Axis) -> &'static str {
    if axis.is_linear() { "mm" } else { "degree" }
}

/// An amount such as `1 mm` or `1°`.
pub(super) fn format_amount(axis: Axis, value: impl std::fmt::Display) -> String {
    if axis.is_linear() { format!("{value} mm") } else { format!("{value}°") }
}

/// Amount of a jog, such as `+1 mm` or `-1°`.
pub(super) fn format_signed_amount(jog: &Jog) -> String {
    format_amount(jog.axis, format_args!("{:+}", jog.by))
}

/// Description of the part that moves and its direction, if the machine file is correct and the machine is at
/// `position`; `None` for a chain that cannot be built.
pub(super) fn visible_motion(machine: &Machine, position: &Position, jog: &Jog) -> Option<String> {
    let carried = KinematicChain::new(machine).ok()?.carrier_chain(Carrier::Axis(jog.axis))?;
    let mut commands = Axis::ALL.map(|axis| position.get_or_zero(axis));
    let still = carried.pose(&commands);
    *commands.get_mut(jog.axis as usize)? += jog.axis.to_mm_or_rad(jog.by);
    let moved = carried.pose(&commands) * still.inverse();
    let what = if carried.side == MachineSide::Tool { "the spindle" } else { "the table" };
    let by = format_amount(jog.axis, jog.by.abs());
    Some(if jog.axis.is_linear() {
        let (axis, along) = dominant_axis(moved.translation.vector)?;
        format!("{what} moves {by} towards {}{axis}", if along < 0.0 { "−" } else { "+" })
    } else {
        // Right-handed about an axis: anticlockwise, seen from the positive end of the axis.
        let (about, along) = dominant_axis(moved.rotation.scaled_axis())?;
        let way = if along < 0.0 { "clockwise" } else { "anticlockwise" };
        format!("{what} turns {by} {way}, seen from +{about}")
    })
}

/// The machine axis nearest to a direction, and the component along it.
fn dominant_axis(direction: Vector3<f64>) -> Option<(Axis, f64)> {
    let named = Axis::LINEAR.into_iter().zip(direction.iter().copied());
    named.max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::setup::MachineFile;

    fn motion_text_at_zero(toml_replacement: (&str, &str), axis: Axis, by: f64) -> String {
        motion_text_at(&Position::new(), toml_replacement, axis, by)
    }

    fn motion_text_at(position: &Position, toml_replacement: (&str, &str), axis: Axis, by: f64) -> String {
        let text = include_str!("../../config/simulated.toml").replacen(toml_replacement.0, toml_replacement.1, 1);
        let file = MachineFile::parse("machine.toml", text).unwrap();
        visible_motion(&file.machine, position, &Jog { axis, by, feed_per_min: 60.0 }).unwrap()
    }

    #[test]
    fn expected_motion_is_described_in_machine_directions() {
        let plain = ("", "");
        assert_eq!(motion_text_at_zero(plain, Axis::X, 1.0), "the spindle moves 1 mm towards +X");
        assert_eq!(motion_text_at_zero(plain, Axis::Z, -1.0), "the spindle moves 1 mm towards −Z");
        // As in config/simulated.toml: seen from above, C+ turns an ISO table clockwise.
        assert_eq!(motion_text_at_zero(plain, Axis::C, 1.0), "the table turns 1° clockwise, seen from +Z");
        let reversed = ("[axes.C]\npositive = \"iso\"", "[axes.C]\npositive = \"reversed\"");
        assert_eq!(motion_text_at_zero(reversed, Axis::C, 1.0), "the table turns 1° anticlockwise, seen from +Z");
        // After a quarter turn of the cradle the table faces sideways.
        let swung = Position::new().with(Axis::B, Axis::B.to_mm_or_rad(90.0));
        let turned = motion_text_at(&swung, plain, Axis::C, 1.0);
        assert_eq!(turned, "the table turns 1° anticlockwise, seen from +X");
        // An axis that carries the workpiece moves against the sign of its command.
        let carried = ("V[w-C-B-b-Y-X-Z-(C)-t]", "w-C-B-Y-F-X-Z-S-t");
        assert_eq!(motion_text_at_zero(carried, Axis::Y, 1.0), "the table moves 1 mm towards −Y");
    }
}
