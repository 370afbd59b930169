//! Selection of the machine errors that are unknown, and of those that one sphere does not separate.

use faer::Mat;
use nalgebra::Vector3;

use super::model::{Model, PLACES, placed};
use crate::Refused;
use estimation::independence::{combination_of, independent_columns};
use estimation::null_names::name_null_space;
use machine::kinematics::{Chain, ErrorParameter, Shape};
use machine::{Axis, Position, frame::Point};

/// Number of poses with incommensurate angles. Errors that are separable at any poses are separable at these.
const POSES: usize = 24;
const STEP: [f64; 3] = [2.399_963, 1.618_034, 0.754_877];
/// Minimum fraction of a column's length that is independent of the other columns. A column with less is their
/// combination.
const MIN_SHARE: f64 = 1e-6;
/// Components of a joint's error, in order.
const COMPONENTS: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];

/// The errors to be identified.
pub struct Chosen {
    pub parameters: Vec<ErrorParameter>,
    /// Candidates held at zero, because they are equivalent to errors that are already included.
    pub held: Vec<ErrorParameter>,
    /// Descriptions of the combinations that include the held harmonics.
    pub gauge: Vec<String>,
}

/// Rotary axes of the table, from the bed outwards.
pub fn of_table(chain: &Chain) -> Vec<Axis> {
    let axes = chain.topology().workpiece().iter().copied();
    axes.filter(|axis| !axis.is_linear()).collect()
}

/// Whether a rotation of the axis tilts the table.
pub fn tilts(chain: &Chain, axis: Axis) -> bool {
    let turned = chain.machine_from_table(&Position::new().with(axis, 1.0), &[]);
    turned.rotation[(2, 2)] < 1.0 - 1e-6
}

/// Selects the machine errors: the user's `names`, or all location errors of the table's rotary axes that one
/// sphere separates. Then adds the harmonics of the tilting axis of these `orders`, except those equivalent to
/// errors already selected: first harmonics of B are in part the location of what B carries.
///
/// # Errors
/// A name is invalid, belongs to an axis that the machine does not have, or is given twice.
pub fn chosen(chain: &Chain, names: &[String], orders: &[u32]) -> Result<Chosen, Refused> {
    let mut candidates = if names.is_empty() { locations(chain) } else { named(chain, names)? };
    let asked = if names.is_empty() { 0 } else { candidates.len() };
    let mut motions = harmonics(chain, orders)?;
    motions.retain(|motion| !candidates.contains(motion));
    candidates.extend(motions);
    let (columns, places) = columns(chain, &candidates);
    let independent = independent_columns(&places, &columns, |_| MIN_SHARE);
    // A requested error is kept: the measurement decides whether it is identifiable.
    let is_kept = |index: &usize| *index < asked || independent.contains(index);
    let (kept, dropped): (Vec<usize>, Vec<usize>) = (0..candidates.len()).partition(is_kept);
    let pick = |indices: &[usize]| indices.iter().map(|i| candidates[*i]).collect::<Vec<_>>();
    let known = independent.iter().map(|i| &columns[*i]).chain(&places).cloned();
    let known: Vec<Vec<f64>> = known.collect();
    let motions = dropped.iter().filter(|i| candidates[**i].shape() != Shape::Location);
    let gauge = motions.map(|i| {
        let errors = [pick(&independent), vec![candidates[*i]]].concat();
        let words = combination_in_words(&errors, &known, &columns[*i]);
        format!("{} is held at zero: {words}", candidates[*i])
    });
    let gauge = gauge.collect();
    Ok(Chosen { parameters: pick(&kept), held: pick(&dropped), gauge })
}

fn locations(chain: &Chain) -> Vec<ErrorParameter> {
    let axes = of_table(chain).into_iter();
    axes.flat_map(|axis| COMPONENTS.map(|c| ErrorParameter::new(c, axis, Shape::Location)))
        .filter_map(Result::ok)
        .collect()
}

