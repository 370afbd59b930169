//! Which machine errors are unknown, and which cannot be told apart by one sphere.

use nalgebra::{Matrix3, Vector3};

use super::model::{Model, Problem, Sight};
use crate::Refused;
use estimation::null_names::name_null_space;
use machine::kinematics::{Chain, ErrorParameter, Shape};
use machine::{Axis, Position, frame::Point};

/// Poses all around, at which errors are told apart in principle: incommensurate angles.
const ALL_AROUND: usize = 24;
const STEP: [f64; 3] = [2.399_963, 1.618_034, 0.754_877];
/// Components of a joint's error in their order.
const COMPONENTS: [Axis; 6] = [Axis::X, Axis::Y, Axis::Z, Axis::A, Axis::B, Axis::C];

/// The errors to be identified.
pub struct Chosen {
    pub parameters: Vec<ErrorParameter>,
    /// Candidates held at zero, as they are other names for what is given.
    pub held: Vec<ErrorParameter>,
    /// What stands for the held harmonics, in words.
    pub gauge: Vec<String>,
}

/// Rotary axes of the table, from the bed outwards.
pub fn of_table(chain: &Chain) -> Vec<Axis> {
    let axes = chain.topology().workpiece().iter().copied();
    axes.filter(|axis| !axis.is_linear()).collect()
}

/// Whether the table leans over as the axis turns.
pub fn tilts(chain: &Chain, axis: Axis) -> bool {
    let turned = chain.machine_from_table(&Position::new().with(axis, 1.0), &[]);
    turned.rotation[(2, 2)] < 1.0 - 1e-6
}

/// The user's `names`, or all location errors of the table's rotary axes that one sphere tells apart;
/// then the harmonics of the tilting axis of these `orders`, as far as they are not other names for
/// what stands before them: first harmonics of B are in part the location of what B carries.
///
/// # Errors
/// A name that is none, one of an axis that the machine does not have, one that stands twice.
pub fn chosen(chain: &Chain, names: &[String], orders: &[u32]) -> Result<Chosen, Refused> {
    let mut candidates = if names.is_empty() { locations(chain) } else { named(chain, names)? };
    let asked = if names.is_empty() { 0 } else { candidates.len() };
    let mut motions = harmonics(chain, orders)?;
    motions.retain(|motion| !candidates.contains(motion));
    candidates.extend(motions);
    let (mut parameters, mut held, mut gauge) = (Vec::new(), Vec::new(), Vec::new());
    for (index, candidate) in candidates.into_iter().enumerate() {
        let with = [parameters.as_slice(), &[candidate]].concat();
        // What a person asks for is not dropped: the measurement says whether it can be told.
        match if index < asked { None } else { lost(chain, &with) } {
            None => parameters = with,
            Some(words) => {
                held.push(candidate);
                if candidate.shape() != Shape::Location {
                    gauge.push(format!("{candidate} is held at zero: {words}"));
                }
            }
        }
    }
    Ok(Chosen { parameters, held, gauge })
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

/// Names of all unknowns beside the beam's.
pub fn names(parameters: &[ErrorParameter], ball: &str) -> Vec<String> {
    let places = ["zero".to_owned(), format!("ball_{ball}")];
    let places = places.iter().flat_map(|of| ["x", "y", "z"].map(|axis| format!("{of}_{axis}")));
    parameters.iter().map(ToString::to_string).chain(places).collect()
}

/// What poses all around do not tell, in words; `None` where they tell all.
fn lost(chain: &Chain, parameters: &[ErrorParameter]) -> Option<String> {
    let model = Model { chain: chain.clone(), parameters: parameters.to_vec() };
    let (ball, zero) = (Vector3::new(80.0, 25.0, 60.0), Vector3::new(3.0, -5.0, -150.0));
    let axes = of_table(chain);
    let sights = (0..ALL_AROUND).filter_map(|pose| {
        let turned = axes.iter().zip(STEP).map(|(axis, step)| (*axis, step * pose as f64));
        let rotary: Position = turned.collect();
        let at =
            model.chain.linear_axes_for(Point::from_vec(ball), Point::from_vec(zero), &rotary, &[]);
        let at = rotary.updated_by(&at.ok()?);
        Some(Sight { at, weight: Matrix3::identity() })
    });
    let problem = Problem { sights: sights.collect(), model, hold: None };
    let mut x = vec![0.0; parameters.len()];
    x.extend(&zero);
    x.extend(&ball);
    match problem.survey(&x) {
        Ok(survey) if survey.nullity == 0 => None,
        Ok(survey) => {
            let names = names(parameters, "1");
            Some(name_null_space(survey.null_space.as_ref(), &names).join("; "))
        }
        Err(why) => Some(why.to_string()),
    }
}

/// Axis positions that bring the zero point to the sphere's centre, by the nominal machine.
pub fn expected(
    chain: &Chain,
    rotary: &Position,
    zero: Vector3<f64>,
    ball: Vector3<f64>,
) -> Result<Vector3<f64>, Refused> {
    let at = chain.linear_axes_for(Point::from_vec(ball), Point::from_vec(zero), rotary, &[]);
    Ok(at?.xyz())
}
