//! Which machine errors are unknown: the set that a topology implies, or the user's names.

use std::f64::consts::TAU;

use glam::DVec3;

use super::model::Model;
use crate::base::{Axis, Point, Position};
use crate::kinematics::{Chain, ErrorParameter, Shape};
use crate::methods::Refused;

/// Poses and places of balls at which the errors are told apart. No symmetry, all around.
const POSES: usize = 60;
const BALLS: [[f64; 3]; 5] = [
    [-152.0, 11.0, 41.0],
    [149.0, -23.0, 57.0],
    [160.0, 161.0, 178.0],
    [-158.0, 137.0, 95.0],
    [31.0, -166.0, 76.0],
];
/// Their roots give angles that repeat in no axis.
const PRIMES: [f64; Axis::ALL.len()] = [2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0];
/// A stylus on the spindle's axis, mm: only there a tilted spindle is one that stands beside.
const TOOL: DVec3 = DVec3::new(0.0, 0.0, -150.0);
/// A column that keeps less than this part of its length beside the others is one of their sums.
const INDEPENDENT: f64 = 1e-6;

/// The user's `names`, or without names what the topology implies.
///
/// # Errors
/// A name that is none, one of an axis that the machine does not have, one that stands twice.
pub fn chosen(
    names: &[String],
    chain: &Chain,
    spindle_turns: bool,
) -> Result<Vec<ErrorParameter>, Refused> {
    if names.is_empty() {
        return Ok(implied(chain, spindle_turns));
    }
    let mut parameters: Vec<ErrorParameter> = Vec::new();
    for name in names {
        let parameter = name.parse().map_err(|why| refused(format!("{why}")))?;
        chain.check(parameter).map_err(|why| refused(format!("{why}")))?;
        if parameters.contains(&parameter) {
            return Err(refused(format!("`{name}` stands twice")));
        }
        parameters.push(parameter);
    }
    Ok(parameters)
}

fn refused(why: String) -> Refused {
    Refused {
        why,
        instead:
            "correct `parameters`, or leave it out: then the errors that the topology implies \
                  are identified"
                .to_owned(),
    }
}

/// The complete and non-redundant set of location errors and gains beside free balls, a free stylus
/// and one certified length: what ISO 230-1 and ISO 10791-6 name as location errors of the axes, less what is only
/// another name for the stylus, the balls or an error already taken.
///
/// Found from the model itself: candidates are taken in the order of preference and kept where their
/// columns are no sum of those before, on poses all around, without limits. First the spindle, then
/// the rotary axes, then the linear ones, each kind from the end of the chain towards the bed, X last:
/// so X is the primary axis, squareness belongs to the axis that is carried, and the offset between
/// two rotary axes to the one nearer to the part. Written from the bed outwards, gains last. For
/// wCBXFZYSt these are the thirteen of paper 4.
pub fn implied(chain: &Chain, spindle_turns: bool) -> Vec<ErrorParameter> {
    let candidates = candidates(chain);
    let model = Model::bare(chain.clone(), candidates.clone());
    let columns = columns(&model, spindle_turns);
    let (known, of_machine) = columns.split_at(columns.len() - candidates.len());
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for column in known {
        joins(&mut basis, column);
    }
    let mut kept: Vec<ErrorParameter> = candidates
        .iter()
        .zip(of_machine)
        .filter(|(_, column)| joins(&mut basis, column))
        .map(|(candidate, _)| *candidate)
        .collect();
    let (workpiece, tool) = (chain.topology().workpiece(), chain.topology().tool());
    let place = |axis| workpiece.iter().chain(tool).position(|a| *a == axis);
    kept.sort_by_key(|p| (p.shape() == Shape::Gain, place(p.axis())));
    kept
}

/// The coordinates of the stylus that are no mere shift of all balls.
pub fn free_stylus(chain: &Chain) -> Vec<usize> {
    let columns = columns(&Model::bare(chain.clone(), Vec::new()), false);
    let (stylus, balls) = columns.split_at(3);
    let mut basis = Vec::new();
    for column in balls {
        joins(&mut basis, column);
    }
    (0..3).filter(|k| joins(&mut basis, &stylus[*k])).collect()
}

/// In the order of preference.
fn candidates(chain: &Chain) -> Vec<ErrorParameter> {
    let (workpiece, tool) = (chain.topology().workpiece(), chain.topology().tool());
    let from_bed = |axis| [workpiece, tool].iter().find_map(|b| b.iter().position(|a| *a == axis));
    let mut axes: Vec<Axis> = chain.topology().axes().collect();
    axes.sort_by_key(|axis| {
        let farthest_first = std::cmp::Reverse(from_bed(*axis));
        (*axis != Axis::S, axis.is_linear(), farthest_first, *axis == Axis::X, *axis)
    });
    let gains = Axis::LINEAR.into_iter().map(|axis| (axis, axis, Shape::Gain));
    let locations = axes.into_iter().flat_map(|axis| {
        let components = Axis::ALL.into_iter().filter(|component| *component != Axis::S);
        components.map(move |component| (component, axis, Shape::Location))
    });
    gains
        .chain(locations)
        .filter_map(|(component, axis, shape)| ErrorParameter::new(component, axis, shape).ok())
        .collect()
}

