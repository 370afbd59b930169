//! Possible positions of the rotary axes and the spindle: the candidates of the design.
//!
//! An indexation is a [`Position`] that names every rotary axis of the machine, and also S if the spindle
//! turns in the design.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use crate::MethodRefusal;
use machine::frame::{Pose, unit_vector};
use machine::kinematics::KinematicChain;
use machine::record::machine::{Machine, StatedAxis};
use machine::{Axis, Position};

/// Minimum |cosine| of the angle to Z for an axis to count as parallel to the spindle.
const MIN_PARALLEL_COSINE: f64 = 0.9;
/// Angle below which two positions of one axis are the same, apart from whole turns, rad.
const SAME_ANGLE_TOLERANCE_RAD: f64 = 1e-6;
/// Tolerance at the limits of an axis, so that 90° is within [-90, 90], rad.
const LIMIT_TOLERANCE_RAD: f64 = 1e-9;

/// One axis of the design and its possible positions, rad.
struct AxisGrid {
    axis: Axis,
    positions_rad: Vec<f64>,
}

/// Minimum decrease of the Z component of a direction, over one radian of an axis, that counts as a tilt.
const MIN_TILT_DECREASE: f64 = 1e-6;

/// Positions of one kind of axis that the settings name, degrees.
#[derive(Debug, Clone, Copy)]
pub struct ConfiguredPositions<'a> {
    /// Key in the settings.
    pub key: &'static str,
    pub angles_deg: &'a [f64],
    /// Whether the positions are the defaults, which are restricted to the limits of the axis.
    pub is_default: bool,
}

impl<'a> ConfiguredPositions<'a> {
    /// `key`, its value in the settings, and its default value.
    pub fn new(key: &'static str, angles_deg: &'a [f64], default_deg: &[f64]) -> Self {
        Self { key, angles_deg, is_default: angles_deg == default_deg }
    }
}

#[derive(Debug, Clone, Copy)]
pub struct RotaryPositions<'a> {
    /// Positions of rotary axes that tilt the workpiece.
    pub tilt: ConfiguredPositions<'a>,
    /// Positions of a rotary axis parallel to the spindle.
    pub turn: ConfiguredPositions<'a>,
    /// Positions of the axis S; `None`: the spindle is not turned.
    pub spindle: Option<ConfiguredPositions<'a>>,
}

/// All combinations of the named positions that are within the limits, as commanded positions: S changes fastest,
/// then the axis parallel to the spindle. An axis that tilts the spindle stays at 0.
///
/// # Errors
/// The machine has no rotary axis; the settings name a position outside the limits of an axis (defaults are
/// restricted to the limits); the spindle cannot be upright.
pub fn list_indexations(
    method: &str,
    machine: &Machine,
    chain: &KinematicChain,
    named: &RotaryPositions<'_>,
) -> Result<Vec<Position>, MethodRefusal> {
    let rotary = machine.axes.iter().filter(|(axis, _)| is_rotary_except_spindle(**axis));
    let of_axis = |axis: Axis| if is_parallel_to_spindle(axis, machine) { &named.turn } else { &named.tilt };
    let mut grids = rotary
        .map(|(axis, spec)| match tilts_spindle(chain, *axis) {
            true => upright_spindle_grid(*axis, spec),
            false => axis_grid(*axis, spec, of_axis(*axis)),
        })
        .collect::<Result<Vec<_>, _>>()?;
    if grids.is_empty() {
        return Err(MethodRefusal {
            reason: format!("{method} turns the artefact; this machine has no rotary axis"),
            remedy: "add the rotary axes to [axes] and to the topology".to_owned(),
        });
    }
    // The axis parallel to the spindle is the innermost: it sweeps through its positions while the others are
    // fixed.
    grids.sort_by_key(|grid| grid.positions_rad.len() > 1 && is_parallel_to_spindle(grid.axis, machine));
    if let (Some(named), Some(spec)) = (&named.spindle, machine.axes.get(&Axis::S)) {
        grids.push(axis_grid(Axis::S, spec, named)?);
    }
    Ok(grids.iter().fold(vec![Position::new()], |places, grid| combine_positions(&places, grid)))
}

/// Whether the axis tilts the spindle: an axis of the head that is not parallel to the spindle.
pub fn tilts_spindle(chain: &KinematicChain, axis: Axis) -> bool {
    is_tilted_by(axis, |position| chain.machine_from_spindle(position, &[]))
}

/// Whether the axis tilts the table.
pub fn tilts_table(chain: &KinematicChain, axis: Axis) -> bool {
    is_tilted_by(axis, |position| chain.machine_from_table(position, &[]))
}

