//! Selection of the machine errors to identify. Errors that one sphere does not separate are held at zero.

use faer::Mat;
use nalgebra::Vector3;

use super::sphere_model::{POSITION_UNKNOWN_COUNT, SphereModel, with_linear_axes};
use crate::MethodRefusal;
use crate::ball_measurement::tilts_table;
use estimation::independence::{find_linear_combination, independent_candidate_indices};
use estimation::null_space_names::name_null_space;
use machine::kinematics::{ErrorParameter, ErrorShape, KinematicChain};
use machine::{Axis, Position, frame::Point};

/// Number of poses with incommensurate angles. Errors that are separable at any poses are separable at these.
const TEST_POSE_COUNT: usize = 24;
/// Angle between two successive test poses, by rotary axis from the bed outwards.
const TEST_POSE_STEPS_RAD: [f64; 3] = [2.399_963, 1.618_034, 0.754_877];
/// Minimum fraction of a column that is independent of the other columns. Below it the column counts as a combination
/// of the other columns.
const MIN_INDEPENDENT_SHARE: f64 = 1e-6;
/// Components of a joint's error, in order.
const ERROR_COMPONENTS: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];

/// The errors to be identified.
pub struct ParameterSelection {
    pub parameters: Vec<ErrorParameter>,
    /// Candidates held at zero, because they are equivalent to errors that are already included, to the zero point or
    /// to the sphere.
    pub held_at_zero: Vec<ErrorParameter>,
    /// Descriptions of the combinations that include the held harmonics.
    pub gauge_lines: Vec<String>,
}

/// Rotary axes of the table, from the bed outwards.
pub fn table_rotary_axes(chain: &KinematicChain) -> Vec<Axis> {
    let axes = chain.topology().workpiece_branch().iter().copied();
    axes.filter(|axis| !axis.is_linear()).collect()
}

/// Selects the machine errors: the user's `names`, all of which are kept, or all location errors of the table's
/// rotary axes that one sphere separates. Then adds the harmonics of the tilting axis of these `orders`, except those
/// equivalent to errors already selected: first harmonics of B are partly equivalent to the location of the axis that
/// B carries.
///
/// # Errors
/// A name is invalid, belongs to an axis that the machine does not have, or is given twice; or there are `orders`, but
/// no axis tilts the table.
pub fn select_parameters(
    chain: &KinematicChain,
    names: &[String],
    orders: &[u32],
) -> Result<ParameterSelection, MethodRefusal> {
    let mut candidates =
        if names.is_empty() { location_error_candidates(chain) } else { parse_parameters(chain, names)? };
    let requested_count = if names.is_empty() { 0 } else { candidates.len() };
    let mut motions = harmonic_candidates(chain, orders)?;
    motions.retain(|motion| !candidates.contains(motion));
    candidates.extend(motions);
    let (columns, position_columns) = derivatives_by_error_and_by_position(chain, &candidates);
    let independent = independent_candidate_indices(&position_columns, &columns, |_| MIN_INDEPENDENT_SHARE);
    // A requested error is kept: the measurement decides whether it is identifiable.
    let is_kept = |index: &usize| *index < requested_count || independent.contains(index);
    let (kept, held): (Vec<usize>, Vec<usize>) = (0..candidates.len()).partition(is_kept);
    let pick = |indices: &[usize]| indices.iter().map(|i| candidates[*i]).collect::<Vec<_>>();
    let known = independent.iter().map(|i| &columns[*i]).chain(&position_columns).cloned();
    let known: Vec<Vec<f64>> = known.collect();
    let motions = held.iter().filter(|i| candidates[**i].shape() != ErrorShape::Location);
    let gauge = motions.map(|i| {
        let errors = [pick(&independent), vec![candidates[*i]]].concat();
        let combination = describe_combination(&errors, &known, &columns[*i]);
        format!("{} is held at zero: {combination}", candidates[*i])
    });
    let gauge = gauge.collect();
    Ok(ParameterSelection { parameters: pick(&kept), held_at_zero: pick(&held), gauge_lines: gauge })
}

fn location_error_candidates(chain: &KinematicChain) -> Vec<ErrorParameter> {
    let axes = table_rotary_axes(chain).into_iter();
    axes.flat_map(|axis| ERROR_COMPONENTS.map(|c| ErrorParameter::new(c, axis, ErrorShape::Location)))
        .filter_map(Result::ok)
        .collect()
}

