//! What a person is asked, in words; and what will be seen of a jog, from the machine's chain.

use crate::base::Axis;
use crate::kinematics::{Chain, Side};
use crate::record::machine::{Carrier, Machine};
use crate::record::question::{Jog, Question, Stylus};

/// The question, and how to answer it on a terminal.
pub fn of(question: &Question) -> String {
    match question {
        Question::MayJog { jog, look_for } => format!(
            "{} moves by {}: {look_for}. It goes back once you have told what you saw.\n\
             Is the way free, and the stop in your hand? yes / no",
            jog.axis,
            told(jog)
        ),
        Question::Jogged { jog, look_for } => format!(
            "{look_for}. Did it? Keep clear: it goes back once you have answered.\n\
             y  as said      r  as far, the other way      n  nothing moved      ?  once more\n\
             X, Y, .. C  that axis moved instead      25  {} went 25 {} (-25: the other way)",
            jog.axis,
            unit(jog.axis)
        ),
        Question::Stylus(Stylus::Free) => {
            "Nobody and nothing touches the stylus. Is it so? yes / no".to_owned()
        }
        Question::Stylus(Stylus::Deflected) => {
            "Press the stylus aside with a finger and hold it there. Is it held? yes / no".to_owned()
        }
        Question::MayHold(jog) => format!(
            "{} moves by {} at {} {}/min and is held on its way: it should stop half-way and stay.\n\
             Is the way free, and the stop in your hand? yes / no",
            jog.axis,
            told(jog),
            jog.feed_per_min,
            unit(jog.axis)
        ),
        Question::Released => {
            "The control was held. Release it there (reset, cycle stop), so that it is ready again. Is \
             it? yes / no"
                .to_owned()
        }
        Question::May { what } => format!("{what}\nyes / no"),
    }
}

pub(super) fn unit(axis: Axis) -> &'static str {
    if axis.is_linear() { "mm" } else { "°" }
}

/// `+1 mm`.
pub(super) fn told(jog: &Jog) -> String {
    format!("{:+} {}", jog.by, unit(jog.axis))
}

/// What moves, and whereto, if the machine file is right; `None` for a chain that cannot be built.
pub(super) fn look_for(machine: &Machine, jog: &Jog) -> Option<String> {
    let carried = Chain::new(machine).ok()?.carried(Carrier::Axis(jog.axis))?;
    let mut commands = [0.0; Axis::ALL.len()];
    let still = carried.pose(&commands);
    *commands.get_mut(jog.axis as usize)? = jog.axis.from_edge(jog.by);
    let moved = carried.pose(&commands) * still.inverse();
    let what = if carried.side() == Side::Tool { "the spindle" } else { "the table" };
    let by = format!("{} {}", jog.by.abs(), unit(jog.axis));
    Some(if jog.axis.is_linear() {
        let way = moved.translation.to_array();
        format!("{what} goes {by} towards {}", towards(way))
    } else {
        let (axis, angle) = glam::DQuat::from_mat3(&moved.matrix3).to_axis_angle();
        // Right-handed about an axis: anticlockwise for who looks against it.
        let about = (axis * angle).to_array();
        format!("{what} turns {by} anticlockwise, seen from {}", towards(about))
    })
}

/// The machine axis that lies nearest to a direction.
fn towards(way: [f64; 3]) -> String {
    let named = Axis::LINEAR.into_iter().zip(way);
    let largest = named.max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()));
    largest
        .map_or(String::new(), |(axis, by)| format!("{}{axis}", if by < 0.0 { "−" } else { "+" }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::setup::MachineFile;

    fn seen(change: (&str, &str), axis: Axis, by: f64) -> String {
        let text = include_str!("../../config/simulated.toml").replacen(change.0, change.1, 1);
        let file = MachineFile::parse("machine.toml", text).unwrap();
        look_for(&file.machine, &Jog { axis, by, feed_per_min: 60.0 }).unwrap()
    }

    #[test]
    fn what_will_be_seen_is_told_in_the_machines_directions() {
        let plain = ("", "");
        assert_eq!(seen(plain, Axis::X, 1.0), "the spindle goes 1 mm towards +X");
        assert_eq!(seen(plain, Axis::Z, -1.0), "the spindle goes 1 mm towards −Z");
        // As config/simulated.toml has it: seen from above, C+ turns an ISO table clockwise.
        assert_eq!(seen(plain, Axis::C, 1.0), "the table turns 1 ° anticlockwise, seen from −Z");
        let reversed = ("[axes.C]\npositive = \"iso\"", "[axes.C]\npositive = \"reversed\"");
        assert_eq!(seen(reversed, Axis::C, 1.0), "the table turns 1 ° anticlockwise, seen from +Z");
        // What carries the workpiece goes against the sign of its command.
        let carried = ("V[w-C-B-b-Y-X-Z-(C)-t]", "w-C-B-Y-F-X-Z-S-t");
        assert_eq!(seen(carried, Axis::Y, 1.0), "the table goes 1 mm towards −Y");
    }
}