/// Whether one radian of the axis lowers the Z component of the Z direction of `pose`, all other axes at zero.
fn is_tilted_by(axis: Axis, pose: impl Fn(&Position) -> Pose) -> bool {
    let z_component = |position: &Position| pose(position).rotation[(2, 2)];
    let turned = Position::new().with(axis, 1.0);
    !axis.is_linear() && z_component(&turned) < z_component(&Position::new()) - MIN_TILT_DECREASE
}

/// Whether the axis is rotary and moves the table or the head; the spindle does not count.
pub fn is_rotary_except_spindle(axis: Axis) -> bool {
    !axis.is_linear() && axis != Axis::S
}

/// Whether the rotary axis turns about the direction of the spindle (Z), with all axes at zero.
pub fn is_parallel_to_spindle(axis: Axis, machine: &Machine) -> bool {
    let stated = machine.axes.get(&axis).map(|spec| Vector3::from(spec.direction));
    let unit = stated.and_then(unit_vector);
    unit.unwrap_or(axis.nominal_direction()).z.abs() > MIN_PARALLEL_COSINE
}

/// All combinations of `places` with the positions of `grid`; the axis of `grid` changes fastest.
fn combine_positions(places: &[Position], grid: &AxisGrid) -> Vec<Position> {
    let with = |place| grid.positions_rad.iter().map(move |at| Position::clone(place).with(grid.axis, *at));
    places.iter().flat_map(with).collect()
}

/// Positions of one axis: equal angles once, default positions outside the limits omitted.
fn axis_grid(axis: Axis, spec: &StatedAxis, named: &ConfiguredPositions<'_>) -> Result<AxisGrid, MethodRefusal> {
    let ConfiguredPositions { key, angles_deg: degrees, is_default } = *named;
    let mut at: Vec<f64> = Vec::new();
    for degree in degrees {
        match command_rad_within_limits(axis, spec, *degree) {
            Some(place) if at.iter().all(|other| !is_same_angle(*other, place)) => at.push(place),
            None if !is_default => return Err(outside_limits_refusal(axis, spec, *degree, key)),
            _ => {}
        }
    }
    if at.is_empty() {
        return Err(MethodRefusal {
            reason: format!("{key} has no position of {axis} within the limits [{}, {}]", spec.min, spec.max),
            remedy: format!("add positions of {axis} to {key}, or correct the limits in [axes.{axis}]"),
        });
    }
    Ok(AxisGrid { axis, positions_rad: at })
}

/// The only position, 0, of an axis that tilts the spindle.
fn upright_spindle_grid(axis: Axis, spec: &StatedAxis) -> Result<AxisGrid, MethodRefusal> {
    let at = command_rad_within_limits(axis, spec, 0.0).ok_or_else(|| MethodRefusal {
        reason: format!(
            "the spindle must be upright, because balls are touched from above only, but {axis} = 0° is \
            outside the limits [{}, {}]; other positions of {axis} are not supported",
            spec.min, spec.max
        ),
        remedy: format!("correct the limits in [axes.{axis}]"),
    })?;
    Ok(AxisGrid { axis, positions_rad: vec![at] })
}

fn outside_limits_refusal(axis: Axis, spec: &StatedAxis, degree: f64, key: &str) -> MethodRefusal {
    MethodRefusal {
        reason: format!(
            "an indexation with {axis} at {degree}° is outside the limits [{}, {}] of the axis",
            spec.min, spec.max
        ),
        remedy: format!("remove {degree} from {key}, or correct the limits in [axes.{axis}]"),
    }
}

/// The command for an angle within the limits: the angle itself, or one whole turn less or more. `None`: all three
/// are outside.
fn command_rad_within_limits(axis: Axis, spec: &StatedAxis, degree: f64) -> Option<f64> {
    let (min, max) = (axis.to_mm_or_rad(spec.min), axis.to_mm_or_rad(spec.max));
    let commanded_rad = axis.to_mm_or_rad(degree);
    [0.0, -TAU, TAU]
        .into_iter()
        .map(|turn| commanded_rad + turn)
        .find(|at| (min - LIMIT_TOLERANCE_RAD..=max + LIMIT_TOLERANCE_RAD).contains(at))
}

/// Whether two angles are the same apart from whole turns, rad.
pub fn is_same_angle(one: f64, other: f64) -> bool {
    let turns = (one - other) / TAU;
    (turns - turns.round()).abs() * TAU < SAME_ANGLE_TOLERANCE_RAD
}