/// Columns of the model: stylus, balls, then the model's parameters. The last row is a length between
/// the first two balls, without which the scale of everything would be open.
fn columns(model: &Model, spindle_turns: bool) -> Vec<Vec<f64>> {
    let first = 3 + 3 * BALLS.len();
    let mut columns = vec![Vec::new(); first + model.parameters().len()];
    let zero = vec![0.0; model.parameters().len()];
    for (pose, ball) in (0..POSES).flat_map(|pose| (0..BALLS.len()).map(move |ball| (pose, ball))) {
        let centre = DVec3::from_array(BALLS[ball]);
        let Some(position) = pose_at(model.chain(), pose, centre, spindle_turns) else { continue };
        let rows = model.rows(&position, &zero, TOOL, centre);
        for axis in 0..3 {
            for (j, column) in columns.iter_mut().enumerate() {
                column.push(match j {
                    j if j < 3 => rows.tool.col(j)[axis],
                    j if j < first => f64::from(u8::from(j == 3 + 3 * ball + axis)),
                    j => rows.machine[j - first][axis],
                });
            }
        }
    }
    let along = (DVec3::from_array(BALLS[1]) - DVec3::from_array(BALLS[0])).normalize();
    for (j, column) in columns.iter_mut().enumerate() {
        column.push(match j {
            3..6 => -along[j - 3],
            6..9 => along[j - 6],
            _ => 0.0,
        });
    }
    columns
}

fn pose_at(chain: &Chain, pose: usize, ball: DVec3, spindle_turns: bool) -> Option<Position> {
    let turning = chain.topology().axes().filter(|a| !a.is_linear());
    let angle = |axis: Axis| (pose as f64 * PRIMES[axis as usize].sqrt()).fract() * TAU;
    let others: Position = turning
        .filter(|axis| *axis != Axis::S || spindle_turns)
        .map(|axis| (axis, angle(axis)))
        .collect();
    let (target, tip) = (Point::from_vec(ball), Point::from_vec(TOOL));
    let linear = chain.linear_axes_for(target, tip, &others, &[]).ok()?;
    Some(others.updated_by(&linear))
}

/// Whether `column` is no sum of the orthonormal `basis`, which it then joins (Gram–Schmidt, twice).
fn joins(basis: &mut Vec<Vec<f64>>, column: &[f64]) -> bool {
    let length = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let whole = length(column);
    let mut left = column.to_vec();
    for _ in 0..2 {
        for unit in basis.iter() {
            let share: f64 = unit.iter().zip(&left).map(|(u, l)| u * l).sum();
            left.iter_mut().zip(unit).for_each(|(l, u)| *l -= share * u);
        }
    }
    let rest = length(&left);
    let new = rest > INDEPENDENT * whole;
    if new {
        left.iter_mut().for_each(|l| *l /= rest);
        basis.push(left);
    }
    new
}

#[cfg(test)]
mod tests {
    use super::super::tests::machine;
    use super::*;

    #[track_caller]
    fn check(topology: &str, expected: &[&str]) {
        let chain = Chain::new(&machine(topology)).unwrap();
        let mut found: Vec<String> =
            implied(&chain, true).iter().map(ToString::to_string).collect();
        let mut expected = expected.to_vec();
        println!("{topology}: {found:?}");
        found.sort();
        expected.sort();
        assert_eq!(found, expected, "{topology}");
    }

    /// Paper 4, table 2.
    #[test]
    fn paper_4_thirteen_errors_are_implied() {
        let thirteen = [
            "EA0B", "EC0B", "EX0C", "EA0C", "EB0C", "EB0Z", "EA0Y", "EC0Y", "EY0S", "EX0S", "EXX1",
            "EYY1", "EZZ1",
        ];
        check("wCBXFZYSt", &thirteen);
    }

    /// Eight location errors on five axes (ISO 10791-6), two more where the spindle turns. On four
    /// axes three squarenesses and two tilts, the place of C being that of the stylus; and no gain
    /// of Z, along which nothing ever turns: one length does not tell it from balls further apart.
    #[test]
    fn regress_other_machines() {
        let gains = ["EXX1", "EYY1", "EZZ1"];
        let with_gains = |names: &[&'static str]| [names, &gains].concat();
        let squareness = ["EA0Z", "EB0Z", "EC0Y"];
        check(
            "wCAYFXZt",
            &with_gains(&[&squareness[..], &["EY0C", "EA0C", "EB0C", "EB0A", "EC0A"]].concat()),
        );
        check(
            "wAFXYZBt",
            &with_gains(&[&squareness[..], &["EZ0B", "EA0B", "EC0B", "EB0A", "EC0A"]].concat()),
        );
        let four = [&squareness[..], &["EA0C", "EB0C", "EXX1", "EYY1"]].concat();
        check("wCFXYZt", &four);
        check("wCFXYZSt", &[&four[..], &["EX0S", "EY0S"]].concat());
    }

    #[test]
    fn a_spindle_that_does_not_turn_has_no_place_of_its_own() {
        let chain = Chain::new(&machine("wCBXFZYSt")).unwrap();
        let names: Vec<String> = implied(&chain, false).iter().map(ToString::to_string).collect();
        assert_eq!(names.len(), 11, "{names:?}");
        assert!(!names.contains(&"EX0S".to_owned()));
    }

    #[test]
    fn names_are_checked_in_words() {
        let chain = Chain::new(&machine("wCFXYZt")).unwrap();
        let ask = |names: &[&str]| {
            let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
            chosen(&names, &chain, false)
        };
        assert_eq!(ask(&["EXC_sin2", "EA0C"]).unwrap().len(), 2);
        assert!(ask(&["EX0Q"]).unwrap_err().why.contains("`EX0Q` is no error parameter"));
        let foreign = ask(&["EX0B"]).unwrap_err().why;
        assert!(foreign.contains("does not have"), "{foreign}");
        assert!(ask(&["EA0C", "E_A0C"]).unwrap_err().why.contains("twice"));
    }
}
