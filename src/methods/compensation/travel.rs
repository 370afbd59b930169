//! Correction of the travel of a linear axis by a table of the control.

use serde::Serialize;

use crate::MethodRefusal;
use machine::frame::Point;
use machine::kinematics::{ErrorParameter, ErrorShape, ErrorTerm, KinematicChain};
use machine::{Axis, Position};
use nalgebra::Vector3;

/// Travel of a linear axis between two positions of the control.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AxisTravel {
    pub axis: Axis,
    pub from_mm: f64,
    pub to_mm: f64,
}

impl AxisTravel {
    fn length_mm(self) -> f64 {
        self.to_mm - self.from_mm
    }
}

/// An entry of the table: the correction at one position of the axis, for one direction of its motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TravelEntry {
    /// Position of the axis to which the entry applies.
    pub nominal_mm: f64,
    /// Index of the control value.
    pub value_index: usize,
    /// Change of the value with the correction: 1, or -1 where the value states the actual position.
    pub correction_sign: f64,
}

/// A table that the control adds to the positions of a linear axis.
#[derive(Debug, Clone, PartialEq)]
pub struct ControlledTravel {
    /// From the lowest to the highest position of the table.
    pub(super) travel: AxisTravel,
    /// One entry for each position of the table and direction of motion, by increasing position.
    pub(super) entries: Vec<TravelEntry>,
    /// Entry at the start of the travel.
    first: TravelEntry,
    /// Entry at the end of the travel, for the same direction of motion as `first`.
    last: TravelEntry,
}

impl ControlledTravel {
    /// `None`: the entries have fewer than two positions. The entries must be sorted by increasing position, with the
    /// directions of motion in the same order at every position.
    pub fn new(axis: Axis, entries: Vec<TravelEntry>) -> Option<Self> {
        let first = *entries.first()?;
        // The entry at the end position for the direction of motion of the first entry.
        let end_mm = entries.last()?.nominal_mm;
        let last = *entries.iter().find(|entry| entry.nominal_mm == end_mm)?;
        let travel = AxisTravel { axis, from_mm: first.nominal_mm, to_mm: last.nominal_mm };
        (travel.length_mm() > 0.0).then_some(Self { travel, entries, first, last })
    }

    /// Excess of the travel over the commanded travel that the table causes, mm.
    pub(super) fn correction_mm(&self, values_mm: &[f64]) -> f64 {
        let at = |entry: TravelEntry| match entry.correction_sign < 0.0 {
            true => entry.nominal_mm - values_mm[entry.value_index],
            false => values_mm[entry.value_index],
        };
        at(self.last) - at(self.first)
    }

    /// Change of the value of `entry` that lengthens the travel by `change_mm`. The correction at zero does not change,
    /// because homing has set this position.
    pub(super) fn entry_value_change_mm(&self, entry: &TravelEntry, change_mm: f64) -> f64 {
        entry.correction_sign * change_mm * entry.nominal_mm / self.travel.length_mm()
    }
}

/// Gain error that a table compensates by lengthening the travel by `change_mm`.
pub(super) fn compensated_gain(
    chain: &KinematicChain,
    travel: AxisTravel,
    change_mm: f64,
) -> Result<ErrorTerm, MethodRefusal> {
    Ok(ErrorTerm {
        parameter: gain_parameter_of_axis(travel.axis)?,
        value: -change_mm / error_by_gain_mm(chain, travel)?,
    })
}

/// The gain of a linear axis, such as `EXX1`.
pub(super) fn gain_parameter_of_axis(axis: Axis) -> Result<ErrorParameter, MethodRefusal> {
    ErrorParameter::new(axis, axis, ErrorShape::Gain)
        .map_err(|error| MethodRefusal::new(error.to_string(), "state the tables of linear axes only"))
}

/// Excess motion of the tool relative to the workpiece over the travel, per unit gain of the axis, mm per mm/mm.
pub(super) fn error_by_gain_mm(chain: &KinematicChain, travel: AxisTravel) -> Result<f64, MethodRefusal> {
    // The model is linear in a gain of this size.
    const TEST_GAIN: f64 = 1e-3;
    let error = [ErrorTerm { parameter: gain_parameter_of_axis(travel.axis)?, value: TEST_GAIN }];
    let tip = |q_mm: f64, errors: &[ErrorTerm]| {
        chain.tip_in_table(&Position::new().with(travel.axis, q_mm), Point::from_vec(Vector3::zeros()), errors).mm
    };
    let at = |q_mm: f64| (tip(q_mm, &error) - tip(q_mm, &[])).dot(&travel.axis.nominal_direction()) / TEST_GAIN;
    Ok(at(travel.to_mm) - at(travel.from_mm))
}
