//! Selects the machine errors to identify: the errors that the topology implies, unless the user names others.

use super::confounding::MeasuringConditions;
use super::settings::{SambaSettings, SpindleOrientMode};
use crate::MethodRefusal;
use crate::ball_measurement::tilts_spindle;
use machine::Axis;
use machine::kinematics::{ErrorParameter, ErrorShape, KinematicChain};
use machine::record::plan::Plan;

/// Rotary axes that stay at zero in every design: the spindle if it is not oriented, and an axis that tilts
/// the spindle. Balls are touched from above only. An axis that tilts the spindle counts as movable if a step of the
/// plan moves it.
pub fn fixed_axes(plan: &Plan, settings: &SambaSettings, chain: &KinematicChain) -> Vec<Axis> {
    let (machine, topology) = (&plan.machine, chain.topology());
    let has_turned = |axis: Axis| {
        let mut at = plan.steps.iter().filter_map(|step| step.from.get(axis));
        let first = at.next();
        first.is_some_and(|first| at.any(|value| value != first))
    };
    let is_fixed = |axis: &Axis| match axis {
        Axis::S => !machine.axes.contains_key(axis) || settings.spindle == SpindleOrientMode::Fixed,
        _ => tilts_spindle(chain, *axis) && !has_turned(*axis),
    };
    topology.axes().filter(|axis| !axis.is_linear()).filter(is_fixed).collect()
}

/// The errors that the user `names`, or the set that the topology implies if there are no names.
///
/// # Errors
/// A name is invalid, belongs to an axis that the machine does not have, or occurs twice.
pub fn select_parameters(
    names: &[String],
    conditions: MeasuringConditions<'_>,
) -> Result<Vec<ErrorParameter>, MethodRefusal> {
    if names.is_empty() {
        return Ok(implied_parameters(conditions));
    }
    let remedy = "correct `parameters`, or omit it: then the errors that the topology implies are identified";
    conditions.chain.parse_parameters(names).map_err(|why| MethodRefusal::new(why.to_string(), remedy))
}

/// The complete and non-redundant set of location errors and gains, with free balls, a free stylus and one certified
/// length: the location errors of the axes by ISO 230-1 and ISO 10791-6, without those that are equivalent to the
/// stylus, the balls or an error already in the set.
///
/// The set is found from the equations. Candidates are tried in the order of preference, and kept if their columns are
/// not linear combinations of the earlier ones, on poses in all directions, without limits. The order is: the gains,
/// the spindle, the rotary axes, the linear axes, each kind from the end of the chain towards the bed, with X last. X
/// is therefore the primary axis, squareness belongs to the carried axis, and the offset between two rotary axes
/// belongs to the axis nearer to the workpiece. The set is listed from the bed outwards, gains last. For wCBXFZYSt it
/// is the thirteen errors of paper 4. An axis that does not move has no identifiable errors.
pub fn implied_parameters(conditions: MeasuringConditions<'_>) -> Vec<ErrorParameter> {
    let topology = conditions.chain.topology();
    let mut candidates = parameter_candidates(conditions.chain);
    candidates.retain(|error| !conditions.fixed_axes.contains(&error.axis()));
    let mut kept = conditions.separable_errors(&candidates);
    let chain_index = |axis| topology.axes().position(|a| a == axis);
    kept.sort_by_key(|p| (p.shape() == ErrorShape::Gain, chain_index(p.axis())));
    kept
}