fn harmonic_candidates(chain: &KinematicChain, orders: &[u32]) -> Result<Vec<ErrorParameter>, MethodRefusal> {
    if orders.is_empty() {
        return Ok(Vec::new());
    }
    let axis = table_rotary_axes(chain).into_iter().find(|axis| tilts_table(chain, *axis));
    let axis = axis.ok_or_else(|| {
        MethodRefusal::new(
            "harmonics belong to the axis that tilts the table; this machine has no such axis",
            "omit harmonics",
        )
    })?;
    let shapes = orders.iter().flat_map(|n| [ErrorShape::Cos(*n), ErrorShape::Sin(*n)]);
    let all = shapes.flat_map(|shape| ERROR_COMPONENTS.map(|c| ErrorParameter::new(c, axis, shape)));
    all.collect::<Result<_, _>>()
        .map_err(|why| MethodRefusal::new(why.to_string(), "use orders from 1, e.g. harmonics = [2]"))
}

fn parse_parameters(chain: &KinematicChain, names: &[String]) -> Result<Vec<ErrorParameter>, MethodRefusal> {
    let remedy = "correct `parameters`, or omit it: then all errors that one sphere separates are identified";
    chain.parse_parameters(names).map_err(|why| MethodRefusal::new(why.to_string(), remedy))
}

/// Names of the unknowns of the machine fit: errors, zero point, sphere; without those of beam and latency.
pub fn unknown_names(parameters: &[ErrorParameter], ball: &str) -> Vec<String> {
    let positions = ["zero".to_owned(), format!("ball_{ball}")];
    let coordinates = positions.iter().flat_map(|name| ["x", "y", "z"].map(|axis| format!("{name}_{axis}")));
    parameters.iter().map(ToString::to_string).chain(coordinates).collect()
}

/// Derivatives of the sphere's coordinates at many different poses, mm: by each error, and by zero point and
/// sphere.
fn derivatives_by_error_and_by_position(
    chain: &KinematicChain,
    parameters: &[ErrorParameter],
) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
    let model = SphereModel { chain: chain.clone(), parameters: parameters.to_vec() };
    let (ball, zero) = (Vector3::new(80.0, 25.0, 60.0), Vector3::new(3.0, -5.0, -150.0));
    let x = [&vec![0.0; parameters.len()], zero.as_slice(), ball.as_slice()].concat();
    let axes = table_rotary_axes(chain);
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); parameters.len() + POSITION_UNKNOWN_COUNT];
    for pose in 0..TEST_POSE_COUNT {
        let angles = axes.iter().zip(TEST_POSE_STEPS_RAD).map(|(axis, step)| (*axis, step * pose as f64));
        let rotary: Position = angles.collect();
        let Ok(xyz) = nominal_xyz(chain, &rotary, zero, ball) else { continue };
        let derivatives = model.misclosure_derivatives(&with_linear_axes(&rotary, xyz), &x);
        columns.iter_mut().zip(derivatives).for_each(|(column, by)| column.extend(&by));
    }
    let position_columns = columns.split_off(parameters.len());
    (columns, position_columns)
}

/// Description of the combination of `known` columns that equals the `column` of the last error. The known columns
/// belong to all `errors` but the last, to the zero point and to the sphere.
fn describe_combination(errors: &[ErrorParameter], known: &[Vec<f64>], column: &[f64]) -> String {
    let Some(mut direction) = find_linear_combination(known, column, MIN_INDEPENDENT_SHARE) else {
        return "a combination of the others".to_owned();
    };
    direction.insert(errors.len() - 1, -1.0);
    let null_space = Mat::from_fn(direction.len(), 1, |i, _| direction[i]);
    name_null_space(null_space.as_ref(), &unknown_names(errors, "1")).join("; ")
}

/// Positions X, Y, Z at which the nominal machine has the zero point at the sphere's centre.
pub fn nominal_xyz(
    chain: &KinematicChain,
    rotary: &Position,
    zero: Vector3<f64>,
    ball: Vector3<f64>,
) -> Result<Vector3<f64>, MethodRefusal> {
    let at = chain.solve_linear_axes(Point::from_vec(ball), Point::from_vec(zero), rotary, &[]);
    Ok(at?.xyz_or_zero())
}
