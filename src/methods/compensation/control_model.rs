//! Positions of rotary axes and corrections of linear axes that a control computes from its values.

use super::axis_positions::{RotaryAxisCoordinate, nominal_coordinate};
use super::travel::{ControlledTravel, compensated_gain};
use crate::MethodRefusal;
use machine::Axis;
use machine::kinematics::{ErrorParameter, ErrorShape, ErrorTerm, KinematicChain};
use nalgebra::Vector3;
use serde::Serialize;

/// Maximum number of steps per mm with which a value is written to the control.
const MAX_WRITTEN_STEPS_PER_MM: f64 = 1e4;
/// Number of significant digits with which `halcmd` prints a value.
const PIN_SIGNIFICANT_DIGITS: i32 = 7;

/// Resolution with which a control states its values.
#[derive(Debug, Clone, Copy, PartialEq)]
enum ValueResolution {
    /// Number of significant digits of the value in mm.
    Digits(i32),
    /// Number of decimals of the value in mm.
    Decimals(i32),
}

/// One value of a control.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ControlValue {
    /// Name at the control, e.g. `xyzbc-trt-kins.x-rot-point`.
    pub name: String,
    pub present_mm: f64,
    /// The value as the control states it.
    pub text: String,
}

/// A position that the control computes from its values.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ControlledPosition {
    pub(super) coordinate: RotaryAxisCoordinate,
    /// Index of the value that changes with the position.
    adjusted_value_index: usize,
    /// Index of a value that the control adds to the adjusted value.
    added_value_index: Option<usize>,
}

/// The values of a control and the positions of the rotary axes that it computes from them.
#[derive(Debug, Clone, PartialEq)]
pub struct ControlModel {
    values: Vec<ControlValue>,
    /// Positions in dependency order: a value is adjusted before a position adds it. The readings do not contain their
    /// effect.
    pub(super) positions: Vec<ControlledPosition>,
    /// Corrections of linear axes. The readings contain their effect.
    pub(super) travels: Vec<ControlledTravel>,
    resolution: ValueResolution,
}

/// Values of the pins of LinuxCNC's `xyzac-trt-kins` or `xyzbc-trt-kins`, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrunnionPins {
    pub x_rot_point: f64,
    pub y_rot_point: f64,
    pub z_rot_point: f64,
    /// `y-offset` of `xyzac-trt-kins`, `x-offset` of `xyzbc-trt-kins`.
    pub offset: f64,
    pub z_offset: f64,
}

impl ControlModel {
    /// LinuxCNC's kinematics `xyzac-trt-kins` (`tilt` = A) or `xyzbc-trt-kins` (`tilt` = B). C passes through
    /// (x-rot-point, y-rot-point). The tilting axis is at the offset from C across it, and in Z at z-rot-point +
    /// z-offset, of which z-rot-point is kept (LinuxCNC 2.9, `trtfuncs.c`).
    pub fn linuxcnc_trunnion(tilt: Axis, pins: TrunnionPins) -> Self {
        let (module, across, offset_pin) = match tilt {
            Axis::A => ("xyzac-trt-kins", Axis::Y, "y-offset"),
            _ => ("xyzbc-trt-kins", Axis::X, "x-offset"),
        };
        let value =
            |pin: &str, mm: f64| ControlValue { name: format!("{module}.{pin}"), present_mm: mm, text: mm.to_string() };
        let position = |axis: Axis, component: Axis, adjusted_value_index: usize, added_value_index: Option<usize>| {
            ControlledPosition {
                coordinate: RotaryAxisCoordinate { axis, component },
                adjusted_value_index,
                added_value_index,
            }
        };
        let c_across = if across == Axis::X { 0 } else { 1 };
        Self {
            values: vec![
                value("x-rot-point", pins.x_rot_point),
                value("y-rot-point", pins.y_rot_point),
                value("z-rot-point", pins.z_rot_point),
                value(offset_pin, pins.offset),
                value("z-offset", pins.z_offset),
            ],
            positions: vec![
                position(Axis::C, Axis::X, 0, None),
                position(Axis::C, Axis::Y, 1, None),
                position(tilt, across, 3, Some(c_across)),
                position(tilt, Axis::Z, 4, Some(2)),
            ],
            travels: Vec::new(),
            resolution: ValueResolution::Digits(PIN_SIGNIFICANT_DIGITS),
        }
    }

    /// A work offset whose zero is the centre of rotation: each value is one coordinate of a rotary axis. Its
    /// coordinate is the position of the spindle without a tool, because the control adds the length of the tool.
    /// `decimals`: those of mm in which the control states the values.
    pub fn work_offset(values: Vec<(RotaryAxisCoordinate, ControlValue)>, decimals: i32) -> Self {
        let (coordinates, values): (Vec<_>, Vec<_>) = values.into_iter().unzip();
        let position = |(adjusted_value_index, coordinate)| ControlledPosition {
            coordinate,
            adjusted_value_index,
            added_value_index: None,
        };
        Self {
            positions: coordinates.into_iter().enumerate().map(position).collect(),
            values,
            travels: Vec::new(),
            resolution: ValueResolution::Decimals(decimals),
        }
    }

    /// Tables that correct the travel of linear axes. The entries refer to `values` by index.
    pub fn of_correction_tables(values: Vec<ControlValue>, travels: Vec<ControlledTravel>) -> Self {
        Self { values, positions: Vec::new(), travels, resolution: ValueResolution::Digits(PIN_SIGNIFICANT_DIGITS) }
    }

    /// Whether the readings contain the effect of the values.
    pub fn is_in_readings(&self) -> bool {
        !self.travels.is_empty()
    }

    /// Number of positions and travels that the values correct.
    pub fn quantity_count(&self) -> usize {
        self.positions.len() + self.travels.len()
    }