/// All candidates in the order of preference: gains, then location errors.
fn parameter_candidates(chain: &KinematicChain) -> Vec<ErrorParameter> {
    let (workpiece, tool) = (chain.topology().workpiece_branch(), chain.topology().tool_branch());
    let from_bed = |axis| [workpiece, tool].iter().find_map(|b| b.iter().position(|a| *a == axis));
    let mut axes: Vec<Axis> = chain.topology().axes().collect();
    axes.sort_by_key(|axis| {
        let farthest_first = std::cmp::Reverse(from_bed(*axis));
        (*axis != Axis::S, axis.is_linear(), farthest_first, *axis == Axis::X, *axis)
    });
    let gains = Axis::LINEAR.into_iter().map(|axis| (axis, axis, ErrorShape::Gain));
    let locations = axes.into_iter().flat_map(|axis| {
        let components = Axis::ALL.into_iter().filter(|component| *component != Axis::S);
        components.map(move |component| (component, axis, ErrorShape::Location))
    });
    gains
        .chain(locations)
        .filter_map(|(component, axis, shape)| ErrorParameter::new(component, axis, shape).ok())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::machine;
    use super::*;

    #[track_caller]
    fn check_implied_parameters(topology: &str, expected: &[&str]) {
        let chain = KinematicChain::new(&machine(topology)).unwrap();
        let mut found: Vec<String> =
            implied_parameters(MeasuringConditions { chain: &chain, fixed_axes: &[], length_directions: &[] })
                .iter()
                .map(ToString::to_string)
                .collect();
        let mut expected = expected.to_vec();
        println!("{topology}: {found:?}");
        found.sort();
        expected.sort();
        assert_eq!(found, expected, "{topology}");
    }

    /// The topology of paper 4 implies the thirteen errors of its table 2.
    #[test]
    fn paper_4_thirteen_errors_are_implied() {
        let thirteen =
            ["EA0B", "EC0B", "EX0C", "EA0C", "EB0C", "EB0Z", "EA0Y", "EC0Y", "EY0S", "EX0S", "EXX1", "EYY1", "EZZ1"];
        check_implied_parameters("wCBXFZYSt", &thirteen);
    }

    /// Eight location errors for five axes (ISO 10791-6), and two more if the spindle turns. For four axes
    /// three squarenesses and two tilts: the position of C is equivalent to that of the stylus. The gain of Z
    /// is not included, because no axis turns Z: one length does not separate it from a larger distance of
    /// the balls.
    #[test]
    fn implied_parameters_of_other_topologies() {
        let gains = ["EXX1", "EYY1", "EZZ1"];
        let with_gains = |names: &[&'static str]| [names, &gains].concat();
        let squareness = ["EA0Z", "EB0Z", "EC0Y"];
        check_implied_parameters(
            "wCAYFXZt",
            &with_gains(&[&squareness[..], &["EY0C", "EA0C", "EB0C", "EB0A", "EC0A"]].concat()),
        );
        check_implied_parameters(
            "wAFXYZBt",
            &with_gains(&[&squareness[..], &["EZ0B", "EA0B", "EC0B", "EB0A", "EC0A"]].concat()),
        );
        let four = [&squareness[..], &["EA0C", "EB0C", "EXX1", "EYY1"]].concat();
        check_implied_parameters("wCFXYZt", &four);
        check_implied_parameters("wCFXYZSt", &[&four[..], &["EX0S", "EY0S"]].concat());
        // The rotation gives the difference of two gains. The length along X gives the third gain, or all
        // gains together.
        let b = ["EA0B", "EC0B", "EXX1", "EZZ1"];
        check_implied_parameters("wBFXYZt", &[&squareness[..], &b].concat());
        let a = ["EB0A", "EC0A", "EXX1", "EYY1"];
        check_implied_parameters("wAFXYZt", &[&squareness[..], &a].concat());
    }

    /// The gains that four axes show depend on the directions of the lengths, but not on a slight slant of a
    /// length.
    #[test]
    fn gains_follow_the_certified_lengths() {
        let x = nalgebra::Vector3::new(304.8, 0.0, -0.42).normalize();
        let slant = nalgebra::Vector3::new(-0.99, 0.12, 0.05).normalize();
        let (y, diagonal) = (nalgebra::Vector3::y(), nalgebra::Vector3::new(1.0, 1.0, 0.0).normalize());
        for (topology, lengths, gains) in [
            ("wBFXYZt", vec![x], vec!["EXX1", "EZZ1"]),
            ("wBFXYZt", vec![slant], vec!["EXX1", "EZZ1"]),
            ("wBFXYZt", vec![y], vec!["EXX1", "EYY1"]),
            ("wBFXYZt", vec![diagonal], vec!["EXX1", "EYY1"]),
            ("wBFXYZt", vec![x, y], vec!["EXX1", "EYY1", "EZZ1"]),
            ("wAFXYZt", vec![x], vec!["EXX1", "EYY1"]),
            ("wAFXYZt", vec![y], vec!["EYY1", "EZZ1"]),
            ("wCFXYZt", vec![x], vec!["EXX1", "EYY1"]),
        ] {
            let chain = KinematicChain::new(&machine(topology)).unwrap();
            let set =
                implied_parameters(MeasuringConditions { chain: &chain, fixed_axes: &[], length_directions: &lengths });
            let found = set.iter().filter(|error| error.shape() == ErrorShape::Gain);
            let found: Vec<String> = found.map(ToString::to_string).collect();
            assert_eq!(found, gains, "{topology}, {lengths:?}");
        }
    }

    /// A tilting head stays upright: the set is that of the machine without it.
    #[test]
    fn fixed_head_adds_no_parameters() {
        for (topology, without) in [("wAFXYZBt", "wAFXYZt"), ("wCFXYZBt", "wCFXYZt")] {
            let (with_head, plain) = (machine(topology), machine(without));
            let (head, plain) = (KinematicChain::new(&with_head).unwrap(), KinematicChain::new(&plain).unwrap());
            let stands = implied_parameters(MeasuringConditions {
                chain: &head,
                fixed_axes: &[Axis::B],
                length_directions: &[],
            });
            assert_eq!(
                stands,
                implied_parameters(MeasuringConditions { chain: &plain, fixed_axes: &[], length_directions: &[] }),
                "{topology}"
            );
            assert!(
                implied_parameters(MeasuringConditions { chain: &head, fixed_axes: &[], length_directions: &[] }).len()
                    > stands.len()
            );
        }
        let chain = KinematicChain::new(&machine("wFXYZCBSt")).unwrap();
        let tilts = |axis| tilts_spindle(&chain, axis);
        assert!(tilts(Axis::B) && !tilts(Axis::C) && !tilts(Axis::S));
    }

    #[test]
    fn fixed_spindle_has_no_location_parameters() {
        let chain = KinematicChain::new(&machine("wCBXFZYSt")).unwrap();
        let names: Vec<String> =
            implied_parameters(MeasuringConditions { chain: &chain, fixed_axes: &[Axis::S], length_directions: &[] })
                .iter()
                .map(ToString::to_string)
                .collect();
        assert_eq!(names.len(), 11, "{names:?}");
        assert!(!names.contains(&"EX0S".to_owned()));
    }

    #[test]
    fn unknown_parameter_names_are_refused_with_a_reason() {
        let chain = KinematicChain::new(&machine("wCFXYZt")).unwrap();
        let ask = |names: &[&str]| {
            let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
            select_parameters(
                &names,
                MeasuringConditions { chain: &chain, fixed_axes: &[Axis::S], length_directions: &[] },
            )
        };
        assert_eq!(ask(&["EXC_sin2", "EA0C"]).unwrap().len(), 2);
        assert!(ask(&["EX0Q"]).unwrap_err().reason.contains("`EX0Q` is not an error parameter"));
        let foreign = ask(&["EX0B"]).unwrap_err().reason;
        assert!(foreign.contains("does not have"), "{foreign}");
        assert!(ask(&["EA0C", "E_A0C"]).unwrap_err().reason.contains("twice"));
    }
}