fn harmonics(chain: &Chain, orders: &[u32]) -> Result<Vec<ErrorParameter>, Refused> {
    if orders.is_empty() {
        return Ok(Vec::new());
    }
    let axis = of_table(chain).into_iter().find(|axis| tilts(chain, *axis));
    let axis = axis.ok_or_else(|| Refused {
        why: "harmonics are of the axis that tilts the table, and this machine has none".to_owned(),
        instead: "leave harmonics out".to_owned(),
    })?;
    let shapes = orders.iter().flat_map(|n| [Shape::Cos(*n), Shape::Sin(*n)]);
    let all = shapes.flat_map(|shape| COMPONENTS.map(|c| ErrorParameter::new(c, axis, shape)));
    all.collect::<Result<_, _>>().map_err(|why| Refused {
        why: why.to_string(),
        instead: "name orders from 1 on, e.g. harmonics = [2]".to_owned(),
    })
}

fn named(chain: &Chain, names: &[String]) -> Result<Vec<ErrorParameter>, Refused> {
    let refused = |why: String| Refused {
        why,
        instead: "correct `parameters`, or leave it out: then all that one sphere tells apart are \
                  identified"
            .to_owned(),
    };
    let mut parameters: Vec<ErrorParameter> = Vec::new();
    for name in names {
        let parameter: ErrorParameter = name.parse().map_err(|why| refused(format!("{why}")))?;
        chain.check(parameter).map_err(|why| refused(format!("{why}")))?;
        if parameters.contains(&parameter) {
            return Err(refused(format!("`{name}` stands twice")));
        }
        parameters.push(parameter);
    }
    Ok(parameters)
}

/// Names of all unknowns except those of the beam.
pub fn names(parameters: &[ErrorParameter], ball: &str) -> Vec<String> {
    let places = ["zero".to_owned(), format!("ball_{ball}")];
    let places = places.iter().flat_map(|of| ["x", "y", "z"].map(|axis| format!("{of}_{axis}")));
    parameters.iter().map(ToString::to_string).chain(places).collect()
}

/// Derivatives of the sphere's coordinates at many different poses, mm: by each error, and by zero point and
/// sphere.
fn columns(chain: &Chain, parameters: &[ErrorParameter]) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
    let model = Model { chain: chain.clone(), parameters: parameters.to_vec() };
    let (ball, zero) = (Vector3::new(80.0, 25.0, 60.0), Vector3::new(3.0, -5.0, -150.0));
    let x = [&vec![0.0; parameters.len()], zero.as_slice(), ball.as_slice()].concat();
    let axes = of_table(chain);
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); parameters.len() + PLACES];
    for pose in 0..POSES {
        let turned = axes.iter().zip(STEP).map(|(axis, step)| (*axis, step * pose as f64));
        let rotary: Position = turned.collect();
        let Ok(xyz) = expected(chain, &rotary, zero, ball) else { continue };
        let derivatives = model.columns(&placed(&rotary, xyz), &x);
        columns.iter_mut().zip(derivatives).for_each(|(column, by)| column.extend(&by));
    }
    let places = columns.split_off(parameters.len());
    (columns, places)
}

/// Description of the combination of `known` columns that equals the `column` of the last error. The known columns
/// belong to all `errors` but the last, to the zero point and to the sphere.
fn combination_in_words(errors: &[ErrorParameter], known: &[Vec<f64>], column: &[f64]) -> String {
    let Some(mut direction) = combination_of(known, column, MIN_SHARE) else {
        return "a combination of the others".to_owned();
    };
    direction.insert(errors.len() - 1, -1.0);
    let null_space = Mat::from_fn(direction.len(), 1, |i, _| direction[i]);
    name_null_space(null_space.as_ref(), &names(errors, "1")).join("; ")
}

/// Positions X, Y, Z at which the nominal machine has the zero point at the sphere's centre.
pub fn expected(
    chain: &Chain,
    rotary: &Position,
    zero: Vector3<f64>,
    ball: Vector3<f64>,
) -> Result<Vector3<f64>, Refused> {
    let at = chain.linear_axes_for(Point::from_vec(ball), Point::from_vec(zero), rotary, &[]);
    Ok(at?.xyz())
}