    /// Whether the control computes positions of rotary axes from its values.
    pub fn has_positions(&self) -> bool {
        !self.positions.is_empty()
    }

    pub fn values(&self) -> &[ControlValue] {
        &self.values
    }

    /// The present values of the control, mm.
    pub(super) fn present_mm(&self) -> Vec<f64> {
        self.values.iter().map(|value| value.present_mm).collect()
    }

    /// The positions that the control computes from `values_mm`, mm.
    pub(super) fn positions_mm(&self, values_mm: &[f64]) -> Vec<f64> {
        let added = |position: &ControlledPosition| position.added_value_index.map_or(0.0, |index| values_mm[index]);
        self.positions.iter().map(|position| values_mm[position.adjusted_value_index] + added(position)).collect()
    }

    /// The values for these positions and corrections of travels, in the steps of the control, mm. A present value
    /// within half a step of the exact value is kept.
    pub(super) fn values_mm(&self, positions_mm: &[f64], corrections_mm: &[f64]) -> Vec<f64> {
        let present_mm = self.present_mm();
        let mut values_mm = present_mm.clone();
        for (position, mm) in self.positions.iter().zip(positions_mm) {
            let exact = mm - position.added_value_index.map_or(0.0, |index| values_mm[index]);
            let present_mm = present_mm[position.adjusted_value_index];
            values_mm[position.adjusted_value_index] =
                nearest_step(exact, present_mm, self.resolution.steps_per_mm(exact));
        }
        for (travel, mm) in self.travels.iter().zip(corrections_mm) {
            let change_mm = mm - travel.correction_mm(&present_mm);
            for entry in &travel.entries {
                let present_mm = present_mm[entry.value_index];
                values_mm[entry.value_index] = nearest_step(
                    present_mm + travel.entry_value_change_mm(entry, change_mm),
                    present_mm,
                    MAX_WRITTEN_STEPS_PER_MM,
                );
            }
        }
        values_mm
    }

    /// Errors of the machine that a control with `values_mm` takes into account, and that the readings contain:
    /// location errors relative to the stated axes, and gains of linear axes by the change of the values. Positions for
    /// which `is_determined` is false count as right in the control. `at_mm`: as
    /// [`super::MeasuredAxisPositions::at_mm`]; `None`: no location errors.
    ///
    /// # Errors
    /// The machine has no such axis.
    pub fn compensated_errors(
        &self,
        chain: &KinematicChain,
        values_mm: &[f64],
        at_mm: Option<[f64; 3]>,
        is_determined: impl Fn(RotaryAxisCoordinate) -> bool,
    ) -> Result<Vec<ErrorTerm>, MethodRefusal> {
        let locations = match at_mm {
            Some(at_mm) => self.location_errors(chain, values_mm, at_mm.into(), is_determined)?,
            None => Vec::new(),
        };
        let present_mm = self.present_mm();
        let gains = self.travels.iter().map(|travel| {
            let change_mm = travel.correction_mm(values_mm) - travel.correction_mm(&present_mm);
            compensated_gain(chain, travel.travel, change_mm)
        });
        Ok(locations.into_iter().chain(gains.collect::<Result<Vec<_>, _>>()?).collect())
    }

    /// Deviations of the positions of the control from the stated axes, each relative to the axis that carries it.
    fn location_errors(
        &self,
        chain: &KinematicChain,
        values_mm: &[f64],
        at: Vector3<f64>,
        is_determined: impl Fn(RotaryAxisCoordinate) -> bool,
    ) -> Result<Vec<ErrorTerm>, MethodRefusal> {
        let positions = self.positions.iter().map(|position| position.coordinate).zip(self.positions_mm(values_mm));
        let deviations: Vec<(RotaryAxisCoordinate, f64)> = positions
            .filter(|(coordinate, _)| is_determined(*coordinate))
            .map(|(coordinate, mm)| (coordinate, mm - nominal_coordinate(chain, coordinate, at)))
            .collect();
        let branch = chain.topology().workpiece_branch();
        let term = |(coordinate, deviation): &(RotaryAxisCoordinate, f64)| {
            let RotaryAxisCoordinate { axis, component } = *coordinate;
            // An error of an axis is relative to the axis that carries it.
            let of_axis = |carrier: &Axis| {
                let own = RotaryAxisCoordinate { axis: *carrier, component };
                deviations.iter().find(|(coordinate, _)| *coordinate == own).map(|(_, deviation)| *deviation)
            };
            let carriers = branch.iter().take_while(|own| **own != axis);
            let of_carrier = carriers.filter_map(of_axis).last().unwrap_or(0.0);
            let parameter = ErrorParameter::new(component, axis, ErrorShape::Location)
                .map_err(|error| MethodRefusal::new(error.to_string(), "report this error"))?;
            Ok(ErrorTerm { parameter, value: deviation - of_carrier })
        };
        deviations.iter().map(term).collect()
    }
}

/// The step nearest to `exact_mm`; the present value if it is within half a step.
fn nearest_step(exact_mm: f64, present_mm: f64, steps_per_mm: f64) -> f64 {
    let is_unchanged = (exact_mm - present_mm).abs() <= 0.5 / steps_per_mm;
    if is_unchanged { present_mm } else { (exact_mm * steps_per_mm).round() / steps_per_mm }
}

impl ValueResolution {
    /// Steps per mm in which the value can be set and read back.
    fn steps_per_mm(self, value_mm: f64) -> f64 {
        let decimals = match self {
            Self::Digits(digits) => digits - (value_mm.abs().max(1.0).log10().floor() as i32 + 1),
            Self::Decimals(decimals) => decimals,
        };
        10_f64.powi(decimals).min(MAX_WRITTEN_STEPS_PER_MM)
    }
}
