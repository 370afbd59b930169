//! Texts of the questions to the operator; the visible motion of a jog comes from the machine's kinematic
//! chain.

use nalgebra::Vector3;

use super::jog::RETRACT_MM;
use machine::kinematics::{Chain, Side};
use machine::record::machine::{Carrier, Machine};
use machine::record::question::{Jog, Question, Stylus};
use machine::{Axis, Position};

/// Text of a question, with the possible answers on a terminal.
pub fn of(question: &Question) -> String {
    match question {
        Question::Shows(stands) => format!(
            "It says that it stands at {}. Does the control's own display show the same, in machine \
             coordinates? yes / no",
            position(stands)
        ),
        Question::MayJog { jog, look_for } => format!(
            "{} moves by {}: {look_for}. It goes back once you have told what you saw.\n\
             Is the way free, and the stop in your hand? yes / no",
            jog.axis,
            told(jog)
        ),
        Question::Jogged { jog, look_for } => format!(
            "{look_for}. Did it? Keep clear: it goes back once you have answered.\n\
             y  as said      r  as far, the other way      n  nothing moved      ?  once more\n\
             X, Y, .. C  that axis moved instead      25  {} went {} (-25: the other way)",
            jog.axis,
            amount(jog.axis, 25)
        ),
        Question::Stylus(Stylus::Mounted) => {
            "From here on the touch probe is needed: put it into the spindle where a sensor sits in its place, \
             and switch it on. Does it sit there? yes / no"
                .to_owned()
        }
        Question::Stylus(Stylus::Free) => {
            "Nobody and nothing touches the stylus. Is it so? yes / no".to_owned()
        }
        Question::Stylus(Stylus::Deflected) => {
            "Press the stylus aside with a finger and hold it there. Is it held? yes / no"
                .to_owned()
        }
        Question::MayHold(jog) => format!(
            "{} moves by {} at {}/min and is held on its way: it should stop half-way and stay.\n\
             Is the way free, and the stop in your hand? yes / no",
            jog.axis,
            told(jog),
            amount(jog.axis, jog.feed_per_min)
        ),
        Question::Released { not_yet } => {
            let not_yet =
                not_yet.as_ref().map_or(String::new(), |why| format!("Not yet: {why}.\n"));
            format!(
                "{not_yet}The control was stopped on its way. Bring it to where it takes commands; is it in Hold, \
                 reset it there (a resume would end the held move) and home it where a reset forgets that. Is \
                 it ready? yes / no"
            )
        }
        Question::RetractDirection { position, look_for, last_result } => {
            retract_direction(position, look_for, last_result.as_deref())
        }
        Question::May { what } => format!("{what}\nyes / no"),
    }
}

fn retract_direction(stands: &Position, look_for: &[String], last_result: Option<&str>) -> String {
    let last_result = last_result.map_or(String::new(), |result| format!("{result}.\n"));
    format!(
        "{last_result}The probe reads closed: the stylus seems to be in contact. The control reports {}.\n\
         One axis can move out of contact by {RETRACT_MM} mm, slowly. No contact stops this move: look at the \
         stylus, and keep the stop in your hand.\n{}\n\
         Which axis and sense leads straight out of contact?\n\
         Z+, Z-, X+ ..  that step      n  nothing moves (also if the control's display shows another position)",
        position(stands),
        look_for.join("\n"),
    )
}

/// Positions in mm and degrees.
pub(super) fn position(stands: &Position) -> String {
    let stands = stands.iter().map(|(axis, at)| format!("{axis} {:.3}", axis.to_edge(at)));
    stands.collect::<Vec<_>>().join(" ")
}

pub(super) fn unit(axis: Axis) -> &'static str {
    if axis.is_linear() { "mm" } else { "degree" }
}

/// An amount such as `1 mm` or `1°`.
pub(super) fn amount(axis: Axis, value: impl std::fmt::Display) -> String {
    if axis.is_linear() { format!("{value} mm") } else { format!("{value}°") }
}

/// Amount of a jog, such as `+1 mm` or `-1°`.
pub(super) fn told(jog: &Jog) -> String {
    amount(jog.axis, format_args!("{:+}", jog.by))
}

/// What moves, and in which direction, if the machine file is correct and the machine is at `stands`; `None`
/// for a chain that cannot be built.
pub(super) fn look_for(machine: &Machine, stands: &Position, jog: &Jog) -> Option<String> {
    let carried = Chain::new(machine).ok()?.carried(Carrier::Axis(jog.axis))?;
    let mut commands = Axis::ALL.map(|axis| stands.at(axis));
    let still = carried.pose(&commands);
    *commands.get_mut(jog.axis as usize)? += jog.axis.from_edge(jog.by);
    let moved = carried.pose(&commands) * still.inverse();
    let what = if carried.side() == Side::Tool { "the spindle" } else { "the table" };
    let by = amount(jog.axis, jog.by.abs());
    Some(if jog.axis.is_linear() {
        let (axis, along) = largest(moved.translation.vector)?;
        format!("{what} goes {by} towards {}{axis}", if along < 0.0 { "−" } else { "+" })
    } else {
        // Right-handed about an axis: anticlockwise, seen from the positive end of the axis.
        let (about, along) = largest(moved.rotation.scaled_axis())?;
        let way = if along < 0.0 { "clockwise" } else { "anticlockwise" };
        format!("{what} turns {by} {way}, seen from +{about}")
    })
}

/// The machine axis nearest to a direction, and the component along it.
fn largest(way: Vector3<f64>) -> Option<(Axis, f64)> {
    let named = Axis::LINEAR.into_iter().zip(way.iter().copied());
    named.max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::setup::MachineFile;

    fn seen(change: (&str, &str), axis: Axis, by: f64) -> String {
        seen_at(&Position::new(), change, axis, by)
    }

    fn seen_at(stands: &Position, change: (&str, &str), axis: Axis, by: f64) -> String {
        let text = include_str!("../../config/simulated.toml").replacen(change.0, change.1, 1);
        let file = MachineFile::parse("machine.toml", text).unwrap();
        look_for(&file.machine, stands, &Jog { axis, by, feed_per_min: 60.0 }).unwrap()
    }

    #[test]
    fn what_will_be_seen_is_told_in_the_machines_directions() {
        let plain = ("", "");
        assert_eq!(seen(plain, Axis::X, 1.0), "the spindle goes 1 mm towards +X");
        assert_eq!(seen(plain, Axis::Z, -1.0), "the spindle goes 1 mm towards −Z");
        // As in config/simulated.toml: seen from above, C+ turns an ISO table clockwise.
        assert_eq!(seen(plain, Axis::C, 1.0), "the table turns 1° clockwise, seen from +Z");
        let reversed = ("[axes.C]\npositive = \"iso\"", "[axes.C]\npositive = \"reversed\"");
        assert_eq!(seen(reversed, Axis::C, 1.0), "the table turns 1° anticlockwise, seen from +Z");
        // After a quarter turn of the cradle the table faces sideways.
        let swung = Position::new().with(Axis::B, Axis::B.from_edge(90.0));
        let turned = seen_at(&swung, plain, Axis::C, 1.0);
        assert_eq!(turned, "the table turns 1° anticlockwise, seen from +X");
        // An axis that carries the workpiece moves against the sign of its command.
        let carried = ("V[w-C-B-b-Y-X-Z-(C)-t]", "w-C-B-Y-F-X-Z-S-t");
        assert_eq!(seen(carried, Axis::Y, 1.0), "the table goes 1 mm towards −Y");
    }
}
