//! Possible positions of the rotary axes and the spindle: the candidates of the design.
//!
//! An indexation is a [`Position`] that names every rotary axis of the machine, and also S if the spindle
//! turns in the design.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use crate::Refused;
use machine::frame::unit_vector;
use machine::kinematics::Chain;
use machine::record::machine::{AxisSpec, Machine};
use machine::{Axis, Position};

/// Minimum cosine for an axis to count as parallel to the spindle.
const PARALLEL: f64 = 0.9;
/// Angle below which two positions of one axis are the same, apart from whole turns, rad.
const SAME_RAD: f64 = 1e-6;
/// Tolerance at the limits of an axis, so that 90° is within [-90, 90], rad.
const SLACK_RAD: f64 = 1e-9;

/// One axis of the design and its possible positions, rad.
struct Grid {
    axis: Axis,
    at: Vec<f64>,
}

/// Minimum decrease of the Z component of a direction, over one radian of an axis, that counts as a tilt.
const LEANS: f64 = 1e-6;

/// Positions of one kind of axis that the settings name, degrees.
#[derive(Debug, Clone, Copy)]
pub struct NamedPositions<'a> {
    /// Key in the settings.
    pub key: &'static str,
    pub degrees: &'a [f64],
    /// Whether the positions are the defaults, which are restricted to the limits of the axis.
    pub is_default: bool,
}

#[derive(Debug, Clone, Copy)]
pub struct RotaryPositions<'a> {
    /// Positions of rotary axes that tilt the workpiece.
    pub tilt: NamedPositions<'a>,
    /// Positions of a rotary axis parallel to the spindle.
    pub turn: NamedPositions<'a>,
    /// Positions of the axis S; `None`: the spindle is not turned.
    pub spindle: Option<NamedPositions<'a>>,
}

/// All combinations of the named positions that are within the limits, as commanded positions. An axis that
/// tilts the spindle stays at 0.
///
/// # Errors
/// The machine has no rotary axis; the settings name a position outside the limits of an axis (defaults are
/// restricted to the limits); the spindle cannot be upright.
pub fn indexations(
    method: &str,
    machine: &Machine,
    chain: &Chain,
    named: &RotaryPositions<'_>,
) -> Result<Vec<Position>, Refused> {
    let rotary = machine.axes.iter().filter(|(axis, _)| is_rotary(**axis));
    let of_axis = |axis: Axis| if is_parallel(axis, machine) { &named.turn } else { &named.tilt };
    let mut grids = rotary
        .map(|(axis, spec)| match tilts_spindle(chain, *axis) {
            true => upright(*axis, spec),
            false => grid(*axis, spec, of_axis(*axis)),
        })
        .collect::<Result<Vec<_>, _>>()?;
    if grids.is_empty() {
        return Err(Refused {
            why: format!("{method} turns the artefact; this machine has no rotary axis"),
            instead: "describe the rotary axes in [axes] and in the topology".to_owned(),
        });
    }
    // The axis parallel to the spindle is the innermost: it sweeps through its positions while the others are
    // fixed.
    grids.sort_by_key(|grid| grid.at.len() > 1 && is_parallel(grid.axis, machine));
    if let (Some(named), Some(spec)) = (&named.spindle, machine.axes.get(&Axis::S)) {
        grids.push(grid(Axis::S, spec, named)?);
    }
    Ok(grids.iter().fold(vec![Position::new()], |places, grid| product(&places, grid)))
}

/// Whether the axis tilts the spindle: an axis of the head that is not parallel to the spindle.
pub fn tilts_spindle(chain: &Chain, axis: Axis) -> bool {
    let upright = |position: &Position| chain.machine_from_spindle(position, &[]).rotation[(2, 2)];
    let turned = Position::new().with(axis, 1.0);
    !axis.is_linear() && upright(&turned) < upright(&Position::new()) - LEANS
}

/// Whether the axis tilts the table.
pub fn tilts_table(chain: &Chain, axis: Axis) -> bool {
    let upright = |position: &Position| chain.machine_from_table(position, &[]).rotation[(2, 2)];
    !axis.is_linear()
        && upright(&Position::new().with(axis, 1.0)) < upright(&Position::new()) - LEANS
}

/// Whether the axis is rotary and moves the table or the head; the spindle does not count.
pub fn is_rotary(axis: Axis) -> bool {
    !axis.is_linear() && axis != Axis::S
}

/// Whether the rotary axis turns about the direction of the spindle, with all axes at zero.
pub fn is_parallel(axis: Axis, machine: &Machine) -> bool {
    let stated = machine.axes.get(&axis).map(|spec| Vector3::from(spec.direction));
    let unit = stated.and_then(unit_vector);
    unit.unwrap_or(axis.direction()).z.abs() > PARALLEL
}

fn product(places: &[Position], grid: &Grid) -> Vec<Position> {
    let with = |place: &Position| {
        let all = grid.at.iter().map(|at| place.clone().with(grid.axis, *at));
        all.collect::<Vec<_>>()
    };
    places.iter().flat_map(with).collect()
}

fn grid(axis: Axis, spec: &AxisSpec, named: &NamedPositions<'_>) -> Result<Grid, Refused> {
    let NamedPositions { key, degrees, is_default } = *named;
    let mut at: Vec<f64> = Vec::new();
    for degree in degrees {
        let Some(place) = reached(axis, spec, *degree) else {
            if is_default {
                continue;
            }
            return Err(outside(axis, spec, *degree, key));
        };
        if !at.iter().any(|other| is_same(*other, place)) {
            at.push(place);
        }
    }
    if at.is_empty() {
        return Err(Refused {
            why: format!(
                "{axis} has no position: {key} names none within [{}, {}]",
                spec.min, spec.max
            ),
            instead: format!(
                "name positions of {axis} in {key}, or correct the limits in [axes.{axis}]"
            ),
        });
    }
    Ok(Grid { axis, at })
}

/// The only position, 0, of an axis that tilts the spindle.
fn upright(axis: Axis, spec: &AxisSpec) -> Result<Grid, Refused> {
    let at = reached(axis, spec, 0.0).ok_or_else(|| Refused {
        why: format!(
            "the spindle must stand upright: balls are touched from above only; {axis} at 0° lies \
             outside its limits [{}, {}], and other than 0 cannot be planned yet",
            spec.min, spec.max
        ),
        instead: format!("correct the limits in [axes.{axis}]"),
    })?;
    Ok(Grid { axis, at: vec![at] })
}

fn outside(axis: Axis, spec: &AxisSpec, degree: f64, key: &str) -> Refused {
    Refused {
        why: format!(
            "an indexation with {axis} at {degree}° lies outside its limits [{}, {}]",
            spec.min, spec.max
        ),
        instead: format!("take {degree} out of {key}, or correct the limits in [axes.{axis}]"),
    }
}

/// The command for an angle within the limits: the angle itself, or one whole turn less or more.
fn reached(axis: Axis, spec: &AxisSpec, degree: f64) -> Option<f64> {
    let (min, max) = (axis.from_edge(spec.min), axis.from_edge(spec.max));
    let wanted = axis.from_edge(degree);
    [0.0, -TAU, TAU]
        .into_iter()
        .map(|turn| wanted + turn)
        .find(|at| (min - SLACK_RAD..=max + SLACK_RAD).contains(at))
}

/// Whether two angles are the same apart from whole turns, rad.
pub fn is_same(one: f64, other: f64) -> bool {
    let turns = (one - other) / TAU;
    (turns - turns.round()).abs() * TAU < SAME_RAD
}
